"""A plant for the rig file from what an identification found: each key with what is in the file, and what was found."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from rigctl.commission import identification
from rigctl.commission.identification import Estimate, IdentificationError, Signals
from rigctl.config import RigSettings
from rigctl.control.trials import QUIET_S

LAST_QUIET_S = 0.01  # of the rest before the first step, left out


def signals_of(records: npt.NDArray[Any], period_s: float) -> Signals:
    """The columns an identification needs, tick by tick: in one that was skipped everything stayed as it was.

    Raises:
        IdentificationError: records are missing.
    """
    if len(records) < 2:
        raise IdentificationError("the records of the excitation are not there any more")
    if int(records["seq"][-1] - records["seq"][0]) != len(records) - 1:
        raise IdentificationError("records of the excitation are missing")
    ticks = np.rint((records["t_ns"] - records["t_ns"][0]) * (1e-9 / period_s)).astype(int)
    known = records[np.searchsorted(ticks, np.arange(ticks[-1] + 1), side="right") - 1]
    columns = (known[name].astype(float) for name in ("command_mm_s", "stroke_mm", "speed_mm_s", "tension_n"))
    return Signals(period_s, *columns)


def rows(signals: Signals, settings: RigSettings) -> list[dict[str, Any]]:
    """What was found: key, unit, ``before`` (null: no such key), ``found`` and ``error``; null where it does not show.

    Raises:
        IdentificationError: the records do not tell.
    """
    plant, tight = settings.plant, bool(np.median(signals.tension) >= settings.tension.slack_n)
    drive = identification.drive(signals)
    found: list[tuple[str, str, float | None, Estimate | None]] = [
        ("plant.cylinder_lag_s", "s", plant.cylinder_lag_s, drive.lag_s),
        ("plant.command_delay_s", "s", plant.command_delay_s, drive.delay_s),
        ("drive speed / command", "", None, drive.gain),
    ]
    stiffness = backlash = spring = None
    if tight:
        rope = identification.rope(signals)
        stiffness, backlash = rope.stiffness_n_mm, rope.backlash_mm
        spring = _spring(stiffness, plant.rope_n_mm) if plant.spring_n_mm is not None else None
    found.append(("stiffness", "N/mm", plant.stiffness_n_mm, stiffness))
    if plant.spring_n_mm is not None:
        found.append(("plant.spring_n_mm", "N/mm", plant.spring_n_mm, spring))
    else:
        found.append(("plant.rope_n_mm", "N/mm", plant.rope_n_mm, stiffness))
    rest = slice(0, round((QUIET_S - LAST_QUIET_S) / signals.period_s))
    cell, speed = (identification.noise(values[rest], signals.period_s) for values in (signals.tension, signals.speed))
    found += [
        ("backlash", "mm", None, backlash),
        ("tension_cell.noise_n", "N", settings.tension_cell.noise_n, cell),
        ("drive speed noise", "mm/s", None, speed),
    ]
    return [
        {"key": key, "unit": unit, "before": before, "found": _number(value), "error": _number(error)}
        for key, unit, before, estimate in found
        for value, error in [(estimate.value, estimate.error) if estimate else (None, None)]
    ]


def _spring(stiffness: Estimate, rope_n_mm: float) -> Estimate | None:
    """The spring that makes this stiffness in series with the rope, equation (17); None if the rope alone is softer."""
    compliance = 1.0 / stiffness.value - 1.0 / rope_n_mm if stiffness.value > 0.0 else 0.0
    if compliance <= 0.0:
        return None
    spring = 1.0 / compliance
    return Estimate(spring, stiffness.error * (spring / stiffness.value) ** 2)


def _number(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None


def in_words(found: list[dict[str, Any]]) -> str:
    """The main figures in one line."""
    shown = {row["key"]: row for row in found}

    def say(key: str, name: str, unit: str, factor: float = 1.0) -> str:
        row = shown[key]
        if row["found"] is None:
            return f"{name} not seen"
        value, error = rounded(factor * row["found"], factor * (row["error"] or 0.0))
        return f"{name} {value} +- {error} {unit}"

    return ", ".join(
        (
            say("plant.cylinder_lag_s", "lag", "ms", 1e3),
            say("plant.command_delay_s", "delay", "ms", 1e3),
            say("stiffness", "stiffness", "N/mm"),
            say("tension_cell.noise_n", "noise", "N"),
            say("backlash", "backlash", "mm"),
        )
    )


def rounded(value: float, error: float) -> tuple[str, str]:
    """A value to the second digit of its standard error, and that error; six decimals at most."""
    digits = 4 if error <= 0.0 else min(6, max(0, 1 - math.floor(math.log10(error))))
    return f"{value:z.{digits}f}", f"{error:.{digits}f}"
