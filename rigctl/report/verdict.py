"""The verdict of a report: the paper's requirement, the rig's own limits, and completeness of the recording."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy.typing as npt

from rigctl.config.limits_section import LimitSettings
from rigctl.config.settings import RigSettings
from rigctl.metrics.error_statistics import ErrorStatistics, error_n, longest_beyond_s
from rigctl.metrics.innovations import innovation_statistics
from rigctl.metrics.phases import JudgedPhase
from rigctl.metrics.rope_swing import rope_swing

REQUIREMENT_PCT = 5.0
"""Unloading accuracy of 95 % or better, section 2.3 of the paper."""
PASSED, FAILED, NOTHING = "passed", "failed", "nothing to judge"
Array = npt.NDArray[Any]


@dataclass(frozen=True)
class Criterion:
    """One criterion. ``met`` None: shown, not judged."""

    name: str
    found: str
    limit: str
    met: bool | None
    why: str


@dataclass(frozen=True)
class ReportVerdict:
    """``word`` is PASSED, FAILED or NOTHING."""

    word: str
    criteria: list[Criterion]

    @property
    def passed(self) -> bool:
        """Whether every judged criterion is met, and there is one."""
        return self.word == PASSED


def judge(
    records: Array,
    phases: list[JudgedPhase],
    whole: ErrorStatistics | None,
    settings: RigSettings | None,
    rate_hz: float,
) -> ReportVerdict:  # fmt: skip
    """Judge every phase by its limits."""
    if whole is None:
        return ReportVerdict(NOTHING, [])
    rows = [
        Criterion(
            "largest error, requirement", f"{whole.eta_max_pct:.3g} %", f"{REQUIREMENT_PCT:g} %",
            whole.eta_max_pct <= REQUIREMENT_PCT, "the paper, section 2.3",
        ),
        *(_own(records, phases, limit, rate_hz) for limit in own_limits(settings)),
        *_of_demo(whole, settings),
    ]  # fmt: skip
    if not any(row.name.startswith("rig's own limit") for row in rows):
        rows.append(Criterion("rig's own limit", "-", "none", None, "the rig file sets none on vertical_error_n"))
    faulted = [phase for phase in phases if phase.faulted]
    said = ", ".join(str(phase.number) for phase in faulted)
    rows.append(Criterion("phases ended by a trip", f"{len(faulted)}" + (f" (phase {said})" if said else ""), "0",
                          not faulted, "a trip ends the test"))  # fmt: skip
    gone = whole.missing + whole.without_value
    for sensor in innovation_statistics(records, phases):
        rows.append(Criterion(f"filter, {sensor.sensor}: NIS", sensor.nis_words(), "-", None,
                              "squared innovation over its variance"))  # fmt: skip
        rows.append(Criterion(f"filter, {sensor.sensor}: whiteness", sensor.white_words(), "-", None,
                              "5 % by chance; more: what the filter leaves of a disturbance"))  # fmt: skip
    if (swing := rope_swing(records, phases, rate_hz)) is not None:
        rows.append(Criterion("swing of the rope's stretch", swing.in_words(), "-", None,
                              "for estimator.swing_hz and swing_damping"))  # fmt: skip
    rows.append(Criterion("records missing, without value", str(gone), "0", gone == 0, "within the judged time"))
    return ReportVerdict(PASSED if all(row.met is not False for row in rows) else FAILED, rows)


def own_limits(settings: RigSettings | None) -> list[LimitSettings]:
    """The rig file's limits on the vertical error while COMPENSATING, the tightest first."""
    if settings is None:
        return []
    found = [
        limit for limit in settings.limits
        if limit.signal == "vertical_error_n" and limit.high is not None and "COMPENSATING" in limit.modes
    ]  # fmt: skip
    return sorted(found, key=lambda limit: limit.high or 0.0)


def _own(records: Array, phases: list[JudgedPhase], limit: LimitSettings, rate_hz: float) -> Criterion:
    high_n = limit.high or 0.0
    for_s = limit.persistence_ms / 1000.0
    beyond_s = max(longest_beyond_s(error_n(records, phase), high_n, rate_hz) for phase in phases)
    action = limit.action.replace("_", " ")
    return Criterion(
        f"rig's own limit, {high_n:g} N ({action})",
        f"beyond for {beyond_s:.3g} s",
        f"{for_s:g} s" if for_s else "never",
        beyond_s <= for_s,
        f"limits: {100 * high_n / phases[0].target_n:.2g} % of {phases[0].target_n:g} N",
    )


def _of_demo(whole: ErrorStatistics, settings: RigSettings | None) -> list[Criterion]:
    """The demo's limits, shown but not judged: they are for the true force, which no recording has."""
    if settings is None or settings.demo is None:
        return []
    limit = settings.demo
    return [Criterion("demo's limits, max / rms", f"{whole.eta_max_pct:.2g} / {whole.eta_rms_pct:.2g} %",
                      f"{limit.eta_max_pct:g} / {limit.eta_rms_pct:g} %", None,
                      "the true force is not recorded")]  # fmt: skip
