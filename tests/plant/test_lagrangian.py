"""The compiled plant's accelerations against a SymPy Lagrangian at random states with random parameters."""

from __future__ import annotations

import itertools
import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pytest

from hil.plant import kernel, layout
from hil.plant.coordinates import Frame, to_paper, to_plant
from hil.plant.inputs import Track, pack
from tests.plant.lagrangian import DERIVATIONS, ELEMENTS, NAMES, Floats, Lagrangian, kept, lagrangian

STEP_S = 1e-4
STATES = 60
RELATIVE = 1e-9
"""Of the largest acceleration of a state: some are small differences of large forces. Rounding leaves about 1e-12."""
ALL_FREE, RIGID = (True, True, True), (False, False, False)
MIXED = [free for free in itertools.product((False, True), repeat=3) if free not in (ALL_FREE, RIGID)]
COORDINATES = ("phi", "r", "ut", "un", "uz")


class Case(NamedTuple):
    """One random state of a plant with random parameters."""

    constants: dict[str, float]
    prescribed: Floats
    frame: Frame
    place: Floats
    """phi, r, u_t, u_n, u_z."""
    speed: Floats
    nodes: Floats
    """x, y and their rates in the room's frame."""


def draw(seed: int, free: tuple[bool, bool, bool], elements: int = 1) -> Case:
    """All motions at once, and faster than the rig's: no term of equation (15) is small."""
    random = np.random.default_rng(seed)
    between = random.uniform
    prescribed = np.array(
        [
            [between(-1, 1), *between(-20, 20, 4), between(-20, 60)],
            [between(-0.5, 0.5), *between(-100, 100, 4), between(-50, 50)],
            [between(-2, 2), *between(-1000, 1000, 4), 0.0],
        ]
    )
    psi, high, gx, gy, gz, stroke = prescribed[0]
    held = np.array([True, True, *free])
    place = np.array([psi + between(-0.1, 0.1), between(600, 900), *between(-20, 20, 3)]) * held
    speed = np.array([between(-0.5, 0.5), *between(-200, 200, 4)]) * held
    c = dict.fromkeys(NAMES, 0.0)
    c |= {
        "rope_length": between(1000, 2500),
        "stiffness": between(2, 1000),
        "rope_mass": between(0.1e-3, 5e-3),
        "node_damping": between(0, 1e-3),
        "radius": 750.0,
        "eccentricity_x": between(-50, 50),
        "eccentricity_y": between(-50, 50),
        "rail_inertia": between(1e-3, 30e-3) * 750.0**2,
        "rail_slope": between(-0.05, 0.05),
        "rail_viscous": between(0, 0.2),
        "pulley_mass": between(0.5e-3, 5e-3),
        "pulley_viscous": between(0, 0.1),
        "payload": between(10e-3, 50e-3),
        "extra": between(-5e-3, 5e-3),
        "level0": between(-3, 3),
        "level1": between(-20, 20),
        "level2": between(-10, 10),
        "level3": between(-5, 5),
        "level_start": -2.0,
    }
    c |= {name: between(1, 200) for name in ("kt", "kn", "kz")}
    c |= {name: between(0, 0.2) for name in ("ct", "cn", "cz")}
    c |= {name: between(-50, 50) for name in ("force_t", "force_n", "force_z")}
    past = place[0] - c["level_start"]
    level = sum(c[f"level{n}"] * past**n for n in range(4))
    slope = sum(n * c[f"level{n}"] * past ** (n - 1) for n in range(1, 4))
    frame = Frame(
        750.0,
        c["eccentricity_y"] + gy,
        c["eccentricity_x"] + gx,
        c["rope_length"] + level + c["rail_slope"] * (place[1] - 750.0) + gz - high,
        psi,
        prescribed[1, 3],
        prescribed[1, 2],
        slope * speed[0] + c["rail_slope"] * speed[1] + prescribed[1, 4] - prescribed[1, 1],
        prescribed[1, 0],
    )
    paper, _ = to_paper(place, speed, frame)
    upper, lower = ends(paper)
    nodes = np.zeros((max(1, elements - 1), 4))
    length = paper[2]
    if elements > 1:
        for i in range(elements - 1):
            nodes[i, :2] = upper[:2] + (lower[:2] - upper[:2]) * (i + 1) / elements
        nodes += between(-5, 5, nodes.shape) * (1, 1, 40, 40)
        chain = np.vstack([upper[:2], nodes[:, :2], lower[:2]])
        drop = (upper[2] - lower[2]) / elements
        length = np.sqrt((np.diff(chain, axis=0) ** 2).sum(axis=1) + drop**2).sum()
    stretch = between(10, 80)
    c["free_length"] = length + stroke - stretch
    c["damping"] = between(0, 0.001) * c["stiffness"] * stretch  # too little to make the rope slack at these speeds
    return Case(c, prescribed, frame, place, speed, nodes)


def ends(paper: Floats) -> tuple[Floats, Floats]:
    """Pulley and payload in the room's frame (normal, tangential, height above the pulley)."""
    x, y, length, theta_x, theta_y = paper
    upper = np.array([y, x, 0.0])
    rope = [math.cos(theta_x) * math.sin(theta_y), math.sin(theta_x), -math.cos(theta_x) * math.cos(theta_y)]
    return upper, upper + length * np.array(rope)


def compiled(
    case: Case, acceleration: Floats, node_acceleration: Floats, free: tuple[bool, bool, bool], elements: int = 1
) -> tuple[Floats, Floats]:
    """The plant's (phi'', r'', u'') and its nodes' accelerations at the case's state.

    A step takes forces in its middle: the middle's place and the mean of the rates before and after. Starting half
    a step of the expected acceleration before the case, the middle is the case itself, if the expectation is right.
    """
    half = 0.5 * STEP_S
    c, prescribed = case.constants, case.prescribed
    p = np.zeros(1, layout.PARAMETERS)
    for name in layout.PARAMETERS.names or ():
        if name in c:
            p[name] = c[name]
    p["elements"], p["payload_mass"] = elements, c["payload"]
    for axis, letter, is_free in zip(layout.AXES, "tnz", free, strict=True):
        p[f"{axis}_free"], p[f"{axis}_stiffness"], p[f"{axis}_damping"] = is_free, c[f"k{letter}"], c[f"c{letter}"]
    p["lag"], p["lag_decay"], p["drive_acceleration"], p["drive_speed"] = 0.02, math.exp(-STEP_S / 0.02), 1e9, 1e9
    p["stroke_low"], p["stroke_high"], p["seating_time"], p["screw_lead"] = -1e9, 1e9, 0.01, 5.0
    p["rail_stribeck"] = p["pulley_stribeck"] = 10.0

    x = np.zeros(1, layout.STATE)
    rates = case.speed - half * acceleration
    for name, place, rate in zip(COORDINATES, case.place - half * rates, rates, strict=True):
        x[name], x[f"{name}_rate"] = place, rate
    stroke, stroke_rate = prescribed[0, 5], prescribed[1, 5]
    x["motor"] = x["motor_before"] = x["stroke"] = stroke - half * stroke_rate
    x["motor_speed"] = stroke_rate
    nodes = case.nodes.copy()
    nodes[:, 2:] -= half * node_acceleration
    nodes[:, :2] -= half * nodes[:, 2:]
    before = nodes[:, 2:].copy()

    channels = (layout.MECHANISM, layout.HEIGHT, layout.FLOOR_RADIAL, layout.FLOOR_TANGENTIAL, layout.FLOOR_VERTICAL)
    tracks = {}
    for channel, (value, rate, bend) in zip(channels, prescribed[:, :5].T, strict=True):
        row = [0.0, value - half * rate + 0.5 * half * half * bend, rate - half * bend, 0.5 * bend, 0.0]
        tracks[channel] = Track(np.array([row]))
    for channel, name in zip((5, 6, 7), ("force_t", "force_n", "force_z"), strict=True):
        tracks[channel] = Track(np.array([[0.0, c[name], 0.0, 0.0, 0.0]]))
    tracks[layout.MASS] = Track(np.array([[0.0, c["extra"] / kernel.KG, 0.0, 0.0, 0.0]]))
    tracks[layout.RUN_OUT] = Track(np.array([[c["level_start"], *(c[f"level{n}"] for n in range(4))]]))
    kernel.run(p, x, nodes, np.zeros((elements, 2)), pack(tracks), 0.0, STEP_S, 1, stroke_rate, False)
    assert x["tension"][0] > 0.0
    found = np.array([x[f"{name}_acceleration"][0] for name in COORDINATES])
    return found, (nodes[:, 2:] - before) / STEP_S


def polar(case: Case, acceleration: npt.ArrayLike) -> Floats:
    """phi'' and r'' of the pulley's acceleration (tangential, normal at angle 0) less the floor's."""
    phi, r = case.place[:2]
    w, v = case.speed[:2]
    ax, ay = np.asarray(acceleration) - case.prescribed[2, [3, 2]]
    across, outwards = ax * math.cos(phi) - ay * math.sin(phi), ax * math.sin(phi) + ay * math.cos(phi)
    return np.array([(across - 2.0 * v * w) / r, outwards + r * w * w])


def difference(case: Case, found: Floats, expected: Floats) -> float:
    """Largest difference of accelerations, relative to the largest of them."""
    scale = np.ones(len(found))
    scale[0] = case.place[1]
    return float(np.max(np.abs((found - expected) * scale)) / np.max(np.abs(expected * scale)))


def error_straight(lagrangian: Lagrangian, seed: int, free: tuple[bool, bool, bool]) -> float:
    case = draw(seed, free)
    paper, paper_rate = to_paper(case.place, case.speed, case.frame)
    motion = lagrangian.accelerations(paper, paper_rate, case.prescribed, case.constants, free)
    expected = np.concatenate([polar(case, motion.coordinates[:2]), np.where(free, motion.payload, 0.0)])
    found, _ = compiled(case, expected, np.zeros((1, 2)), free)
    return difference(case, found, expected)


def error_flexible(lagrangian: Lagrangian, seed: int, free: tuple[bool, bool, bool]) -> float:
    case = draw(seed, free, ELEMENTS)
    paper, paper_rate = to_paper(case.place, case.speed, case.frame)
    _, lower = ends(paper)
    z = case.prescribed[0, 1] - case.constants["rope_length"] + case.place[4]
    psi, omega = case.prescribed[0, 0], case.prescribed[1, 0]
    out, along = 750.0 + case.place[3], case.speed[2] + omega * (750.0 + case.place[3])
    outwards = case.speed[3] - omega * case.place[2]
    sm, cm = math.sin(psi), math.cos(psi)
    assert lower[:2] == pytest.approx([out * cm - case.place[2] * sm, out * sm + case.place[2] * cm])
    q = np.array([*paper[:2], *case.nodes[:, [1, 0]].ravel(), lower[1], lower[0], z])
    lower_rate = [outwards * sm + along * cm, outwards * cm - along * sm, case.speed[4] + case.prescribed[1, 1]]
    rates = np.array([*paper_rate[:2], *case.nodes[:, [3, 2]].ravel(), *lower_rate])
    motion = lagrangian.accelerations(q, rates, case.prescribed, case.constants, free)
    nodes = motion.coordinates[2:-3].reshape(-1, 2)[:, ::-1]
    expected = np.concatenate([polar(case, motion.coordinates[:2]), np.where(free, motion.payload, 0.0)])
    found, found_nodes = compiled(case, expected, nodes, free, ELEMENTS)
    assert difference(case, np.append(1.0, found_nodes.ravel()), np.append(1.0, nodes.ravel())) < RELATIVE
    return difference(case, found, expected)


@pytest.fixture(scope="session")
def paper_lagrangian() -> Lagrangian:
    return lagrangian("straight")


@pytest.fixture(scope="session")
def chain_lagrangian() -> Lagrangian:
    return lagrangian("flexible")


@pytest.mark.parametrize("name", DERIVATIONS)
def test_the_kept_derivations_are_of_this_source(name: str) -> None:
    assert kept(name) is not None, "run python -m tests.plant.lagrangian"


@pytest.mark.study
@pytest.mark.parametrize("name", DERIVATIONS)
def test_a_derivation_comes_out_as_it_is_kept(name: str) -> None:
    assert DERIVATIONS[name]() == kept(name)


def test_with_a_compliant_mechanism_all_five_accelerations_are_those_of_equation_15(
    paper_lagrangian: Lagrangian,
) -> None:
    assert max(error_straight(paper_lagrangian, seed, ALL_FREE) for seed in range(STATES)) < RELATIVE


def test_with_the_motion_prescribed_rail_and_pulley_accelerate_by_equation_15(paper_lagrangian: Lagrangian) -> None:
    assert max(error_straight(paper_lagrangian, seed, RIGID) for seed in range(STATES)) < RELATIVE


@pytest.mark.parametrize("free", MIXED, ids=lambda free: "".join("tnz"[i] for i in range(3) if free[i]))
def test_any_mix_of_rigid_and_compliant_axes_obeys_equation_15(
    paper_lagrangian: Lagrangian, free: tuple[bool, bool, bool]
) -> None:
    assert max(error_straight(paper_lagrangian, seed, free) for seed in range(STATES)) < RELATIVE


@pytest.mark.parametrize("free", [ALL_FREE, RIGID, (False, False, True)], ids=["free", "rigid", "vertical"])
def test_a_flexible_rope_obeys_its_own_lagrangian(chain_lagrangian: Lagrangian, free: tuple[bool, bool, bool]) -> None:
    assert max(error_flexible(chain_lagrangian, seed, free) for seed in range(STATES)) < RELATIVE


def test_coordinates_of_the_paper_convert_there_and_back() -> None:
    for seed in range(STATES):
        case = draw(seed, ALL_FREE)
        paper, paper_rate = to_paper(case.place, case.speed, case.frame)
        place, speed = to_plant(paper, paper_rate, case.frame)
        assert place == pytest.approx(case.place, rel=1e-9, abs=1e-9)  # differences of lengths of 1000 mm
        assert speed == pytest.approx(case.speed, rel=1e-9, abs=1e-9)


def test_rates_of_the_paper_coordinates_are_the_slopes_of_the_places() -> None:
    case = draw(1, ALL_FREE)
    h = 1e-6

    def at(t: float) -> tuple[Floats, Floats]:
        f = case.frame
        frame = f._replace(
            shaft_tangential=f.shaft_tangential + t * f.shaft_tangential_rate,
            shaft_normal=f.shaft_normal + t * f.shaft_normal_rate,
            pulley_height=f.pulley_height + t * f.pulley_height_rate,
            psi=f.psi + t * f.psi_rate,
        )
        return to_paper(case.place + t * case.speed, case.speed, frame)

    slope: Any = (at(h)[0] - at(-h)[0]) / (2.0 * h)
    assert slope == pytest.approx(at(0.0)[1], rel=1e-6)  # rounding of 1000 mm over 2 us
