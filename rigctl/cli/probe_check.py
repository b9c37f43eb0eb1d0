"""What ``rigctl check`` prints of the probe: how soon it finds a sensor that has failed, and what moves until then."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from rigctl.config.settings import RigSettings
from rigctl.control.excitation.probe_plan import LEAST_CHANGE, ProbePlan, plan
from rigctl.control.excitation.sensor_probe import LEAST_QUANTA
from rigctl.control.watch.unseen_travel import MOST_SHARE, frozen_mm, share_n
from rigctl.design.gains import design
from rigctl.devices.process_data import DriveUnits

_HOURS = 1000.0


@dataclass(frozen=True)
class ProbeCheck:
    """The probe of a rig, by the same function as the loop's, at the target of the rig file."""

    settings: RigSettings
    plan: ProbePlan

    @classmethod
    def of(cls, settings: RigSettings) -> ProbeCheck:
        """With the gains designed for the rig file."""
        return cls(settings, plan(settings, design(settings)))

    @property
    def stiffness_n_mm(self) -> float:
        """Of a slow stroke."""
        return self.settings.plant.slow_stiffness_n_mm

    @property
    def detection_s(self) -> float:
        """Of a frozen cell; endless for a probe that is too weak."""
        return self.plan.detection_s if self.plan.decides else float("inf")

    @property
    def bound_n(self) -> float:
        """What may go unseen of a payload that does not move."""
        return share_n(self.settings, self.settings.tension.target_n)

    @property
    def frozen_n(self) -> float:
        """What a frozen cell may let happen unseen."""
        return max(self.bound_n, self.stiffness_n_mm * frozen_mm(self.settings, self.detection_s))

    @property
    def drift_n(self) -> float:
        """What a cell that drifts may."""
        return max(self.bound_n, self.stiffness_n_mm * (self.settings.safety.heave_mm or 0.0))

    @property
    def encoder_steps(self) -> float:
        """Steps of the drive's position that the stroke moves by in a window, with a payload at rest."""
        return self.plan.range_n / self.settings.plant.stiffness_n_mm / DriveUnits().position_mm

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "detection_s": self.plan.detection_s if self.plan.decides else None,
            "rope_change_s": self.plan.rope_s if self.plan.decides else None,
            "false_alarms_1000_h": round(self.plan.false_alarms_per_hour * _HOURS, 3),
            "added_n": round(self.plan.added_n, 5),
            "noise_error_n": round(self.plan.error_n, 5),
            "unseen_n": round(self.bound_n, 2),
            "frozen_n": round(self.frozen_n, 2),
            "drift_n": round(self.drift_n, 2),
        }

    def lines(self) -> Iterator[str]:
        """In words."""
        probe, k, target_n = self.plan, self.stiffness_n_mm, self.settings.tension.target_n
        if probe.decides:
            yield (
                f"probe: frozen cell, stuck encoder or motionless drive found within {probe.detection_s:.0f} s at "
                f"{k:.3g} N/mm and {self.settings.tension_cell.noise_n:g} N of noise, a stiffness changed by "
                f"{LEAST_CHANGE:.0%} within {probe.rope_s:.0f} s; {probe.false_alarms_per_hour * _HOURS:.1g} false "
                f"alarms in 1000 h at most; it adds {probe.added_n:.2g} N rms to the {probe.error_n:.2g} N that the "
                f"cell's noise causes"
            )
            if self.encoder_steps < LEAST_QUANTA:
                yield (
                    f"probe: a stuck encoder only while the stroke moves by {LEAST_QUANTA:g} steps of the drive's "
                    f"position: at rest it moves by {self.encoder_steps:.1f}"
                )
        else:
            yield "probe: too weak beside the noise to judge a sensor; only the stroke's travel is bounded"
        yield (
            f"unseen: the stroke may move the load by {self.bound_n:.1f} N ({self.bound_n / k:.2f} mm at {k:.3g} N/mm) "
            f"from {target_n:g} N while the cell does not show it; a drifting cell by {self.drift_n:.1f} N"
        )
        for place, limit in enumerate(self.settings.limits):
            if limit.signal == "travel_mm" and limit.high is not None:
                first = "the bound above acts first" if limit.high * k > self.drift_n else "it acts first"
                yield f"limits.{place}: travel_mm {limit.high:g} mm is {limit.high * k:.1f} N at {k:.3g} N/mm: {first}"
        if self.settings.safety.waiver is not None and (why := _beyond(self)) is not None:
            yield f"WAIVED ({self.settings.safety.waiver}): {why}"


def refusal(settings: RigSettings) -> str | None:
    """Why a frozen cell could move the load by more than a tenth unseen; None: it could not, or it is waived."""
    if settings.safety.waiver is not None:
        return None
    return _beyond(ProbeCheck.of(settings))


def _beyond(check: ProbeCheck) -> str | None:
    target_n, k = check.settings.tension.target_n, check.stiffness_n_mm
    limit_n = MOST_SHARE * target_n
    if check.frozen_n <= limit_n:
        return None
    if check.bound_n > limit_n:
        return (
            f"plant: found {k:.3g} N/mm, on which a frozen cell could move {target_n:g} N by {check.bound_n:.1f} N "
            f"unseen, expected a softer spring ({limit_n:.1f} N at most, {MOST_SHARE:.0%} of tension.target_n)"
        )
    slow = (
        f"safety.heave_mm_s of at most {0.99 * limit_n / k / check.detection_s:.2g}, or " if check.plan.decides else ""
    )
    return (
        f"safety.heave_mm: found {check.settings.safety.heave_mm:g}, behind which a frozen cell could move the load by "
        f"{check.frozen_n:.1f} N unseen, expected {slow}at most {0.5 * limit_n / k:.2g} ({limit_n:.1f} N, "
        f"{MOST_SHARE:.0%} of tension.target_n)"
    )
