"""The runs: one out-and-back move, repeated, with each of the variants on each of the springs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hil.plant.layout import MECHANISM
from hil.runs import runner
from hil.runs.runner import Work
from hil.scenario.disturbances import rotation
from hil.scenario.kinds import OutAndBack
from hil.scenario.play import Advance, play
from hil.studies.moves.reversal_laws import Dithered, Predicting
from rigctl.config.changed_settings import changed
from rigctl.config.settings import LearningSettings, RigSettings
from rigctl.control.bus.inbox import Inbox
from rigctl.control.law.tension import Gains, TensionLaw
from rigctl.control.loop import LawFactory
from rigctl.metrics.tension_error import error_pct

Floats = npt.NDArray[np.float64]

SPRINGS_N_MM = (6.0, 34.0)
START_S, SPARE_S = 0.5, 1.5
LEARNING = LearningSettings(move_s=9.5, cutoff_hz=2.0)
"""As in `config/sets/learned_moves.yaml`."""
MOVES = 5
"""The first begins with a plumb rope and differs; the table of the second is played in the third."""
SEED = 14
_TRACE_STEP = 10


@dataclass(frozen=True, kw_only=True)
class Variant:
    """One row: a law, or marks for the learning."""

    name: str
    title: str
    law: LawFactory | None = None
    learns: bool = False
    late_s: float = 0.0
    """The marks come late by 0 to this time, at random."""
    moves: int = 2
    springs_n_mm: Sequence[float] = SPRINGS_N_MM


def _dithered(amplitude_mm: float, frequency_hz: float, settings: RigSettings, gains: Gains, _: Inbox) -> TensionLaw:
    return Dithered(settings, gains, amplitude_mm, frequency_hz)


def _by_rate(settings: RigSettings, gains: Gains, inbox: Inbox) -> TensionLaw:
    return Predicting(settings, gains, inbox, "rate")


def _by_acceleration(settings: RigSettings, gains: Gains, inbox: Inbox) -> TensionLaw:
    return Predicting(settings, gains, inbox, "acceleration")


def variants() -> tuple[Variant, ...]:
    """Every row of the table."""
    return (
        Variant(name="plain", title="as it is", moves=MOVES),
        *(
            Variant(
                name=f"dither_{micrometres}um_{hz}hz",
                title=f"dither {micrometres} um, {hz} Hz",
                law=partial(_dithered, micrometres * 1e-3, float(hz)),
            )
            for micrometres in (2, 20)
            for hz in (10, 40)
        ),
        Variant(name="predict_rate", title="predicted from the inclination's rate", law=_by_rate),
        Variant(name="predict_acceleration", title="predicted from rate and acceleration", law=_by_acceleration),
        Variant(name="learning", title="learning, marks on time", learns=True, moves=MOVES),
        *(
            Variant(
                name=f"learning_late_{milliseconds}ms",
                title=f"learning, marks up to {milliseconds} ms late",
                learns=True,
                late_s=milliseconds * 1e-3,
                moves=MOVES,
                springs_n_mm=SPRINGS_N_MM[-1:],
            )
            for milliseconds in (20, 100, 300)
        ),
    )


class MoveFigures(NamedTuple):
    """The true vertical error of one move, less its mean: the cell's drift is no matter of the law."""

    most_pct: float
    spread_pct: float


class RepeatedResult(NamedTuple):
    """One variant with one spring."""

    moves: tuple[MoveFigures, ...]
    ended: str
    t_s: Floats
    """Within a move."""
    errors_pct: tuple[Floats, ...]
    """Of each move, for the picture."""


def move() -> OutAndBack:
    """One out-and-back move of 6 deg at 2 deg/s, with the pauses in which the rope comes to rest."""
    return OutAndBack(
        kind="out_and_back", angle_deg=6.0, speed_deg_s=2.0, acceleration_deg_s2=2.0, start_s=START_S, dwell_s=SPARE_S
    )


def pieces(rig: RigSettings, chosen: Sequence[Variant]) -> dict[tuple[str, float], Work]:
    """The work: one run for each variant and spring, the longest first."""
    rows = sorted(chosen, key=lambda variant: -variant.moves)
    return {
        (row.name, k): Work(repeated, (rig, row, k), f"{row.title}, {k:g} N/mm", float(row.moves))
        for row in rows
        for k in row.springs_n_mm
    }


def study(rig: RigSettings, chosen: Sequence[Variant], advance: Advance) -> dict[tuple[str, float], RepeatedResult]:
    """Every chosen variant on its springs."""
    return runner.play(pieces(rig, chosen), advance)


def repeated(rig: RigSettings, variant: Variant, spring_n_mm: float) -> RepeatedResult:
    """The moves of one variant with one spring.

    Raises:
        ScenarioError: the rig cannot be simulated.
    """
    moves = move().model_copy(update={"repeats": variant.moves})
    track = rotation(moves)
    one_s = (track.end + SPARE_S - START_S) / variant.moves
    settings = changed(rig, {"plant.spring_n_mm": spring_n_mm})
    marks: list[tuple[float, int]] = []
    if variant.learns:
        settings = settings.model_copy(update={"learning": LEARNING})
        late_s = np.random.default_rng(SEED).uniform(0.0, variant.late_s, variant.moves)
        marks = [(START_S + i * one_s + float(late), 1) for i, late in enumerate(late_s)]
    target_n = settings.tension.target_n
    run = play(
        settings,
        {MECHANISM: track},
        seconds=START_S + variant.moves * one_s,
        controller="loop",
        target_n=target_n,
        law=variant.law,
        marks=marks,
    )
    eta = error_pct(run.truth["vertical_n"], target_n)
    index = ((run.t_s - START_S) // one_s).astype(int)
    errors = [eta[index == i] - np.mean(eta[index == i]) for i in range(variant.moves)]
    figures = tuple(MoveFigures(float(np.max(np.abs(e))), float(np.std(e))) for e in errors)
    t_s = np.arange(0.0, one_s, _TRACE_STEP / settings.loop.rate_hz)
    ended = f"tripped: {run.ended.fault}" if run.ended.tripped else run.ended.mode
    return RepeatedResult(figures, ended, t_s, tuple(e[::_TRACE_STEP][: len(t_s)] for e in errors))
