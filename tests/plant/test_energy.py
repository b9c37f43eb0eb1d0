"""Energy, computed here from the state alone: kept without losses, and only ever lowered by friction and damping."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from hil.plant import Plant
from hil.plant.kernel import GRAVITY
from hil.plant.layout import AXES
from tests.plant.bench import LOSSLESS, S, loaded

COMPLIANT = {"mechanism": {"tangential_n_mm": 4.0, "normal_n_mm": 6.0, "vertical_n_mm": 20.0}}
FLEXIBLE = {"rope": {"mass_kg": 0.6, "elements": 4}}
HEAVY = {"rope": {"mass_kg": 0.6}}
SLOPED = {"rail": {"slope_mm_m": 20.0, "eccentricity_normal_mm": 15.0, "eccentricity_tangential_mm": -10.0}}


def energy(plant: Plant) -> float:
    """N mm: kinetic, of the spring, of the mechanism's springs, of height. Mechanism at rest at angle 0."""
    p, x = plant.parameters[0], plant.state[0]
    count = int(p["elements"])
    phi, r, w, v = (float(x[name]) for name in ("phi", "r", "phi_rate", "r_rate"))
    ut, un, uz = (float(x[name]) for name in ("ut", "un", "uz"))
    level = p["rail_slope"] * (r - p["radius"])
    upper = np.array([r * math.cos(phi) + p["eccentricity_x"], r * math.sin(phi) + p["eccentricity_y"], level])
    upper_v = np.array([v * math.cos(phi) - r * w * math.sin(phi), v * math.sin(phi) + r * w * math.cos(phi), 0.0])
    upper_v[2] = p["rail_slope"] * v
    lower = np.array([p["radius"] + un, ut, uz - p["rope_length"]])
    lower_v = np.array([x["un_rate"], x["ut_rate"], x["uz_rate"]])
    nodes = plant.nodes[: count - 1]
    shares = np.arange(count + 1) / count
    places = upper + np.outer(shares, lower - upper)
    speeds = upper_v + np.outer(shares, lower_v - upper_v)
    places[1:-1, :2], speeds[1:-1, :2] = nodes[:, :2], nodes[:, 2:]
    stretch = np.linalg.norm(np.diff(places, axis=0), axis=1).sum() - p["free_length"] + x["stroke"]
    kinetic = p["rail_inertia"] * w * w + p["pulley_mass"] * upper_v @ upper_v + p["payload_mass"] * lower_v @ lower_v
    if count == 1:
        kinetic += p["rope_mass"] / 3.0 * (upper_v @ upper_v + upper_v @ lower_v + lower_v @ lower_v)
    else:
        masses = np.full(count + 1, p["rope_mass"] / count)
        masses[[0, -1]] *= 0.5
        kinetic += masses @ (speeds * speeds).sum(axis=1)
    springs = p["stiffness"] * max(0.0, stretch) ** 2
    for axis, u in zip(AXES, (ut, un, uz), strict=True):
        springs += p[f"{axis}_stiffness"] * u * u
    height = p["pulley_mass"] * upper[2] + p["rope_mass"] * 0.5 * (upper[2] + lower[2] + p["rope_length"])
    return float(0.5 * (kinetic + springs) + GRAVITY * height)


def thrown(*simulation: Mapping[str, Any]) -> Plant:
    """Swinging, bouncing and turning at once."""
    plant = loaded(*simulation)
    x = plant.state[0]
    for name, value in (("phi_rate", 0.05), ("r_rate", 60.0), ("ut_rate", 40.0), ("un_rate", -30.0), ("uz_rate", 50.0)):
        if name in ("phi_rate", "r_rate") or plant.parameters[0]["vertical_free"]:
            x[name] = value
    if plant.parameters[0]["elements"] > 1:
        plant.nodes[:, 2] = np.linspace(60.0, -30.0, len(plant.nodes))
    return plant


def history(plant: Plant, seconds: float, every_s: float = 0.01) -> np.ndarray[Any, np.dtype[np.float64]]:
    found = [energy(plant)]
    for i in range(round(seconds / every_s)):
        plant.advance(round((i + 1) * every_s * S))
        found.append(energy(plant))
    return np.array(found)


@pytest.mark.parametrize(
    "sections",
    [
        [COMPLIANT],
        [COMPLIANT, HEAVY, SLOPED],
        [HEAVY, SLOPED],
        [COMPLIANT, FLEXIBLE, SLOPED],
        [FLEXIBLE],
    ],
    ids=["five", "five_heavy_sloped", "rigid_heavy_sloped", "five_flexible_sloped", "rigid_flexible"],
)
def test_without_losses_ten_seconds_keep_the_energy(sections: list[dict[str, Any]]) -> None:
    plant = thrown(LOSSLESS, *sections)
    kept = history(plant, 10.0)
    # second order: the ripple is (omega h)^2 / 4 of what swings, at most 50 rad/s at 100 us, and that is a tenth of all
    assert np.abs(kept / kept[0] - 1.0).max() < 1e-7
    drift = (kept[-200:].mean() - kept[:200].mean()) / kept[0]
    assert abs(drift) < 1e-9  # the ripple averaged over 2 s


@pytest.mark.parametrize(
    ("losses", "least"),
    [
        ({"rail": {"friction_static": 0.012, "friction_dynamic": 0.008}}, 1e-4),
        ({"pulley": {"friction_static": 0.012, "friction_dynamic": 0.008}}, 1e-4),
        ({"rail": {"viscous_n_s_m": 50.0}}, 1e-4),
        ({"pulley": {"viscous_n_s_m": 50.0}}, 1e-4),
        ({"rope": {"damping_n_s_mm": 0.5}}, 1e-4),
        ({"mechanism": {"damping_ratio": 0.5}}, 1e-4),
        ({"rope": {"node_damping_n_s_m": 1.0}}, 1e-4),
    ],
    ids=["rail", "pulley", "rail_viscous", "pulley_viscous", "rope", "mechanism", "nodes"],
)
def test_every_loss_only_lowers_the_energy(losses: dict[str, Any], least: float) -> None:
    plant = thrown(LOSSLESS, COMPLIANT, FLEXIBLE, losses)
    found = history(plant, 5.0)
    # looked at every 10 ms; what the integration leaves unconserved may be gained back, see the test above
    assert np.diff(found).max() < 1e-7 * found[0]
    assert found[-1] < (1.0 - least) * found[0]
