"""A plant on its own: settings by nested keywords, what is prescribed to it, and a look at every millisecond."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from hil.plant import Plant
from hil.plant.inputs import Track
from hil.truth import Truth
from rigctl.config import rig_file as config
from rigctl.config.bounds import as_study
from rigctl.config.settings import RigSettings
from tests.builders.paths import ROOT

REPOSITORY = ROOT
_FRICTION: dict[str, Any] = {
    "friction_static": 0.012,
    "friction_dynamic": 0.008,
    "stribeck_mm_s": 10.0,
    "viscous_n_s_m": 50.0,
}
_SIMULATION: dict[str, Any] = {
    "seed": 1,
    "rail": _FRICTION | {"mass_kg": 13.0},
    "pulley": _FRICTION | {"mass_kg": 2.0, "friction_static": 0.0012, "friction_dynamic": 0.0008, "viscous_n_s_m": 5.0},
    "rope": {"damping_n_s_mm": 0.05, "slack_mm": 2.0},
    "drive": {"brake_ms": 50, "acceleration_mm_s2": 2000.0},
    "cell": {"quantum_n": 0.001, "filter_hz": None},
    "inclinometer": {"filter_hz": 20.0, "quantum_deg": 0.01, "noise_deg": 0.003},
}
"""Table 1 and no faults, whatever the rig file says: what is not named is at its default."""
_PLANT: dict[str, Any] = {
    "spring_n_mm": 6.0,
    "rope_n_mm": 1000.0,
    "cylinder_lag_s": 0.02,
    "command_delay_s": 0.002,
    "rope_length_mm": 1800.0,
    "radius_mm": 750.0,
    "payload_kg": 30.0,
    "mechanism_n_mm": None,
}
_FILE = config.load(REPOSITORY / "config/paper_rig.yaml").model_dump()
_FILE["tension_cell"] |= {"filter_hz": None}
SETTINGS = RigSettings.model_validate(_FILE | {"simulation": _SIMULATION, "plant": _PLANT})
"""The paper's rig, as tests here know it."""
K = SETTINGS.plant.stiffness_n_mm
GRAVITY = 9.80665
MS = 1_000_000
S = 1_000_000_000

NO_FRICTION: dict[str, Any] = {
    "friction_static": 0.0,
    "friction_dynamic": 0.0,
    "viscous_n_s_m": 0.0,
}
LOSSLESS: dict[str, Any] = {
    "rail": NO_FRICTION,
    "pulley": NO_FRICTION,
    "rope": {"damping_n_s_mm": 0.0},
    "mechanism": {"damping_ratio": 0.0},
}


def merged(base: Mapping[str, Any], update: Mapping[str, Any]) -> dict[str, Any]:
    """``base`` with the values of ``update``, section by section."""
    result = dict(base)
    for key, value in update.items():
        result[key] = merged(result[key], value) if isinstance(result.get(key), dict) else value
    return result


def rig(*updates: Mapping[str, Any]) -> RigSettings:
    """The paper's rig with some settings replaced, checked like a rig file of a study: no load hangs on it."""
    values: dict[str, Any] = SETTINGS.model_dump()
    for update in updates:
        values = merged(values, update)
    return RigSettings.model_validate(as_study(values))


def build(*simulation: Mapping[str, Any], plant: Mapping[str, Any] | None = None) -> Plant:
    """A plant at time 0, the rope slack and plumb, the brake closed; ``simulation`` sections are merged in turn."""
    return Plant(rig({"plant": plant or {}}, *({"simulation": section} for section in simulation)), 0)


def loaded(*simulation: Mapping[str, Any], tension: float = 300.0, plant: Mapping[str, Any] | None = None) -> Plant:
    """The same under tension, at rest."""
    made = build(*simulation, plant=plant)
    made.preload(tension)
    return made


def look(plant: Plant, until_s: float, every_ns: int = MS) -> Iterator[Truth]:
    """Truth on a grid of time from now until the plant's time ``until_s``."""
    while plant.t_ns < round(until_s * S):
        plant.advance(plant.t_ns + every_ns)
        yield plant.truth


def ramp(rate: float, value: float = 0.0, start_s: float = 0.0) -> Track:
    """From ``value`` on with constant speed."""
    return Track(np.array([[start_s, value, rate, 0.0, 0.0]]), end=start_s)


def constant(value: float) -> Track:
    """One value, always."""
    return ramp(0.0, value)


def tone(amplitude: float, frequency_hz: float, phase: float = 0.0, end_s: float = 1e9) -> Track:
    """A sine from time 0."""
    return Track(tones=np.array([[amplitude, 2.0 * np.pi * frequency_hz, phase, 0.0, end_s]]), end=end_s)
