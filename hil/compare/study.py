"""Running the comparison: every law in every scenario, from the same seed, on as many processors as there are."""

from __future__ import annotations

import math
import multiprocessing
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from itertools import product
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hil.compare import cell, margins
from hil.compare.margins import Robustness
from hil.compare.rivals import CONTROLLERS, OURS, PASSIVE, Controller
from hil.compare.scenarios import Quantity, Scenario, scenarios
from hil.scenario.errors import ScenarioError
from hil.scenario.play import Played, play
from rigctl.config.settings import RigSettings

Floats = npt.NDArray[np.float64]

WAIVER = "the comparison shows every law on every rig, also where our design misses the limit"
SETTLED_PCT = 0.1
COMPENSATING, LOCKED, UNSTABLE = "COMPENSATING", "LOCKED", "UNSTABLE"
TAIL_S = 0.25
SWINGING = 0.5
"""Share of the speed limit: a loop oscillates by itself if the command's standard deviation over the last ``TAIL_S``
exceeds it. Shake and noise together cause 0.3 at most, oscillation between the limits 0.6 to 1."""
TRACE_STEP = 5
"""Every so many milliseconds of the truth, one sample is kept for the plots."""
ROBUSTNESS_S = 2.5
"""Cost of one law's robustness, in seconds of simulated time, for the progress bar."""
_MOST_WORKERS = 4


class Result(NamedTuple):
    """One law in one scenario; None where the run did not reach its end."""

    eta_max_pct: float | None
    eta_rms_pct: float | None
    speed_max_mm_s: float | None
    settle_s: float | None
    """Also None without a single event, and where the error does not settle."""
    ended: str
    """``COMPENSATING``, ``LOCKED``, ``UNSTABLE``, or how and when it tripped."""
    t_s: Floats
    eta_pct: Floats
    """Signed, for the plots; both empty where the run did not reach its beginning."""

    @property
    def whole(self) -> bool:
        """Whether the run reached its end as it should."""
        return self.ended in (COMPENSATING, LOCKED)


class Verdict(NamedTuple):
    """One limit of ours, judged."""

    scenario: str
    quantity: Quantity
    limit: float
    measured: float | None
    ok: bool


class Study(NamedTuple):
    """All results by scenario and controller, in the table's order."""

    rig: RigSettings
    scenarios: tuple[Scenario, ...]
    controllers: tuple[Controller, ...]
    results: dict[tuple[str, str], Result]
    robustness: dict[str, Robustness | None]
    """By controller, with the plant of the rig file; None for the locked cylinder."""
    with_cell: dict[str, Result]
    """Ours, by scenario, with the cell's systematic errors, see `hil.compare.cell`; empty where ours is not run."""

    def verdicts(self) -> Iterator[Verdict]:
        """Every limit of ours that can be judged: a ratio needs the passive run too."""
        for scenario in self.scenarios:
            ours, passive = (self.results.get((scenario.name, who)) for who in (OURS, PASSIVE))
            for quantity, most in scenario.limits:
                if ours is None or (passive is None and quantity == "eta_true_max_over_passive"):
                    continue
                found = _measured(quantity, ours, passive) if ours.whole else None
                yield Verdict(scenario.name, quantity, most, found, found is not None and found <= most)


def length_s(chosen: Sequence[Scenario], laws: Sequence[Controller]) -> float:
    """Seconds of simulated time that ``run`` reports to its ``done`` for these, in total."""
    played = len(laws) + any(law.name == OURS for law in laws)
    return sum(scenario.seconds for scenario in chosen) * played + ROBUSTNESS_S * len(laws)


def run(
    rig: RigSettings, chosen: Sequence[Scenario], laws: Sequence[Controller], done: Callable[[float, str], None]
) -> Study:
    """Run every law in every scenario, ours also with the cell's systematic errors, and find each law's robustness.

    Args:
        rig: with a ``simulation`` section.
        chosen: scenarios, in the table's order.
        laws: in the table's order.
        done: called after each run and each robustness with its length in seconds and its description.

    Raises:
        ScenarioError: the rig cannot be simulated.
    """
    # Long runs first, so that no processor is left alone with one at the end.
    order = sorted(product(chosen, laws), key=lambda pair: -pair[0].seconds)
    with ProcessPoolExecutor(min(os.cpu_count() or 1, _MOST_WORKERS), multiprocessing.get_context("spawn")) as pool:
        runs = {(s.name, law.name): pool.submit(_one, rig, s.name, law.name) for s, law in order}
        ours = any(law.name == OURS for law in laws)
        with_cell = {s.name: pool.submit(_one, cell.with_errors(rig), s.name, OURS) for s in chosen if ours}
        robust = {law.name: pool.submit(_robustness, rig, law.name) for law in laws}
        work: dict[Future[Any], tuple[float, str]] = {
            **{runs[s.name, law.name]: (s.seconds, f"{s.name}: {law.title}") for s, law in order},
            **{with_cell[s.name]: (s.seconds, f"{s.name}: ours, with the cell's errors") for s in chosen if ours},
            **{robust[law.name]: (ROBUSTNESS_S, f"robustness: {law.title}") for law in laws},
        }
        try:
            for future in as_completed(work):
                future.result()
                done(*work[future])
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return Study(
        rig,
        tuple(chosen),
        tuple(laws),
        {(s.name, law.name): runs[s.name, law.name].result() for s, law in product(chosen, laws)},
        {name: future.result() for name, future in robust.items()},
        {name: future.result() for name, future in with_cell.items()},
    )


def _robustness(rig: RigSettings, law_name: str) -> Robustness | None:
    return margins.robustness(rig, next(c for c in CONTROLLERS if c.name == law_name))


def _one(rig: RigSettings, scenario_name: str, law_name: str) -> Result:
    scenario = next(s for s in scenarios(rig) if s.name == scenario_name)
    law = next(c for c in CONTROLLERS if c.name == law_name)
    settings = scenario.settings(rig, WAIVER)
    try:
        played = play(
            settings,
            scenario.tracks,
            seconds=scenario.seconds,
            controller="locked" if law.name == PASSIVE else "loop",
            target_n=settings.tension.target_n,
            law=law.law,
        )
    except ScenarioError as error:
        if error.exit_code != 1:
            raise
        words = str(error).removeprefix(f"{settings.rig}: ")
        return Result(None, None, None, None, words, np.zeros(0), np.zeros(0))
    return judge(played, scenario, settings.tension.speed_max_mm_s)


def judge(played: Played, scenario: Scenario, speed_max_mm_s: float) -> Result:
    """The figures of a run, of the plant's truth over the scenario's window."""
    eta = (played.truth["vertical_n"] - played.target_n) / played.target_n * 100.0
    t_s = played.t_s
    ended = _ended(played, speed_max_mm_s)
    trace = t_s[::TRACE_STEP], eta[::TRACE_STEP]
    if ended not in (COMPENSATING, LOCKED):
        return Result(None, None, None, None, ended, *trace)
    inside = t_s >= scenario.from_s - 1e-7
    speed = played.truth["speed_mm_s"][inside]
    return Result(
        float(np.max(np.abs(eta[inside]))),
        math.sqrt(float(np.mean(eta[inside] ** 2))),
        float(np.max(np.abs(speed))),
        None if scenario.event_s is None else settling_s(t_s - scenario.event_s, eta),
        ended,
        *trace,
    )


def settling_s(t_s: Floats, eta_pct: Floats) -> float | None:
    """Time after 0 from which the error stays within ``SETTLED_PCT``; None if it is not within at the end."""
    outside = np.flatnonzero((np.abs(eta_pct) > SETTLED_PCT) & (t_s >= 0.0))
    if not len(outside):
        return 0.0
    if outside[-1] == len(eta_pct) - 1:
        return None
    return float(t_s[outside[-1] + 1])


def _ended(played: Played, speed_max_mm_s: float) -> str:
    ended, records = played.ended, played.records
    if ended.tripped:
        return f"tripped: {ended.fault} at {ended.tripped_at_s:.1f} s"
    if records is None:
        return LOCKED
    assert played.records_t_s is not None
    tail = records["command_mm_s"][played.records_t_s >= played.records_t_s[-1] - TAIL_S]
    return UNSTABLE if float(np.std(tail)) > SWINGING * speed_max_mm_s else ended.mode


def _measured(quantity: Quantity, ours: Result, passive: Result | None) -> float | None:
    if quantity == "eta_true_max_pct":
        return ours.eta_max_pct
    if quantity == "eta_true_rms_pct":
        return ours.eta_rms_pct
    if quantity == "settle_s":
        return ours.settle_s
    assert passive is not None and passive.eta_max_pct is not None and ours.eta_max_pct is not None
    return ours.eta_max_pct / passive.eta_max_pct
