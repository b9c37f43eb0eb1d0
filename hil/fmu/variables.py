"""The FMU's variables in the order of their value references: one row each."""

from __future__ import annotations

import math
from dataclasses import dataclass

from hil.plant.layout import PARAMETERS
from hil.plant.parameters import parameters
from rigctl.config.settings import RigSettings

BAKED = ("elements", "lag_decay")
"""Parameters that follow from others, or that memory is laid out by."""


@dataclass(frozen=True)
class Variable:
    """``c_name``: of its reference in C, empty for none; ``start`` None: the FMU works it out."""

    name: str
    c_name: str
    causality: str
    variability: str
    unit: str
    meaning: str
    start: float | None = None
    is_boolean: bool = False


def _output(name: str, c_name: str, unit: str, meaning: str) -> Variable:
    return Variable(name, c_name, "output", "continuous", unit, meaning)


def _input(name: str, c_name: str, unit: str, meaning: str) -> Variable:
    return Variable(name, c_name, "input", "discrete", unit, meaning, 0.0)


OUTPUTS = (
    Variable("time", "TIME", "independent", "continuous", "s", "time"),
    _output("tension_n", "OUT_TENSION", "N", "tension of the rope"),
    _output("vertical_n", "OUT_VERTICAL", "N", "its vertical component"),
    _output("tangential_rad", "OUT_TANGENTIAL", "rad", "inclination along the move"),
    _output("normal_rad", "OUT_NORMAL", "rad", "inclination along the rail"),
    _output("stroke_mm", "OUT_STROKE", "mm", "stroke of the cylinder, positive shortens the rope"),
    _output("speed_mm_s", "OUT_SPEED", "mm/s", "speed of the cylinder"),
    _output("mechanism_rad", "OUT_MECHANISM", "rad", "angle of the mechanism"),
    _output("rail_rad", "OUT_RAIL", "rad", "angle of the rail from its start"),
    _output("pulley_mm", "OUT_PULLEY", "mm", "place of the pulley on the rail from its start"),
    _output("height_mm", "OUT_HEIGHT", "mm", "payload above where it is at rest"),
)
INPUTS = (
    _input("command_mm_s", "COMMAND", "mm/s", "speed that the drive is told, positive shortens the rope"),
    Variable("braked", "BRAKED", "input", "discrete", "", "whether the brake holds", 1.0, is_boolean=True),
    _input("force_tangential_n", "FIRST_FORCE", "N", "force on the payload along the move"),
    _input("force_normal_n", "", "N", "force on the payload outwards"),
    _input("force_vertical_n", "", "N", "force on the payload, positive up"),
    _input("extra_mass_kg", "", "kg", "change of the payload's mass"),
)


def _own(settings: RigSettings) -> tuple[Variable, ...]:
    simulation, demo = settings.simulation, settings.demo
    assert simulation is not None
    degrees = (demo.angle_deg, demo.speed_deg_s, demo.acceleration_deg_s2) if demo is not None else (0.0, 1.0, 1.0)
    delay_s = settings.plant.command_delay_s * simulation.delay_scale

    def row(name: str, c_name: str, unit: str, meaning: str, start: float) -> Variable:
        return Variable(name, c_name, "parameter", "fixed", unit, meaning, start)

    angle, speed, acceleration = map(math.radians, degrees)
    return (
        row("preload_n", "PRELOAD", "N", "tension at the start, at rest; 0: the rope is slack", 0.0),
        row("move_angle_rad", "MOVE_ANGLE", "rad", "the mechanism moves out by this and back; 0: it stands", angle),
        row("move_speed_rad_s", "MOVE_SPEED", "rad/s", "speed of that move", speed),
        row("move_acceleration_rad_s2", "MOVE_ACCELERATION", "rad/s2", "acceleration of that move", acceleration),
        row("move_start_s", "MOVE_START", "s", "when it begins", 0.0),
        row("command_delay_s", "COMMAND_DELAY", "s", "from a command to its effect", delay_s),
        row("rest_share", "REST_SHARE", "", "where the pulley rests, as a share of its friction",
            simulation.pulley.rest_share),
    )  # fmt: skip


def variables(settings: RigSettings) -> tuple[Variable, ...]:
    """All variables; parameters of the plant start at the values of a rig file.

    Raises:
        ValueError: no ``simulation`` section, or a step too long for the plant.
    """
    simulation = settings.simulation
    if simulation is None:
        raise ValueError("simulation: found nothing, expected a section (it says what rig to simulate)")
    record = parameters(settings, simulation)[0]
    plant = tuple(
        Variable(f"plant.{name}", "", "parameter", "fixed", "", "see hil/plant/layout.py (mm, N, t, s)", record[name])
        for name in PARAMETERS.names or ()
        if name not in BAKED
    )
    return (*OUTPUTS, *INPUTS, *_own(settings), *plant)
