"""The least error that any law reaches in each run of the comparison, on the run's own nominal plant.

Of the sines it is that of `TONES`. Of the others the disturbance is what the simulated rig does with its cylinder
locked: for the moves by any linear law that reads the cell, for the jolt by any law whose command keeps the drive's
limits. A change of mass has none: that last law has all of the disturbance beforehand, and cancels its vibration. A law
that reads the inclination may be below the bound of a move.
"""

from __future__ import annotations

from typing import Any

from hil.runs.rows_file import RowsFile
from hil.scenario.play import play
from hil.studies.compare.bound import program
from hil.studies.compare.bound.linear_law import Disturbance, NoBoundError
from hil.studies.compare.bound.nominal import JOLT, MOVE_MEMORY_S, TONES, Nominal
from hil.studies.compare.compared_runs import ComparedRun
from hil.studies.compare.comparison import WAIVER
from hil.studies.compare.equal_limits import Known
from rigctl.config.settings import RigSettings


def bound_pct(rig: RigSettings, run: ComparedRun, rows: RowsFile) -> float | None:
    """The bound of a run's rms error, % of the target; None where no law keeps the limits, or there is no program."""
    key = f"least {run.name}"
    kept: dict[str, Any] | None = rows.get(key)
    if kept is None:
        settings = run.settings(rig, WAIVER)
        try:
            least_n = _least_n(Nominal(Known.of(settings).settings), settings, run)
        except NoBoundError as error:
            kept = rows.put(key, {"bound_pct": None, "why": str(error)})
        else:
            kept = rows.put(key, {"bound_pct": 100.0 * least_n / settings.tension.target_n})
    found: float | None = kept["bound_pct"]
    return found


def _least_n(here: Nominal, settings: RigSettings, run: ComparedRun) -> float:
    if run.name in TONES:
        return program.least(here.short, here.tone(run.name)).value
    if run.name == JOLT:
        return here.least_jolt(locked(settings, run))
    if run.event_s is not None:
        raise NoBoundError("no bound of a single event but the jolt")
    return program.least(here.task(MOVE_MEMORY_S), locked(settings, run)).value


def locked(settings: RigSettings, run: ComparedRun) -> Disturbance:
    """The error of the vertical force with the cylinder locked, N, in each tick; both as read and as it is."""
    truth = play(
        settings, run.tracks, seconds=run.seconds, controller="locked", target_n=settings.tension.target_n
    ).truth[:-1]  # fmt: skip
    error_n = truth["vertical_n"] - truth["vertical_n"][0]
    return Disturbance(error_n, error_n, round(run.from_s * settings.loop.rate_hz))
