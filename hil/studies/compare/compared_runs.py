"""The runs of the comparison: changes of the rig file, prescribed motion, windows, and our limits."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, NamedTuple

from hil.plant.layout import FLOOR_VERTICAL, HEIGHT, MASS, MECHANISM, RUN_OUT
from hil.scenario.disturbances import floor_tone, heave, jolt, level_table, mass_change
from hil.scenario.kinds import FloorTone, Heave, Jolt, LevelPoint, LevelTable, MassChange
from hil.studies.planned_run import (
    RAMP_S,
    SPEED_DEG_S,
    STIFFNESSES_N_MM,
    TURN_DEG,
    PlannedRun,
    onwards,
    turn_and_return,
)
from rigctl.config.settings import RigSettings

STEADY_S = RAMP_S
"""Figures are taken from here on: the mechanism has reached its speed and the gantry shakes in full."""
FADE_S = 4.0
"""Fade of the vertical motion; a shorter one would exceed the speed limit."""
HEAVE_S = FADE_S + STEADY_S + 10.0
EVENT_S = 1.0
"""Time of a jolt or a change of mass; figures are taken from it on."""
MOVE_S = 15.0
"""Covers the lag's peak and one swing of the rope after it; with twice the friction the peak is at 8 s."""
LEVEL_MM = 1.5
NO_SPRING = {"plant.spring_n_mm": None, "design.stretch_weight": 80.0, "design.integral_weight": 60.0}
"""With our weights for a rig without a spring: a micrometre is a newton there, its margins are waived anyway."""
QUICK = ("paper_k6", "paper_k34", "vertical", "shake_3hz", "jolt", "mechanism_60")
"""The softest and the stiffest spring, each kind of disturbance, and a rig that differs from the design's model."""

Quantity = Literal["eta_true_max_pct", "eta_true_rms_pct", "settle_s", "eta_true_max_over_passive"]
Changes = Mapping[str, object]


class OurLimit(NamedTuple):
    """A bound on our law in a run."""

    quantity: Quantity
    most: float


@dataclass(frozen=True, kw_only=True)
class ComparedRun(PlannedRun):
    """One row of the table."""

    from_s: float
    """Figures are taken from here on."""
    limits: tuple[OurLimit, ...] = ()
    event_s: float | None = None
    """Settling is counted from here; None without a single event."""


def compared_runs(rig: RigSettings) -> tuple[ComparedRun, ...]:
    """Every run, in the order of the table; ``rig`` gives the base of values stated as multiples."""
    return (*_moves(), *_disturbances(), *_other_plants(rig))


def _error(most_pct: float, rms_pct: float) -> tuple[OurLimit, ...]:
    return OurLimit("eta_true_max_pct", most_pct), OurLimit("eta_true_rms_pct", rms_pct)


def _move(name: str, title: str, limits: tuple[OurLimit, ...], changes: Changes) -> ComparedRun:
    tracks = {MECHANISM: onwards(SPEED_DEG_S, MOVE_S)}
    title = f"paper move, {title}"
    return ComparedRun(
        name=name, title=title, tracks=tracks, seconds=MOVE_S, from_s=STEADY_S, changes=changes, limits=limits
    )


def _moves() -> list[ComparedRun]:
    """The paper's move with every spring and with none."""
    return [
        *(
            _move(f"paper_k{k:g}", f"k = {k:g} N/mm", _error(0.03, 0.008), {"plant.spring_n_mm": k})
            for k in STIFFNESSES_N_MM
        ),
        _move("no_spring", "no spring", _error(0.5, 0.15), NO_SPRING),
    ]


def _disturbances() -> list[ComparedRun]:
    """External disturbances on the rig of the file."""
    heaving = heave(Heave(kind="sine", amplitude_mm=10.0, frequency_hz=0.1, fade_s=FADE_S), HEAVE_S)
    jolting = jolt(Jolt(kind="step", height_mm=1.0, rise_s=0.02, at_s=EVENT_S))
    lighter = mass_change(MassChange(change_kg=-1.0, at_s=EVENT_S))
    return [
        ComparedRun(
            name="vertical",
            title="vertical motion 10 mm, 0.1 Hz",
            changes={"safety.heave_mm": 10.0},
            tracks={HEIGHT: heaving},
            seconds=HEAVE_S,
            from_s=FADE_S + STEADY_S,
            limits=_error(0.04, 0.015),
        ),
        _run_out(),
        *(_shake(hz, most) for hz, most in ((3.0, 0.7), (8.0, 1.3))),
        ComparedRun(
            name="jolt",
            title="jolt, 1 mm in 20 ms",
            tracks={HEIGHT: jolting},
            seconds=5.0,
            from_s=EVENT_S,
            limits=(OurLimit("settle_s", 0.4),),
            event_s=EVENT_S,
        ),
        ComparedRun(
            name="mass",
            title="1 kg taken off, K_m = 60 N/mm",
            tracks={MASS: lighter},
            seconds=8.0,
            from_s=EVENT_S,
            changes=_stands_on(60.0),
            event_s=EVENT_S,
        ),
    ]


def _run_out() -> ComparedRun:
    """The rail rises by ``LEVEL_MM`` over the way out, as a survey with its steepest place in the middle."""
    points = [LevelPoint(angle_deg=0.0, level_mm=0.0), LevelPoint(angle_deg=TURN_DEG, level_mm=LEVEL_MM)]
    move = turn_and_return()
    tracks = {MECHANISM: move, RUN_OUT: level_table(LevelTable(kind="table", points=points))}
    title = "run-out 1.5 mm, out and back"
    limits = _error(0.03, 0.01)
    return ComparedRun(name="run_out", title=title, tracks=tracks, seconds=move.end, from_s=STEADY_S, limits=limits)


def _shake(frequency_hz: float, most: float) -> ComparedRun:
    tone = FloorTone(kind="tone", axis="vertical", amplitude_mm=0.05, frequency_hz=frequency_hz)
    seconds = STEADY_S + 4.0
    return ComparedRun(
        name=f"shake_{frequency_hz:g}hz",
        title=f"shake 0.05 mm, {frequency_hz:g} Hz",
        tracks={FLOOR_VERTICAL: floor_tone(tone, seconds)},
        seconds=seconds,
        from_s=STEADY_S,
        limits=(OurLimit("eta_true_max_over_passive", most),),
    )


def _other_plants(rig: RigSettings) -> list[ComparedRun]:
    """The paper's move on rigs that differ from the model of loop and design."""
    simulation = rig.simulation
    assert simulation is not None  # the command refuses a rig without it
    rubbing = {
        f"simulation.{name}.{key}": 2.0 * getattr(getattr(simulation, name), key)
        for name in ("rail", "pulley")
        for key in ("friction_static", "friction_dynamic")
    }
    whole: dict[str, tuple[str, Changes]] = {
        "friction_x2": ("friction x2", rubbing),
        "mechanism_60": ("K_m = 60 N/mm", _stands_on(60.0)),
        "mechanism_6": ("K_m = 6 N/mm", _stands_on(6.0)),
        "delay_x2": ("delay x2", {"simulation.delay_scale": 2.0 * simulation.delay_scale}),
        "stiffer_20": ("k +20 %", {"simulation.stiffness_scale": 1.2 * simulation.stiffness_scale}),
        "softer_20": ("k -20 %", {"simulation.stiffness_scale": 0.8 * simulation.stiffness_scale}),
    }
    return [_move(name, title, _error(0.08, 0.03), changes) for name, (title, changes) in whole.items()]


def _stands_on(vertical_n_mm: float) -> Changes:
    """A mechanism that is not rigid vertically, though the design assumes it is."""
    return {"simulation.mechanism.vertical_n_mm": vertical_n_mm}
