"""Rig file to plant parameters, in the kernel's units (mm, N, t, s)."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from hil.plant.kernel import KG
from hil.plant.layout import AXES, PARAMETERS
from rigctl.config.settings import RigSettings
from rigctl.config.simulation_section import FrictionSettings, SimulationSettings

N_S_M = 1.0e-3
"""N s/mm in one N s/m."""
SEATING_S = 0.01
"""The play of the nut closes within a few times this, once the load seats it."""
MM_M = 1.0e-3
_STEPS_PER_RADIAN = 4.0
_DAMPING_PER_STEP = 0.5


def parameters(settings: RigSettings, simulation: SimulationSettings) -> npt.NDArray[np.void]:
    """One record of dtype ``PARAMETERS``, shape (1,).

    Raises:
        ValueError: the integration step is too long for the stiffness and damping of the payload.
    """
    plant, rope, rail, pulley = settings.plant, simulation.rope, simulation.rail, simulation.pulley
    drive, cylinder = simulation.drive, settings.cylinder
    step_s = simulation.step_us * 1e-6
    lag = plant.cylinder_lag_s * simulation.lag_scale
    values = {
        "rope_length": plant.rope_length_mm,
        "free_length": plant.rope_length_mm + rope.slack_mm,
        "stiffness": plant.stiffness_n_mm * simulation.stiffness_scale,
        "damping": axial_damping_n_s_mm(settings, simulation),
        "rope_mass": rope.mass_kg * KG,
        "elements": float(rope.elements),
        "node_damping": rope.node_damping_n_s_m * N_S_M,
        "radius": plant.radius_mm,
        "eccentricity_x": rail.eccentricity_normal_mm,
        "eccentricity_y": rail.eccentricity_tangential_mm,
        "rail_inertia": rail.mass_kg * KG * plant.radius_mm**2,
        "rail_slope": rail.slope_mm_m * MM_M,
        **_friction("rail", rail),
        "pulley_mass": pulley.mass_kg * KG,
        **_friction("pulley", pulley),
        "dead_load": simulation.dead_load_n,
        "payload_mass": plant.payload_kg * KG,
        "lag": lag,
        "lag_decay": math.exp(-step_s / lag),
        "drive_acceleration": drive.acceleration_mm_s2,
        "drive_speed": drive.speed_mm_s,
        "dead_band": drive.dead_band_mm_s,
        "ripple": drive.ripple_mm,
        "screw_lead": drive.screw_lead_mm,
        "backlash": drive.backlash_mm,
        "seating_load": drive.seating_load_n,
        "seating_time": SEATING_S,
        "stroke_low": cylinder.stroke_min_mm - drive.stop_margin_mm,
        "stroke_high": cylinder.stroke_max_mm + drive.stop_margin_mm,
    }
    for axis in AXES:
        stiffness = getattr(simulation.mechanism, f"{axis}_n_mm")
        values[f"{axis}_free"] = float(stiffness is not None)
        values[f"{axis}_stiffness"] = stiffness or 0.0
        damping = 2.0 * simulation.mechanism.damping_ratio * math.sqrt((stiffness or 0.0) * plant.payload_kg * KG)
        values[f"{axis}_damping"] = damping
    record = np.zeros(1, PARAMETERS)
    for name, value in values.items():
        record[name] = value
    _check_step(values, simulation.step_us)
    return record


def axial_damping_n_s_mm(settings: RigSettings, simulation: SimulationSettings) -> float:
    """Loss of spring and rope together: ``D_l`` of the simulation, or that of the chain in `plant`."""
    as_one = simulation.rope.damping_n_s_mm
    return settings.plant.damping_n_s_mm if as_one is None else as_one


def _friction(pair: str, friction: FrictionSettings) -> dict[str, float]:
    return {
        f"{pair}_static": friction.friction_static,
        f"{pair}_dynamic": friction.friction_dynamic,
        f"{pair}_stribeck": friction.stribeck_mm_s,
        f"{pair}_viscous": friction.viscous_n_s_m * N_S_M,
    }


def _check_step(values: dict[str, float], step_us: int) -> None:
    """Refuse a step that does not resolve the fastest oscillation or decay of what is integrated explicitly.

    A rope under tension is at most as stiff across its length as along it (tension / length <= stiffness as long as
    the stroke is shorter than the rope), so its stiffness bounds every mode it takes part in.
    """
    stiffness, distance = values["stiffness"], values["rope_length"]
    if values["stroke_high"] >= distance:
        raise ValueError(
            f"plant.rope_length_mm: found {distance:g}, expected more than the stroke {values['stroke_high']:g}"
        )
    mass = values["payload_mass"]
    # of a level rope, or of its end elements under the highest possible tension; near plumb it is far slower
    rates = [math.sqrt(stiffness * values["elements"] / values["pulley_mass"])]
    for axis in AXES:
        if values[f"{axis}_free"]:
            k = values[f"{axis}_stiffness"] + stiffness
            c = values[f"{axis}_damping"] + values["damping"]
            rates += [_STEPS_PER_RADIAN * math.sqrt(k / mass), c / mass / _DAMPING_PER_STEP]
            rates.append(math.sqrt(stiffness * values["elements"] / mass))
    if values["elements"] > 1.0:  # the shortest wave of a rope that carries its stretch by the whole stroke
        node = values["rope_mass"] / values["elements"]
        tension = stiffness * (values["stroke_high"] + 1.0)
        spring = 4.0 * tension * values["elements"] / distance
        rates.append(math.sqrt(min(spring, 4.0 * stiffness * values["elements"]) / node))
    longest_us = 1e6 / max(rates)
    if step_us > longest_us:
        raise ValueError(
            f"simulation.step_us: found {step_us}, expected at most {longest_us:.0f} "
            "with the stiffness and damping of mechanism and rope, and the masses they move"
        )
