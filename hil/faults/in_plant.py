"""Faults of rope, spring, payload and screw."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial

import numpy as np

from hil.faults.stand import FaultPlace, Injector, Needs, Stand, Step
from hil.plant import Plant
from hil.plant.inputs import Track
from hil.plant.layout import HEIGHT, MECHANISM
from hil.plant.moves import leg
from hil.scenario import disturbances, kinds
from rigctl.model.parts import Part

_of = partial(Injector, FaultPlace.PLANT)
_ROPE, _PAYLOAD = (Part.ROPE,), (Part.PAYLOAD,)
GONE_MM = 1000.0
ROPE_N_MM = 1000.0
"""Stiffness of the rope alone, which is left where a spring with a safety chain has broken."""
CHAIN_MM = 20.0
_LET_GO_MM_S, _LET_GO_MM_S2 = 30.0, 1000.0
"""A payload that is let go of moves so fast, and changes its speed so fast."""


def rope_breaks() -> Injector:
    """The load is off the rope."""

    def inject(stand: Stand) -> None:
        stand.plant.parameters["free_length"] += GONE_MM

    return _of(_ROPE, inject)


def rope_slips(speed_mm_s: float, length_mm: float) -> Injector:
    """The rope slips through its clamp."""

    def inject(stand: Stand) -> Step:
        start = float(stand.plant.parameters["free_length"][0])

        def step(t_s: float) -> None:
            stand.plant.parameters["free_length"] = start + min(speed_mm_s * t_s, length_mm)

        return step

    return _of(_ROPE, inject)


def spring_breaks() -> Injector:
    """The spring's chain takes over, 20 mm longer than the spring was stretched, and as stiff as the rope."""

    def inject(stand: Stand) -> None:
        p, truth = stand.plant.parameters, stand.plant.truth
        p["free_length"] += truth.tension_n / p["stiffness"] + CHAIN_MM
        p["stiffness"] = ROPE_N_MM

    return _of(_ROPE, inject)


def spring_stiffens(factor: float) -> Injector:
    """Blocked coils make the spring stiffer, at the present tension."""

    def inject(stand: Stand) -> None:
        p, truth = stand.plant.parameters, stand.plant.truth
        stretch_mm = truth.tension_n / p["stiffness"]
        p["free_length"] += stretch_mm * (1.0 - 1.0 / factor)
        p["stiffness"] *= factor

    return _of(_ROPE, inject)


def backlash(factor: float) -> Injector:
    """The nut has worn."""

    def inject(stand: Stand) -> None:
        stand.plant.parameters["backlash"] *= factor

    return _of((Part.DRIVE,), inject)


def payload_moves(up_mm: float, speed_mm_s: float) -> Injector:
    """The payload is pulled up or down, against the rope."""
    lift = kinds.Lift(kind="move", up_mm=up_mm, speed_mm_s=speed_mm_s, acceleration_mm_s2=1000.0)
    return _moved({HEIGHT: disturbances.vertical_move(lift)})


def payload_jolts(height_mm: float, rise_s: float) -> Injector:
    """A bump lifts the payload and leaves it slightly higher."""
    jolt = kinds.Jolt(kind="step", height_mm=height_mm, rise_s=rise_s, at_s=0.0)
    return _moved({HEIGHT: disturbances.jolt(jolt)})


def let_go_of(plant: Plant) -> None:
    """A payload that was pulled down goes up to where it hung; one that was lifted stays."""
    height_mm = plant.truth.height_mm
    if height_mm < 0.0:
        rows, end_s = leg(0.0, height_mm, 0.0, _LET_GO_MM_S, _LET_GO_MM_S2)
        plant.start_motion({HEIGHT: Track(segments=np.array(rows), end=end_s)}, plant.t_ns)


def nothing() -> Injector:
    """No injected fault: the row's surroundings are the fault."""
    return _of((), lambda _: None, Needs.START)


def heaving() -> Mapping[int, Track]:
    """The payload goes up and down by 1 mm at 1 Hz, 6 mm/s, so that the cylinder has to move."""
    sine = kinds.Heave(kind="sine", amplitude_mm=1.0, frequency_hz=1.0, fade_s=0.1)
    return {HEIGHT: disturbances.heave(sine, 60.0)}


def rotating() -> Mapping[int, Track]:
    """The mechanism turns as in the paper: the rope leans."""
    turn = kinds.Rotate(kind="rotate", angle_deg=13.0, speed_deg_s=0.5, acceleration_deg_s2=2.0)
    return {MECHANISM: disturbances.rotation(turn)}


def rising(up_mm: float, speed_mm_s: float) -> Callable[[], Mapping[int, Track]]:
    """The payload rises slowly enough for the cylinder to follow."""
    lift = kinds.Lift(kind="move", up_mm=up_mm, speed_mm_s=speed_mm_s, acceleration_mm_s2=100.0)
    return lambda: {HEIGHT: disturbances.vertical_move(lift)}


def _moved(tracks: Mapping[int, Track]) -> Injector:
    return _of(_PAYLOAD, lambda stand: stand.plant.start_motion(tracks, stand.plant.t_ns))
