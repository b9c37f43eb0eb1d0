"""The paper's coordinates q = [x y l theta_x theta_y] and the plant's (phi, r, u_t, u_n, u_z).

The paper's x and y are the pulley's place in its plane: x along the mechanism's tangent and y along its outward normal,
both at mechanism angle 0, from the mechanism's axis; l is the distance between the lifting points, theta_x and theta_y
lean the rope along x and y. Equation (1), which the lower lifting point follows from, with the rope straight::

    r_l = [x + l sin(theta_x), y + l cos(theta_x) sin(theta_y), z - l cos(theta_x) cos(theta_y)]

and equation (3), its rate, as it must read (``N q_e``, the rope's elastic part of equation (2), left out: it is the
plant's inner nodes)::

    x_l' = x' + l' sx + l cx theta_x'
    y_l' = y' + l' cx sy - l sx sy theta_x' + l cx cy theta_y'
    z_l' = z' - l' cx cy + l sx cy theta_x' + l cx sy theta_y'        sx = sin(theta_x), cy = cos(theta_y), ...

Printed, equation (3) is damaged in these terms: its first line has ``l sin(theta_x)`` without the dot on l; its second
line subtracts the term in theta_y', which adds; its third line lacks z' and has the sign of z turned, so that z points
down there and up in equation (12).

The plant works in the room's frame with x along the normal and y along the tangent at angle 0, as its layout says:
the paper's (x, y) is the room's (y, x). Lengths are mm, angles rad; places and rates have
shape (5,). ``Frame`` holds the prescribed motion at that moment.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]


class Frame(NamedTuple):
    """Where shaft and mechanism are, and how fast they move. Tangential and normal: at mechanism angle 0."""

    radius: float
    """mm, mechanism's."""
    shaft_tangential: float = 0.0
    """mm, rail's shaft from the mechanism's axis: eccentricity and motion of the floor."""
    shaft_normal: float = 0.0
    pulley_height: float = 0.0
    """mm, pulley above the payload as the mechanism prescribes it."""
    psi: float = 0.0
    """rad, angle of the mechanism."""
    shaft_tangential_rate: float = 0.0
    shaft_normal_rate: float = 0.0
    pulley_height_rate: float = 0.0
    psi_rate: float = 0.0


def to_paper(plant: Floats, plant_rate: Floats, frame: Frame) -> tuple[Floats, Floats]:
    """(phi, r, u_t, u_n, u_z) and its rate to (x, y, l, theta_x, theta_y) and its rate.

    Equation (3) is linear in the rates: it is solved for l', theta_x' and theta_y'.
    """
    phi, r, ut, un, uz = plant
    w, v, vt, vn, vz = plant_rate
    sine, cosine = np.sin(phi), np.cos(phi)
    upper = np.array([frame.shaft_tangential + r * sine, frame.shaft_normal + r * cosine])
    upper_rate = np.array([v * sine + r * w * cosine, v * cosine - r * w * sine])
    upper_rate += frame.shaft_tangential_rate, frame.shaft_normal_rate
    out, sm, cm = frame.radius + un, np.sin(frame.psi), np.cos(frame.psi)
    along, outwards = vt + frame.psi_rate * out, vn - frame.psi_rate * ut
    rope = np.array([out * sm + ut * cm - upper[0], out * cm - ut * sm - upper[1], uz - frame.pulley_height])
    rope_rate = np.array(
        [
            outwards * sm + along * cm - upper_rate[0],
            outwards * cm - along * sm - upper_rate[1],
            vz - frame.pulley_height_rate,
        ]
    )
    length = np.sqrt(rope @ rope)
    line = np.array([length, np.arcsin(rope[0] / length), np.arctan2(rope[1], -rope[2])])
    line_rate = np.linalg.solve(_rope_jacobian(line), rope_rate)
    return np.concatenate([upper, line]), np.concatenate([upper_rate, line_rate])


def to_plant(paper: Floats, paper_rate: Floats, frame: Frame) -> tuple[Floats, Floats]:
    """(x, y, l, theta_x, theta_y) and its rate to (phi, r, u_t, u_n, u_z) and its rate."""
    length, theta_x, theta_y = paper[2:]
    arm = paper[:2] - (frame.shaft_tangential, frame.shaft_normal)
    arm_rate = paper_rate[:2] - (frame.shaft_tangential_rate, frame.shaft_normal_rate)
    r = np.hypot(*arm)
    phi = np.arctan2(arm[0], arm[1])
    v = arm @ arm_rate / r
    w = (arm_rate[0] * arm[1] - arm[0] * arm_rate[1]) / (r * r)
    rope = length * np.array(
        [np.sin(theta_x), np.cos(theta_x) * np.sin(theta_y), -np.cos(theta_x) * np.cos(theta_y)],
    )
    lower = np.array([*paper[:2], frame.pulley_height]) + rope
    upper_rate = np.array([*paper_rate[:2], frame.pulley_height_rate])
    lower_rate = upper_rate + _rope_jacobian(paper[2:]) @ paper_rate[2:]
    sm, cm = np.sin(frame.psi), np.cos(frame.psi)
    ut, out = lower[0] * cm - lower[1] * sm, lower[0] * sm + lower[1] * cm
    along, outwards = lower_rate[0] * cm - lower_rate[1] * sm, lower_rate[0] * sm + lower_rate[1] * cm
    plant = np.array([phi, r, ut, out - frame.radius, lower[2]])
    return plant, np.array([w, v, along - frame.psi_rate * out, outwards + frame.psi_rate * ut, lower_rate[2]])


def _rope_jacobian(line: Floats) -> Floats:
    """Equation (3): rate of the rope's vector per rate of (l, theta_x, theta_y)."""
    length, theta_x, theta_y = line
    sx, cx, sy, cy = np.sin(theta_x), np.cos(theta_x), np.sin(theta_y), np.cos(theta_y)
    return np.array(
        [
            [sx, length * cx, 0.0],
            [cx * sy, -length * sx * sy, length * cx * cy],
            [-cx * cy, length * sx * cy, length * cx * sy],
        ]
    )
