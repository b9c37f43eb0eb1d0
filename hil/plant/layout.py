"""Memory layout of the compiled plant: parameters, state, and the channels of prescribed inputs."""

from __future__ import annotations

import numpy as np

MECHANISM = 0
"""Angle of the mechanism's rotation, rad."""
HEIGHT = 1
"""Vertical motion of the mechanism, mm, positive up (shortens the distance)."""
FLOOR_RADIAL, FLOOR_TANGENTIAL, FLOOR_VERTICAL = 2, 3, 4
"""Motion of the gantry against the mechanism's base, mm, along the mechanism's axes at angle 0."""
FORCE_TANGENTIAL, FORCE_NORMAL, FORCE_VERTICAL = 5, 6, 7
"""Force on the payload, N, along the mechanism's axes; moves it only along an axis of finite stiffness."""
MASS = 8
"""Change of the payload's mass, kg."""
RUN_OUT = 9
"""Level of the rail, mm, positive up; its argument is the rail's angle (rad from the start), not time."""
CHANNELS = 10

AXES = ("tangential", "normal", "vertical")


def _record(*names: str) -> np.dtype[np.void]:
    return np.dtype([(name, "<f8") for name in names])


PARAMETERS = _record(
    "rope_length",  # mm, between the lifting points in plumb
    "free_length",  # mm, of spring and rope at stroke 0
    "stiffness",  # N/mm
    "damping",  # N s/mm
    "rope_mass",  # t
    "elements",  # of the rope, 1 = straight
    "node_damping",  # N s/mm on a rope node that moves across the rope
    "radius",  # mm, mechanism
    "eccentricity_x",  # mm, rail's shaft from the mechanism's, along the mechanism's normal at angle 0
    "eccentricity_y",  # mm, along its tangent
    "rail_inertia",  # t mm2, about the shaft
    "rail_slope",  # mm/mm, level of the rail along itself, rising outwards
    "rail_static",
    "rail_dynamic",
    "rail_stribeck",  # mm/s
    "rail_viscous",  # N s/mm at the pulley's radius
    "pulley_mass",  # t
    "pulley_static",
    "pulley_dynamic",
    "pulley_stribeck",  # mm/s
    "pulley_viscous",  # N s/mm
    "dead_load",  # N, load of both friction pairs beside the rope's
    "payload_mass",  # t
    *(f"{axis}_{what}" for axis in AXES for what in ("free", "stiffness", "damping")),  # 1 or 0, N/mm, N s/mm
    "lag",  # s
    "lag_decay",  # over one step
    "drive_acceleration",  # mm/s2
    "drive_speed",  # mm/s
    "dead_band",  # mm/s
    "ripple",  # mm
    "screw_lead",  # mm
    "backlash",  # mm
    "seating_load",  # N
    "seating_time",  # s
    "stroke_low",  # mm
    "stroke_high",  # mm
)

STATE = _record(
    "phi",  # rad, rail
    "r",  # mm, pulley from the shaft
    "ut",  # mm, payload from where the mechanism prescribes it
    "un",
    "uz",
    "phi_rate",
    "r_rate",
    "ut_rate",
    "un_rate",
    "uz_rate",
    "phi_acceleration",  # over the last step
    "r_acceleration",
    "ut_acceleration",
    "un_acceleration",
    "uz_acceleration",
    "motor",  # mm, stroke as the motor has it
    "motor_before",
    "motor_speed",  # mm/s, as commanded
    "yielding",  # mm/s, what the load and the motor's torque add to it
    "play",  # mm, of the nut
    "stroke",  # mm, positive = shorter rope
    "tension",  # N, in the middle of the last step
)

VIEW = _record(
    "tension",  # N
    "vertical",  # N
    "tangential",  # rad, theta_x
    "normal",  # rad, theta_y
    "stroke",  # mm
    "speed",  # mm/s, of the motor as stroke
    "mechanism",  # rad
    "rail",  # rad
    "pulley",  # mm, from the shaft
    "height",  # mm, payload above where it is at rest
    "upper_tangential",  # mm/s2, acceleration of the pulley in the rail's frame
    "upper_normal",
    "lower_tangential",  # the same of the payload
    "lower_normal",
    "length",  # mm, between pulley and payload along the rope
    "stretch",  # mm, of spring and rope; negative = slack
    "drop",  # mm, vertical distance between pulley and payload
    "lower_x",  # mm, payload in the room's frame
    "lower_y",
    "upper_x",  # mm, pulley
    "upper_y",
)
