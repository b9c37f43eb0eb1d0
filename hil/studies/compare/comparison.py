"""Running the comparison: every law in every run, from the same seed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hil.runs import runner
from hil.runs.runner import Work
from hil.scenario.errors import ScenarioError
from hil.scenario.play import Advance, Played, play
from hil.studies.compare import cell, law_robustness
from hil.studies.compare.compared_runs import ComparedRun, Quantity
from hil.studies.compare.law_robustness import Robustness
from hil.studies.compare.rivals import LAWS, OURS, PASSIVE, ComparedLaw
from rigctl.config.settings import RigSettings
from rigctl.ipc.correction import Correction
from rigctl.metrics.tension_error import error_pct, largest_and_rms_pct

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
_CELL, _COMMISSIONED, _ROBUSTNESS = "cell", "commissioned", "robustness"


class LawResult(NamedTuple):
    """One law in one run; None where the run did not reach its end."""

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


class LimitVerdict(NamedTuple):
    """One limit of ours, judged."""

    scenario: str
    quantity: Quantity
    limit: float
    measured: float | None
    ok: bool


class Comparison(NamedTuple):
    """All results by run and law, in the table's order."""

    rig: RigSettings
    runs: tuple[ComparedRun, ...]
    laws: tuple[ComparedLaw, ...]
    results: dict[tuple[str, str], LawResult]
    robustness: dict[str, Robustness | None]
    """By law, with the plant of the rig file; None for the locked cylinder."""
    with_cell: dict[str, LawResult]
    """Ours, by run, with the cell's systematic errors, see `hil.studies.compare.cell`; empty where ours is not run."""
    with_commissioned: dict[str, LawResult]
    """The same with the cell tared, calibrated and its creep and drift taken out; empty without `calibration`."""

    def verdicts(self) -> Iterator[LimitVerdict]:
        """Every limit of ours that can be judged: a ratio needs the passive run too."""
        for run in self.runs:
            ours, passive = (self.results.get((run.name, law)) for law in (OURS, PASSIVE))
            for quantity, most in run.limits:
                if ours is None or (passive is None and quantity == "eta_true_max_over_passive"):
                    continue
                found = _measured(quantity, ours, passive) if ours.whole else None
                yield LimitVerdict(run.name, quantity, most, found, found is not None and found <= most)


def pieces(rig: RigSettings, chosen: Sequence[ComparedRun], laws: Sequence[ComparedLaw]) -> dict[tuple[str, str], Work]:
    """The work by ``(run, law)``, ``(run, "cell")``, ``(run, "commissioned")`` and ``("robustness", law)``."""
    longest_first = sorted(chosen, key=lambda run: -run.seconds)
    found = {
        (run.name, law.name): Work(result_of, (rig, run, law.name), f"{run.name}: {law.title}", run.seconds)
        for run in longest_first
        for law in laws
    }
    if any(law.name == OURS for law in laws):
        wrong, title = cell.with_errors(rig), "ours, with the cell's errors"
        found |= {
            (run.name, _CELL): Work(result_of, (wrong, run, OURS), f"{run.name}: {title}", run.seconds)
            for run in chosen
        }
        if rig.calibration is not None:
            known, title = cell.commissioned(rig), "ours, with the commissioned cell"
            found |= {
                (run.name, _COMMISSIONED): Work(
                    result_of, (known.rig, run, OURS, known.correction), f"{run.name}: {title}", run.seconds
                )
                for run in chosen
            }
    return found | {
        (_ROBUSTNESS, law.name): Work(_robustness, (rig, law.name), f"robustness: {law.title}", ROBUSTNESS_S)
        for law in laws
    }


def compare(
    rig: RigSettings, chosen: Sequence[ComparedRun], laws: Sequence[ComparedLaw], advance: Advance
) -> Comparison:
    """Run every law in every run; ``advance`` is called after each of the ``pieces``.

    Raises:
        ScenarioError: the rig cannot be simulated.
    """
    found = runner.play(pieces(rig, chosen, laws), advance)
    return Comparison(
        rig,
        tuple(chosen),
        tuple(laws),
        {(run.name, law.name): found[run.name, law.name] for run in chosen for law in laws},
        {law.name: found[_ROBUSTNESS, law.name] for law in laws},
        {run.name: found[run.name, _CELL] for run in chosen if (run.name, _CELL) in found},
        {run.name: found[run.name, _COMMISSIONED] for run in chosen if (run.name, _COMMISSIONED) in found},
    )


def _robustness(rig: RigSettings, law: str) -> Robustness | None:
    return law_robustness.robustness(rig, LAWS[law])


def result_of(rig: RigSettings, run: ComparedRun, law: str, correction: Correction | None = None) -> LawResult:
    """One law in one run; ``correction``: of the cell, from its ledger."""
    settings = run.settings(rig, WAIVER)
    try:
        played = play(
            settings,
            run.tracks,
            seconds=run.seconds,
            controller="locked" if law == PASSIVE else "loop",
            target_n=settings.tension.target_n,
            law=LAWS[law].law,
            correction=correction,
        )
    except ScenarioError as error:
        if error.exit_code != 1:
            raise
        words = str(error).removeprefix(f"{settings.rig}: ")
        return LawResult(None, None, None, None, words, np.zeros(0), np.zeros(0))
    return judge(played, run, settings.tension.speed_max_mm_s)


def judge(played: Played, run: ComparedRun, speed_max_mm_s: float) -> LawResult:
    """The figures of a run, of the plant's truth over the run's window."""
    eta, t_s = error_pct(played.truth["vertical_n"], played.target_n), played.t_s
    ended = _ended(played, speed_max_mm_s)
    trace = t_s[::TRACE_STEP], eta[::TRACE_STEP]
    if ended not in (COMPENSATING, LOCKED):
        return LawResult(None, None, None, None, ended, *trace)
    inside = played.truth[t_s >= run.from_s - 1e-7]
    return LawResult(
        *largest_and_rms_pct(inside["vertical_n"], played.target_n),
        float(np.max(np.abs(inside["speed_mm_s"]))),
        None if run.event_s is None else settling_s(t_s - run.event_s, eta),
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


def _measured(quantity: Quantity, ours: LawResult, passive: LawResult | None) -> float | None:
    if quantity == "eta_true_max_pct":
        return ours.eta_max_pct
    if quantity == "eta_true_rms_pct":
        return ours.eta_rms_pct
    if quantity == "settle_s":
        return ours.settle_s
    assert passive is not None and passive.eta_max_pct is not None and ours.eta_max_pct is not None
    return ours.eta_max_pct / passive.eta_max_pct
