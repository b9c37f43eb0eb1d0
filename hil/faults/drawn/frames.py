"""When the received frames show a fault: what a healthy rig, whatever its payload does, would not send."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from hil.faults.drawn.stretches import STOP_S, Flags, Floats, keeping, parts
from rigctl.config.settings import RigSettings

CELL_SIGMAS = 6.0 * 2.0**0.5  # of the difference of two samples
POSITION_MM, SLOPE_DEG, CURRENT, AGE_PERIODS = 0.02, 0.05, 500, 5
"""Differences beyond noise: encoder and screw; inclinometer; per mille of the rated current; missing frames."""
PARITY_MM, PARITY_S = 0.05, 0.1
"""Between the position's change and the sum of the speeds over this time."""
FOLLOWS_MM_S, FOLLOWS_S = 1.0, 0.05
"""Between the speed and the command after the drive's lag, for so long."""
FOLLOWED_MM, FOLLOWED_S = 0.3, 1.0
"""Between the position's change and the sum of the commands after the drive's lag, while the drive is on."""
REPEATS = 20
"""Samples of the cell in a row without any noise."""
NOISIER, NOISE_S = 3.0, 0.1
"""Steps from sample to sample against those of the run without the fault, rms over this time."""
PAYLOAD = ((22.0, 0.02), (8.0, 0.15))
"""A payload is not this fast (mm/s) for so long: the limits on the disturbance in the rig file."""


def seen(rows: npt.NDArray[Any], twin: npt.NDArray[Any], settings: RigSettings, period_s: float) -> Flags:
    """Whether the frames of each period show something; ``twin``: rows of the run without the fault."""
    found: Flags = (
        _beside(rows, twin) | _in_place(rows, twin, settings, period_s) | _cell(rows, twin, settings, period_s)
    )
    return found | _drive(rows, settings, period_s) | _payload(rows, settings, period_s)


def _beside(rows: npt.NDArray[Any], twin: npt.NDArray[Any]) -> Flags:
    """What neither payload nor law changes, in the same mode."""
    found: Flags = rows["others"] != twin["others"]
    for name in ("status", "inputs"):
        found |= rows[name] != twin[name]
    found |= np.abs(rows["current"].astype(float) - twin["current"]) > CURRENT
    for name in ("cell_age", "drive_age", "slope_age"):
        found |= np.abs(rows[name] - twin[name]) >= AGE_PERIODS
    found &= rows["mode"] == twin["mode"]
    for name in ("long_deg", "lateral_deg"):
        found |= np.abs(rows[name] - twin[name]) > SLOPE_DEG
    return found


def _in_place(rows: npt.NDArray[Any], twin: npt.NDArray[Any], settings: RigSettings, period_s: float) -> Flags:
    """In the modes that keep the stroke, neither stroke nor load may change."""
    found, keeps, same = np.zeros(len(rows), bool), keeping(rows["mode"]), rows["mode"] == twin["mode"]
    cell_n = CELL_SIGMAS * settings.tension_cell.noise_n
    for begin, end in parts(rows["mode"]):
        part = slice(begin, end)
        settled = min(begin + (round(STOP_S / period_s) if begin else 0), end - 1)
        for name, bound in (("position_mm", POSITION_MM), ("cell_n", cell_n)):
            beside = np.abs(rows[name][part] - twin[name][part])
            kept = np.abs(rows[name][part] - rows[name][settled])
            kept[: settled - begin] = 0.0
            found[part] |= keeps[part] & (np.where(same[part], beside, kept) > bound)
    return found


def _cell(rows: npt.NDArray[Any], twin: npt.NDArray[Any], settings: RigSettings, period_s: float) -> Flags:
    """A cell without its noise, or with more of it."""
    steps, usual = (np.diff(each["cell_n"], prepend=each["cell_n"][0]) for each in (rows, twin))
    still = (steps == 0.0) & (rows["cell_age"] == 0)
    found: Flags = _held_for(still, REPEATS) & ~_held_for((usual == 0.0) & (twin["cell_age"] == 0), REPEATS)
    periods = round(NOISE_S / period_s)
    noise, usual_noise = (np.sqrt(_mean(values**2, periods)) for values in (steps, usual))
    usual_n = max(usual_noise.max(initial=0.0), 2.0**0.5 * settings.tension_cell.noise_n)
    found |= noise > NOISIER * usual_n
    return found


def _drive(rows: npt.NDArray[Any], settings: RigSettings, period_s: float) -> Flags:
    """Position against speed, and both against the commands."""
    periods = round(PARITY_S / period_s)
    summed = np.cumsum(rows["speed_mm_s"]) * period_s
    found: Flags = np.abs(_changed(rows["position_mm"], periods) - _changed(summed, periods)) > PARITY_MM
    lagged = _lagged(rows, settings, period_s)
    off = np.abs(lagged - rows["speed_mm_s"]) > FOLLOWS_MM_S
    found |= ~keeping(rows["mode"]) & _held_for(off, round(FOLLOWS_S / period_s))
    periods = round(FOLLOWED_S / period_s)
    on = _held_for(rows["powered"] & ~keeping(rows["mode"]), periods)
    wanted = np.cumsum(lagged) * period_s
    return found | (on & (np.abs(_changed(rows["position_mm"], periods) - _changed(wanted, periods)) > FOLLOWED_MM))


def _payload(rows: npt.NDArray[Any], settings: RigSettings, period_s: float) -> Flags:
    """Stroke and tension that no payload explains: cell and stroke differ faster than one moves."""
    found = np.zeros(len(rows), bool)
    noise_mm = CELL_SIGMAS * settings.tension_cell.noise_n / settings.plant.stiffness_n_mm
    implied = rows["cell_n"] / settings.plant.stiffness_n_mm - rows["position_mm"]
    for speed_mm_s, seconds in PAYLOAD:
        periods = round(seconds / period_s)
        found |= np.abs(_changed(implied, periods)) > speed_mm_s * seconds + noise_mm
    return found


def _held_for(flags: Flags, periods: int) -> Flags:
    """Whether each flag and those of the periods before it are all set."""
    counted = np.concatenate([[0], np.cumsum(flags)])
    held = np.zeros(len(flags), bool)
    held[periods - 1 :] = counted[periods:] - counted[:-periods] == periods
    return held


def _mean(values: Floats, periods: int) -> Floats:
    """Mean of each value and those of the periods before it; 0 until there are as many."""
    summed = np.concatenate([[0.0], np.cumsum(values)])
    mean = np.zeros(len(values))
    mean[periods - 1 :] = (summed[periods:] - summed[:-periods]) / periods
    return mean


def _changed(values: Floats, periods: int) -> Floats:
    """Change of each value over the periods before it."""
    before = np.concatenate([np.full(min(periods, len(values)), values[0]), values[:-periods]])
    changed: Floats = values - before[: len(values)]
    return changed


def _lagged(rows: npt.NDArray[Any], settings: RigSettings, period_s: float) -> Floats:
    """Commands after the delay and lag of the drive; a drive that is off follows none."""
    share = period_s / settings.plant.cylinder_lag_s
    delay = max(1, round(settings.plant.command_delay_s / period_s) + 1)
    out, value = np.empty(len(rows)), 0.0
    for i, command in enumerate(np.concatenate([np.zeros(delay), rows["command_mm_s"]])[: len(rows)].tolist()):
        value += share * (command - value)
        out[i] = value
    return out
