"""Whatever the parameters, commands and disturbances: refused by the step-size guard, or finite for ever."""

from __future__ import annotations

from typing import Any

import numpy as np
from hypothesis import HealthCheck, assume, given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from hil.plant import Plant
from hil.plant.inputs import Track
from hil.plant.layout import AXES, CHANNELS, MASS, MECHANISM, RUN_OUT
from tests.plant.bench import S, rig, tone


def decades(low: float, high: float) -> st.SearchStrategy[float]:
    """Over a whole allowed range, as often between 1 and 10 as between 100 and 1000."""
    return st.floats(np.log10(low), np.log10(high)).map(lambda exponent: min(max(10.0**exponent, low), high))


@st.composite
def friction(draw: st.DrawFn) -> dict[str, float]:
    static = draw(st.just(0.0) | decades(1e-4, 1.0))
    return {
        "friction_static": static,
        "friction_dynamic": static * draw(st.floats(0.0, 1.0)),
        "stribeck_mm_s": draw(decades(1e-6, 1000.0)),
        "viscous_n_s_m": draw(st.just(0.0) | decades(1e-3, 1e4)),
    }


@st.composite
def simulations(draw: st.DrawFn) -> dict[str, Any]:
    """A ``simulation`` section from the whole allowed ranges, which end at 0 where this ends at grams."""
    compliance = st.none() | decades(1e-3, 1e6)
    offset = st.floats(-100.0, 100.0)
    rope_mass = draw(st.just(0.0) | decades(1e-3, 10.0))
    return {
        "step_us": draw(st.sampled_from([10, 100, 100, 100, 1000])),
        "stiffness_scale": draw(decades(0.11, 10.0)),
        "lag_scale": draw(decades(0.11, 10.0)),
        "delay_scale": draw(st.floats(0.0, 20.0)),
        "dead_load_n": draw(st.just(0.0) | decades(1.0, 1e4)),
        "rail": draw(friction())
        | {
            "mass_kg": draw(decades(0.1, 1000.0)),
            "eccentricity_normal_mm": draw(offset),
            "eccentricity_tangential_mm": draw(offset),
            "slope_mm_m": draw(st.floats(-50.0, 50.0)),
        },
        "pulley": draw(friction()) | {"mass_kg": draw(decades(0.05, 100.0))},
        "rope": {
            "damping_n_s_mm": draw(st.just(0.0) | decades(1e-3, 100.0)),
            "slack_mm": draw(st.floats(0.0, 60.0)),
            "mass_kg": rope_mass,
            "elements": draw(st.integers(1, 8)) if rope_mass > 0.0 else 1,
            "node_damping_n_s_m": draw(st.just(0.0) | decades(1e-3, 100.0)),
        },
        "mechanism": {f"{axis}_n_mm": draw(compliance) for axis in AXES} | {"damping_ratio": draw(st.floats(0.0, 2.0))},
        "drive": {
            "acceleration_mm_s2": draw(decades(1.0, 5e4)),
            "speed_mm_s": draw(decades(0.1, 1000.0)),
            "dead_band_mm_s": draw(st.floats(0.0, 5.0)),
            "ripple_mm": draw(st.floats(0.0, 1.0)),
            "screw_lead_mm": draw(decades(1e-3, 100.0)),
            "backlash_mm": draw(st.floats(0.0, 5.0)),
            "seating_load_n": draw(decades(1e-3, 1e6)),
            "stop_margin_mm": draw(st.floats(0.0, 100.0)),
        },
    }


@st.composite
def disturbances(draw: st.DrawFn) -> dict[int, Track]:
    """Something on any channel, violent for a rig: a tone, a jump, or both."""
    largest = {MECHANISM: 0.5, MASS: 100.0, RUN_OUT: 5.0}
    # Hz, and per 2 pi rad for the run-out: a faster mechanism throws its payload outwards, as it should
    frequencies = {MECHANISM: 0.5, RUN_OUT: 0.3}
    tracks = {}
    for channel in draw(st.sets(st.integers(0, CHANNELS - 1))):
        size = largest.get(channel, 20.0 if channel < 5 else 300.0)
        value = st.floats(-size, size)
        fastest = frequencies.get(channel, 5.0)
        track = tone(draw(value), draw(st.floats(0.01, fastest)), draw(st.floats(-3.0, 3.0)))
        jump = np.array([[0.0, 0.0, 0.0, 0.0, 0.0], [draw(st.floats(0.0, 0.3)), draw(value), 0.0, 0.0, 0.0]])
        if channel == MASS:  # once: mass that comes and goes keeps its speed, and so pumps energy in without bound
            tracks[channel] = Track(jump)
        else:
            tracks[channel] = track._replace(segments=jump) if draw(st.booleans()) else track
    return tracks


@given(
    simulation=simulations(),
    spring=st.none() | decades(0.1, 1e4),
    rope=decades(1.0, 1e5),
    payload=decades(0.1, 1000.0),
    radius=decades(100.0, 5000.0),
    length=decades(230.0, 20_000.0),
    tracks=disturbances(),
    commands=st.lists(st.tuples(st.floats(-1000.0, 1000.0), st.booleans(), st.integers(1, 100)), max_size=8),
    preload=st.none() | st.floats(1.0, 400.0),
)
@hypothesis_settings(
    max_examples=150, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.filter_too_much]
)
def test_a_plant_that_is_not_refused_stays_finite(
    simulation: dict[str, Any],
    spring: float | None,
    rope: float,
    payload: float,
    radius: float,
    length: float,
    tracks: dict[int, Track],
    commands: list[tuple[float, bool, int]],
    preload: float | None,
) -> None:
    plant_section = {
        "spring_n_mm": spring,
        "rope_n_mm": rope,
        "payload_kg": payload,
        "radius_mm": radius,
        "rope_length_mm": length,
    }
    settings = rig({"simulation": simulation, "plant": plant_section})
    try:
        plant = Plant(settings, 0)
    except ValueError as refusal:
        assert "expected" in str(refusal)
        assume(False)
    stiffness = simulation["mechanism"]["vertical_n_mm"]
    if preload is not None and (stiffness is None or stiffness > 1.0):  # a softer one would be lifted by metres
        plant.preload(preload)
    plant.start_motion(tracks, 0)
    highest = 0.0
    for velocity, braked, milliseconds in [*commands, (50.0, False, 200), (-100.0, False, 300), (100.0, False, 300)]:
        plant.set_drive(velocity, braked)
        plant.advance(plant.t_ns + milliseconds * S // 1000)
        state = np.array(plant.state[0].tolist())
        assert np.isfinite(state).all()
        assert np.isfinite(plant.nodes).all()
        assert np.isfinite(np.array(plant.truth, dtype=np.float64)).all()
        assert np.isfinite(plant.swing).all()
        assert plant.truth.tension_n >= 0.0
        highest = max(highest, np.abs(state[5:10]).max())
    # finite and bounded: an unstable step would pass any speed a payload or a pulley can get from these forces
    assert highest < 1e7
