"""Running the study: every case with the cylinder locked, as in the paper, and again with the loop closed."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from typing import Any, NamedTuple

import numpy as np

from hil.paper.cases import NO_SPRING, cases
from hil.paper.claims import TARGET_N
from hil.paper.signals import Signals
from hil.scenario.play import play
from rigctl.config.settings import RigSettings

WAIVER = "the paper's study shows every stiffness with this design, also where it misses the limit"
_MOST_WORKERS = 4


class Closed(NamedTuple):
    """A case with the loop closed: the truth, and how it ended."""

    signals: Signals
    eta_max_pct: float
    eta_rms_pct: float
    speed_max_mm_s: float
    stroke_mm: float
    ended: str
    waived: bool


class Study(NamedTuple):
    """All runs by case."""

    passive: dict[str, Signals]
    closed: dict[str, Closed]


def run(rig: RigSettings, done: Callable[[str], None]) -> Study:
    """Run every case both ways, on as many processors as there are; ``done`` is called after each with its name.

    Raises:
        ScenarioError: the rig cannot be simulated, or its design is refused.
    """
    names = [case.name for case in cases()]
    study = Study({}, {})
    workers = min(os.cpu_count() or 1, _MOST_WORKERS)
    with ProcessPoolExecutor(workers, multiprocessing.get_context("spawn")) as pool:
        places: dict[Future[Any], tuple[dict[str, Any], str]] = {}
        places |= {pool.submit(_closed, rig, name): (study.closed, name) for name in names}  # the slow ones first
        places |= {pool.submit(_passive, rig, name): (study.passive, name) for name in names}
        for future in as_completed(places):
            results, name = places[future]
            results[name] = future.result()
            done(name)
    return Study({n: study.passive[n] for n in names}, {n: study.closed[n] for n in names})


def runs() -> int:
    """Number of calls of ``done``."""
    return 2 * len(cases())


def _passive(rig: RigSettings, name: str) -> Signals:
    case = next(case for case in cases() if case.name == name)
    played = play(case.settings(rig), case.tracks, seconds=case.seconds, controller="locked", target_n=TARGET_N)
    return Signals.of(played.t_s, played.truth)


def _closed(rig: RigSettings, name: str) -> Closed:
    case = next(case for case in cases() if case.name == name)
    settings = case.settings(rig, waiver=WAIVER if name == NO_SPRING else None)
    played = play(settings, case.tracks, seconds=case.seconds, controller="loop", target_n=TARGET_N)
    signals = Signals.of(played.t_s, played.truth)
    eta = signals.eta_pct(TARGET_N)
    return Closed(
        signals,
        float(np.max(np.abs(eta))),
        float(np.sqrt(np.mean(eta**2))),
        float(np.max(np.abs(signals.speed_mm_s))),
        float(np.ptp(signals.stroke_mm)),
        played.ended.mode,
        settings.design.waiver is not None,
    )
