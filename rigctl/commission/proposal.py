"""A proposal for the rig file's plant from an identification: each key with its value in the file and the one found."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from rigctl.commission import identification
from rigctl.commission.identification import Drive, Estimated, IdentificationError, Pairs, TrialSignals
from rigctl.commission.motor_force import MotorForce, motor_force
from rigctl.config.settings import RigSettings
from rigctl.control.excitation.trials import QUIET_S
from rigctl.design.identified import DELAY_ERROR_S

LAST_QUIET_S = 0.01  # end of the rest before the first step, left out
LAG_SHARE = STIFFNESS_SHARE = 0.1  # largest uncertainty over value of a figure that is proposed
FORCE_SHARE = 0.1  # as much as the comparison in TENSIONING allows


def signals_of(records: npt.NDArray[Any], period_s: float) -> TrialSignals:
    """The columns for an identification, tick by tick.

    Raises:
        IdentificationError: records are missing.
    """
    if len(records) < 2:
        raise IdentificationError("the records of the excitation are not there any more")
    if int(records["seq"][-1] - records["seq"][0]) != len(records) - 1:
        raise IdentificationError("records of the excitation are missing")
    grid_s = (records["t_ns"] - records["t_ns"][0]) * 1e-9
    # The SYNC ends the tick's work, which the next record has.
    work_s = np.minimum(np.append(records["work_ns"][1:], records["work_ns"][-1:]) * 1e-9, period_s)
    at_s = grid_s + records["lateness_ns"] * 1e-9 + work_s
    late = np.append(False, np.diff(grid_s) > 1.5 * period_s)
    command, stroke, speed, tension, current = (
        records[name].astype(float)
        for name in ("command_mm_s", "stroke_mm", "speed_mm_s", "tension_n", "drive_current_a")
    )
    return TrialSignals(np.maximum.accumulate(at_s), command, stroke, speed, tension, current, late)


@dataclass(frozen=True)
class ProposedValue:
    """One line of a proposal; ``why``: reason without a ``found``."""

    key: str
    unit: str
    before: float | None = None
    found: Estimated | None = None
    why: str = ""

    def checked(self, *, share: float = math.inf, error: float = math.inf) -> ProposedValue:
        """The same row, without its figure if the uncertainty exceeds ``share`` of it or ``error``."""
        found = self.found
        if found is None or found.error <= min(error, share * abs(found.value)):
            return self
        value, uncertainty = rounded(found.value, found.error)
        return replace(self, found=None, why=f"too uncertain: {value} +- {uncertainty} {self.unit}".rstrip())

    def as_json(self) -> dict[str, Any]:
        """As JSON values."""
        found = self.found
        figures = (found.value, found.error) if found is not None and math.isfinite(found.value) else (None, None)
        return {
            "key": self.key, "unit": self.unit, "before": self.before, "found": figures[0], "error": figures[1],
            "why": self.why,
        }  # fmt: skip


def rows(signals: TrialSignals, settings: RigSettings) -> list[dict[str, Any]]:
    """Rows of key, unit, ``before`` (null: no such key), ``found`` with ``error`` (95 %), or null and ``why``.

    Raises:
        IdentificationError: the records do not determine the plant.
    """
    plant, period_s, pairs = settings.plant, settings.loop.period_ns * 1e-9, identification.pairs_of(signals)
    drive = identification.drive(signals, pairs)
    rest = slice(0, round((QUIET_S - LAST_QUIET_S) / period_s))
    cell, speed = (identification.noise(values[rest], period_s) for values in (signals.tension, signals.speed))
    found = [
        ProposedValue("plant.cylinder_lag_s", "s", plant.cylinder_lag_s, drive.lag_s).checked(share=LAG_SHARE),
        ProposedValue("plant.command_delay_s", "s", plant.command_delay_s, drive.delay_s).checked(error=DELAY_ERROR_S),
        ProposedValue("drive speed / command", "", None, drive.gain).checked(share=STIFFNESS_SHARE),
        ProposedValue("age of the drive's speed", "s", None, drive.speed_age_s).checked(error=DELAY_ERROR_S),
        *_of_rope(signals, settings, pairs, drive, cell),
        *_of_motor(signals, settings, pairs, drive),
        ProposedValue("tension_cell.noise_n", "N", settings.tension_cell.noise_n, cell),
        ProposedValue("drive speed noise", "mm/s", None, speed),
    ]
    return [row.as_json() for row in found]


def _of_rope(
    signals: TrialSignals, settings: RigSettings, pairs: Pairs, drive: Drive, cell: Estimated
) -> list[ProposedValue]:
    """Stiffness, the key of the rig file that follows from it, and backlash."""
    plant = settings.plant
    stiffness = ProposedValue("stiffness", "N/mm", plant.stiffness_n_mm)
    backlash = ProposedValue("backlash", "mm")
    if np.median(signals.tension) < settings.tension.slack_n:
        slack = "the rope is slack"
        stiffness, backlash = replace(stiffness, why=slack), replace(backlash, why=slack)
    else:
        rope = identification.rope(signals, pairs, drive, cell.value + cell.error)
        stiffness = replace(stiffness, found=rope.stiffness_n_mm).checked(share=STIFFNESS_SHARE)
        backlash = replace(backlash, found=rope.backlash_mm, why=stiffness.why)
        if stiffness.found is None:
            backlash = replace(backlash, found=None)
    if plant.spring_n_mm is None:
        part = ProposedValue("plant.rope_n_mm", "N/mm", plant.rope_n_mm, stiffness.found, stiffness.why)
    else:
        spring = _spring(stiffness.found, plant.rope_n_mm) if stiffness.found is not None else None
        why = "" if spring is not None else stiffness.why or "stiffer than the rope of the rig file alone"
        part = ProposedValue("plant.spring_n_mm", "N/mm", plant.spring_n_mm, spring, why)
    return [stiffness, part, backlash]


def _of_motor(signals: TrialSignals, settings: RigSettings, pairs: Pairs, drive: Drive) -> list[ProposedValue]:
    """Rope force per ampere, and the friction beside it."""
    cylinder = settings.cylinder
    force = ProposedValue("cylinder.force_per_ampere_n", "N/A", cylinder.force_per_ampere_n)
    friction = ProposedValue("friction of the cylinder", "N")
    if np.median(signals.tension) < settings.tension.slack_n:
        found = MotorForce(why="the rope is slack")
    else:
        status_s = settings.status_divisor * settings.loop.period_ns * 1e-9
        found = motor_force(signals, pairs, drive, status_s, cylinder.rated_current_a)
    force = replace(force, found=found.n_per_a, why=found.why).checked(share=FORCE_SHARE)
    known = found.friction_n if force.found is not None else None
    return [force, replace(friction, found=known, why=force.why)]


def _spring(stiffness: Estimated, rope_n_mm: float) -> Estimated | None:
    """Spring that gives this stiffness in series with the rope, equation (17); None if the rope alone is softer."""
    compliance = 1.0 / stiffness.value - 1.0 / rope_n_mm if stiffness.value > 0.0 else 0.0
    if compliance <= 0.0:
        return None
    spring = 1.0 / compliance
    return Estimated(spring, stiffness.error * (spring / stiffness.value) ** 2)


def left_out_in_words(what: str, left_out: int, kept: int) -> str:
    """How many repetitions the figures do without, empty for none."""
    return f"{left_out} of {left_out + kept} {what} left out" if left_out else ""


def in_words(found: list[dict[str, Any]], pairs: Pairs) -> str:
    """The main figures in one line."""
    shown = {row["key"]: row for row in found}

    def say(key: str, name: str, unit: str, factor: float = 1.0) -> str:
        row = shown[key]
        if row["found"] is None:
            return f"{name} not known ({row['why']})"
        value, error = rounded(factor * row["found"], factor * (row["error"] or 0.0))
        return f"{name} {value} +- {error} {unit}"

    parts = (
        say("plant.cylinder_lag_s", "lag", "ms", 1e3),
        say("plant.command_delay_s", "delay", "ms", 1e3),
        say("stiffness", "stiffness", "N/mm"),
        say("tension_cell.noise_n", "noise", "N"),
        say("backlash", "backlash", "mm"),
        *(
            (say("cylinder.force_per_ampere_n", "motor", "N/A"), say("friction of the cylinder", "friction", "N"))
            if shown["cylinder.force_per_ampere_n"]["found"] is not None
            else ()
        ),
        left_out_in_words("repetitions, in which the loop skipped ticks,", pairs.late, len(pairs.kept)),
    )
    return ", ".join(part for part in parts if part)


def rounded(value: float, error: float) -> tuple[str, str]:
    """A value to the second digit of its uncertainty, and the uncertainty; six decimals at most."""
    digits = 4 if error <= 0.0 else min(6, max(0, 1 - math.floor(math.log10(error))))
    return f"{value:z.{digits}f}", f"{error:.{digits}f}"
