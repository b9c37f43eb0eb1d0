"""The scenarios of the comparison: changes of the rig file, prescribed motion, windows, and our limits."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Literal, NamedTuple

import numpy as np

from hil.plant.inputs import Track
from hil.plant.layout import FLOOR_VERTICAL, HEIGHT, MASS, MECHANISM, RUN_OUT
from hil.plant.moves import leg, out_and_back
from hil.scenario.disturbances import floor_tone, heave, jolt, level_table, mass_change
from hil.scenario.kinds import FloorTone, Heave, Jolt, LevelPoint, LevelTable, MassChange
from rigctl.config.settings import RigSettings

STEADY_S = 2.0
"""Figures are taken from here on: the mechanism has reached its speed and the gantry shakes in full."""
FADE_S = 2.0
"""Fade of the vertical motion; a shorter one would exceed the speed limit."""
HEAVE_S = FADE_S + STEADY_S + 10.0
EVENT_S = 1.0
"""Time of a jolt or a change of mass; figures are taken from it on."""
STIFFNESSES_N_MM = (6.0, 13.0, 20.0, 27.0, 34.0)
SPEED_DEG_S, TURN_DEG = 0.5, 13.0
MOVE_S = 15.0
"""Covers the lag's peak and one swing of the rope after it; with twice the friction the peak is at 8 s."""
LEVEL_MM = 1.5
NO_SPRING_DESIGN = {"stretch_weight": 80.0, "integral_weight": 60.0}
"""Our weights for a rig without a spring: a micrometre is a newton there, and its margins are waived anyway."""
QUICK = ("paper_k6", "paper_k34", "vertical", "shake_3hz", "jolt", "mechanism_60")
"""The softest and the stiffest spring, each kind of disturbance, and a rig that differs from the design's model."""

Quantity = Literal["eta_true_max_pct", "eta_true_rms_pct", "settle_s", "eta_true_max_over_passive"]
Changes = Mapping[str, Mapping[str, Any]]


class Limit(NamedTuple):
    """A bound on our law in a scenario."""

    quantity: Quantity
    most: float


class Scenario(NamedTuple):
    """One row of the table."""

    name: str
    title: str
    tracks: Mapping[int, Track]
    seconds: float
    from_s: float
    plant: Mapping[str, Any]
    """Laid over the rig file's ``plant``: known to loop and design."""
    simulation: Changes
    """Laid over sections of ``simulation`` (a value of its own under ""): known to the plant only."""
    limits: tuple[Limit, ...]
    event_s: float | None = None
    """Settling is counted from here; None without a single event."""
    design: Mapping[str, Any] | None = None
    """Laid over the rig file's ``design``: our weights where the rig is a different one."""

    def settings(self, rig: RigSettings, waiver: str) -> RigSettings:
        """The rig of this scenario; ``waiver`` lets a design run that misses ``design.ms_max``."""
        assert rig.simulation is not None  # the command refuses a rig without it
        simulation = rig.simulation.model_copy(update=dict(self.simulation.get("", {})))
        sections = {
            name: getattr(simulation, name).model_copy(update=dict(changed))
            for name, changed in self.simulation.items()
            if name
        }
        update: dict[str, Any] = {
            "plant": rig.plant.model_copy(update=dict(self.plant)),
            "simulation": simulation.model_copy(update=sections),
        }
        design = dict(self.design or {}) | ({"waiver": waiver} if rig.design.waiver is None else {})
        update["design"] = rig.design.model_copy(update=design)
        return rig.model_copy(update=update)


def scenarios(rig: RigSettings) -> tuple[Scenario, ...]:
    """Every scenario, in the order of the table; ``rig`` gives the base of values stated as multiples."""
    assert rig.simulation is not None
    return (*_moves(), *_disturbances(), *_other_plants(rig))


def _error(most_pct: float, rms_pct: float) -> tuple[Limit, ...]:
    return Limit("eta_true_max_pct", most_pct), Limit("eta_true_rms_pct", rms_pct)


def _onwards() -> Track:
    """Rotation at constant speed to beyond the end of the run."""
    top = math.radians(SPEED_DEG_S)
    rows, _ = leg(0.0, 0.0, 2.0 * top * MOVE_S, top, top / STEADY_S)
    return Track(segments=np.array(rows), end=MOVE_S)


def _move(
    name: str,
    title: str,
    limits: tuple[Limit, ...],
    plant: Mapping[str, Any] | None = None,
    simulation: Changes | None = None,
) -> Scenario:
    return Scenario(name, title, {MECHANISM: _onwards()}, MOVE_S, STEADY_S, plant or {}, simulation or {}, limits)


def _moves() -> list[Scenario]:
    """The paper's move with every spring and with none."""
    runs = [
        _move(f"paper_k{k:g}", f"paper move, k = {k:g} N/mm", _error(0.03, 0.008), {"spring_n_mm": k})
        for k in STIFFNESSES_N_MM
    ]
    bare = _move("no_spring", "paper move, no spring", _error(0.5, 0.15), {"spring_n_mm": None})
    return [*runs, bare._replace(design=NO_SPRING_DESIGN)]


def _disturbances() -> list[Scenario]:
    """External disturbances on the rig of the file."""
    heaving = heave(Heave(kind="sine", amplitude_mm=10.0, frequency_hz=0.1, fade_s=FADE_S), HEAVE_S)
    jolting = jolt(Jolt(kind="step", height_mm=1.0, rise_s=0.02, at_s=EVENT_S))
    lighter = mass_change(MassChange(change_kg=-1.0, at_s=EVENT_S))
    return [
        Scenario(
            "vertical",
            "vertical motion 10 mm, 0.1 Hz",
            {HEIGHT: heaving},
            HEAVE_S,
            FADE_S + STEADY_S,
            {},
            {},
            _error(0.04, 0.015),
        ),
        _run_out(),
        *(_shake(hz, most) for hz, most in ((3.0, 0.7), (8.0, 1.3))),
        Scenario(
            "jolt", "jolt, 1 mm in 20 ms", {HEIGHT: jolting}, 5.0, EVENT_S, {}, {}, (Limit("settle_s", 0.4),), EVENT_S
        ),
        Scenario(
            "mass", "1 kg taken off, K_m = 60 N/mm", {MASS: lighter}, 8.0, EVENT_S, {}, _stands_on(60.0), (), EVENT_S
        ),
    ]


def _run_out() -> Scenario:
    """The rail rises by ``LEVEL_MM`` over the way out, as a survey with its steepest place in the middle."""
    points = [LevelPoint(angle_deg=0.0, level_mm=0.0), LevelPoint(angle_deg=TURN_DEG, level_mm=LEVEL_MM)]
    top = math.radians(SPEED_DEG_S)
    move = out_and_back(math.radians(TURN_DEG), top, top / STEADY_S)
    tracks = {MECHANISM: move, RUN_OUT: level_table(LevelTable(kind="table", points=points))}
    title = "run-out 1.5 mm, out and back"
    return Scenario("run_out", title, tracks, move.end, STEADY_S, {}, {}, _error(0.03, 0.01))


def _shake(frequency_hz: float, most: float) -> Scenario:
    tone = FloorTone(kind="tone", axis="vertical", amplitude_mm=0.05, frequency_hz=frequency_hz)
    seconds = STEADY_S + 4.0
    return Scenario(
        f"shake_{frequency_hz:g}hz",
        f"shake 0.05 mm, {frequency_hz:g} Hz",
        {FLOOR_VERTICAL: floor_tone(tone, seconds)},
        seconds,
        STEADY_S,
        {},
        {},
        (Limit("eta_true_max_over_passive", most),),
    )


def _other_plants(rig: RigSettings) -> list[Scenario]:
    """The paper's move on rigs that differ from the model of loop and design."""
    limits = _error(0.08, 0.03)
    simulation = rig.simulation
    assert simulation is not None
    rubbing = {
        name: {key: 2.0 * getattr(getattr(simulation, name), key) for key in ("friction_static", "friction_dynamic")}
        for name in ("rail", "pulley")
    }
    whole: dict[str, tuple[str, Changes]] = {
        "friction_x2": ("friction x2", rubbing),
        "mechanism_60": ("K_m = 60 N/mm", _stands_on(60.0)),
        "mechanism_6": ("K_m = 6 N/mm", _stands_on(6.0)),
        "delay_x2": ("delay x2", {"": {"delay_scale": 2.0 * simulation.delay_scale}}),
        "stiffer_20": ("k +20 %", {"": {"stiffness_scale": 1.2 * simulation.stiffness_scale}}),
        "softer_20": ("k -20 %", {"": {"stiffness_scale": 0.8 * simulation.stiffness_scale}}),
    }
    return [_move(name, f"paper move, {title}", limits, None, changes) for name, (title, changes) in whole.items()]


def _stands_on(vertical_n_mm: float) -> Changes:
    """A mechanism that is not rigid vertically, though the design assumes it is."""
    return {"mechanism": {"vertical_n_mm": vertical_n_mm}}
