"""Running the study: every case with the cylinder locked, as in the paper, and again with the loop closed."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hil.runs import runner
from hil.runs.runner import Work
from hil.scenario.play import Advance, play
from hil.studies.paper.cases import NO_SPRING, cases
from hil.studies.paper.claims import TARGET_N
from hil.studies.paper.run_truth import RunTruth
from hil.studies.planned_run import PlannedRun
from rigctl.config.settings import RigSettings
from rigctl.metrics.tension_error import largest_and_rms_pct

WAIVER = "the paper's study shows every stiffness with this design, also where it misses the limit"


class ClosedRun(NamedTuple):
    """A case with the loop closed: the truth, and how it ended."""

    truth: RunTruth
    eta_max_pct: float
    eta_rms_pct: float
    speed_max_mm_s: float
    stroke_mm: float
    ended: str
    waived: bool


class PaperStudy(NamedTuple):
    """All runs by case."""

    passive: dict[str, RunTruth]
    closed: dict[str, ClosedRun]


def run(rig: RigSettings, advance: Advance) -> PaperStudy:
    """Run every case both ways; ``advance`` is called after each of ``runs()``.

    Raises:
        ScenarioError: the rig cannot be simulated, or its design is refused.
    """
    pieces = {  # the slow ones first
        (how, case.name): Work(how, (rig, case), f"{case.name} done") for how in (_closed, _passive) for case in cases()
    }
    found = runner.play(pieces, advance)
    passive, closed = ({case.name: found[how, case.name] for case in cases()} for how in (_passive, _closed))
    return PaperStudy(passive, closed)


def runs() -> int:
    """Number of runs of the study."""
    return 2 * len(cases())


def _passive(rig: RigSettings, case: PlannedRun) -> RunTruth:
    settings = case.settings(rig)
    return RunTruth.of(play(settings, case.tracks, seconds=case.seconds, controller="locked", target_n=TARGET_N))


def _closed(rig: RigSettings, case: PlannedRun) -> ClosedRun:
    settings = case.settings(rig, WAIVER if case.name == NO_SPRING else None)
    played = play(settings, case.tracks, seconds=case.seconds, controller="loop", target_n=TARGET_N)
    truth = RunTruth.of(played)
    return ClosedRun(
        truth,
        *largest_and_rms_pct(truth.vertical_n, TARGET_N),
        float(np.max(np.abs(truth.speed_mm_s))),
        float(np.ptp(truth.stroke_mm)),
        played.ended.mode,
        settings.design.waiver is not None,
    )
