"""Every disturbance against its closed form, through the profile the compiled plant reads."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.plant import kernel, layout
from hil.plant.inputs import Track, pack
from hil.scenario import disturbances, kinds
from hil.scenario.kinds import Disturbances

RUN_S = 20.0
Array = npt.NDArray[np.float64]


def sampled(track: Track, at: Array) -> Array:
    """Value, rate and curvature at each time, shape (len(at), 3)."""
    inputs = pack({layout.HEIGHT: track})
    return np.array([kernel.profile(inputs, layout.HEIGHT, float(t)) for t in at])


def only(name: str, **item: Any) -> Track:
    """The one track of one item, from the form of a scenario file."""
    found = disturbances.tracks(Disturbances.model_validate({name: [item]}), RUN_S)
    (track,) = found.values()
    return track


def assert_smooth(track: Track, at: Array, *, acceleration: bool = True) -> None:
    """The rate is the slope of the value, and the curvature that of the rate, at the middle of each pair of times."""
    seen, middle = sampled(track, at), sampled(track, 0.5 * (at[:-1] + at[1:]))
    step = np.diff(at)
    slope = np.diff(seen[:, 0]) / step
    # a cubic's secant differs from the tangent at its middle by step^2 / 24 of its third derivative; a corner by more
    assert np.allclose(slope, middle[:, 1], atol=2e-3 * max(1e-9, np.abs(middle[:, 1]).max()))
    if acceleration:
        bend = np.diff(seen[:, 1]) / step
        assert np.allclose(bend, middle[:, 2], atol=2e-2 * max(1e-9, np.abs(middle[:, 2]).max()))


def test_a_rotation_is_a_trapezium_of_speed() -> None:
    track = only("mechanism", kind="rotate", angle_deg=-10.0, speed_deg_s=2.0, acceleration_deg_s2=1.0, start_s=1.0)
    seen = np.degrees(sampled(track, np.array([0.0, 1.0, 2.0, 3.0, 5.0, 6.0, 7.0, 8.0, 9.0])))
    assert track.end == pytest.approx(8.0)
    assert np.allclose(seen[:, 0], [0, 0, -0.5, -2, -6, -8, -9.5, -10, -10])
    assert np.allclose(seen[:, 1], [0, 0, -1, -2, -2, -2, -1, 0, 0])


def test_out_and_back_repeats_and_rests() -> None:
    way = {"up_mm": 4.0, "speed_mm_s": 2.0, "acceleration_mm_s2": 2.0}  # 3 s each
    track = only("vertical", kind="out_and_back", **way, start_s=1.0, dwell_s=0.5, repeats=2)
    seen = sampled(track, np.array([1.0, 2.5, 4.0, 4.5, 6.0, 7.5, 8.0, 11.0, 11.5, 14.5, 15.0]))
    assert track.end == pytest.approx(1.0 + 4 * 3.0 + 3 * 0.5)
    assert np.allclose(seen[:, 0], [0, 2, 4, 4, 2, 0, 0, 4, 4, 0, 0])
    assert np.allclose(seen[:, 1], [0, 2, 0, 0, -2, 0, 0, 0, 0, 0, 0], atol=1e-9)


def test_a_heave_is_a_sine_under_its_fades() -> None:
    wave = {"amplitude_mm": 3.0, "frequency_hz": 1.3, "phase_deg": 50.0}
    track = only("vertical", kind="sine", **wave, start_s=2.0, duration_s=9.0, fade_s=1.5)
    at = np.linspace(0.0, 15.0, 3001)
    since = at - 2.0
    rising, falling = np.clip(since / 1.5, 0.0, 1.0), np.clip((9.0 - since) / 1.5, 0.0, 1.0)
    envelope = 0.25 * (1.0 - np.cos(np.pi * rising)) * (1.0 - np.cos(np.pi * falling))
    expected = 3.0 * envelope * np.sin(2.0 * np.pi * 1.3 * since + math.radians(50.0))
    assert np.allclose(sampled(track, at)[:, 0], expected, atol=1e-9)
    assert_smooth(track, np.linspace(1.5, 12.0, 20001), acceleration=False)


def test_without_a_length_a_tone_outlasts_the_run() -> None:
    track = only("floor", kind="tone", axis="radial", amplitude_mm=0.5, frequency_hz=3.0)
    at = np.linspace(0.5, 2.0 * RUN_S, 4001)
    assert np.allclose(sampled(track, at)[:, 0], 0.5 * np.sin(2.0 * np.pi * 3.0 * at), atol=1e-9)
    assert track.end == RUN_S


def test_noise_has_its_rms_its_band_and_its_seed() -> None:
    noise = {"kind": "noise", "axis": "vertical", "rms_mm": 0.02, "from_hz": 5.0, "to_hz": 40.0}
    track = only("floor", **noise, seed=3)
    length_s, rate = 200.0, 200.0  # 5 mHz of resolution: the tones, 60 in 35 Hz, are further apart
    at = 0.5 + np.arange(round(length_s * rate)) / rate
    values = sampled(track, at)[:, 0]
    # exact over infinite time; a neighbour at a distance of d Hz leaves 1 / (pi d length) of its product
    assert np.sqrt(np.mean(values**2)) == pytest.approx(0.02, rel=0.02)
    power = np.abs(np.fft.rfft(values)) ** 2
    frequency = np.fft.rfftfreq(len(values), 1.0 / rate)
    outside = (frequency < 4.5) | (frequency > 40.5)
    assert power[outside].sum() < 1e-3 * power.sum()  # leakage of 60 lines under a plain window
    assert np.array_equal(only("floor", **noise, seed=3).tones, track.tones)
    assert not np.array_equal(only("floor", **noise, seed=4).tones, track.tones)
    assert not np.array_equal(only("floor", **{**noise, "axis": "radial"}, seed=3).tones, track.tones)


def test_an_impulse_has_its_area_and_ends() -> None:
    track = only("impacts", kind="impulse", axis="normal", impulse_n_s=-2.0, duration_s=0.02, at_s=1.0)
    at = np.linspace(0.99, 1.03, 40001)
    force = sampled(track, at)[:, 0]
    assert np.trapezoid(force, at) == pytest.approx(-2.0, rel=1e-6)
    assert force.min() == pytest.approx(-0.5 * math.pi * 2.0 / 0.02, rel=1e-6)
    assert np.all(force[(at < 1.0) | (at > 1.02)] == 0.0)


def test_a_jolt_arrives_and_has_no_jump_of_acceleration() -> None:
    track = only("impacts", kind="step", height_mm=2.0, rise_s=0.4, at_s=1.0)
    at = np.linspace(0.9, 1.5, 60001)
    value, rate, bend = sampled(track, at).T
    assert (value[0], value[-1]) == (0.0, 2.0)
    assert value[at <= 1.2][-1] == pytest.approx(1.0)
    assert rate.max() == pytest.approx(2.0 * 2.0 / 0.4)
    assert np.abs(bend).max() == pytest.approx(8.0 * 2.0 / 0.4**2, rel=1e-3)
    assert np.abs(np.diff(bend)).max() < 1e-3 * np.abs(bend).max()
    assert_smooth(track, at)


def test_mass_changes_at_once_or_over_a_ramp() -> None:
    at = np.array([0.0, 1.999, 2.0, 3.0, 4.0, 9.0])
    at_once, ramp = (only("mass", change_kg=-3.0, at_s=2.0, ramp_s=ramp_s) for ramp_s in (0.0, 2.0))
    assert np.allclose(sampled(at_once, at)[:, 0], [0, 0, -3, -3, -3, -3])
    assert np.allclose(sampled(ramp, at)[:, 0], [0, 0, 0, -1.5, -3, -3])


@settings(max_examples=50, deadline=None)
@given(
    st.lists(st.floats(-180.0, 180.0).map(lambda x: round(x, 1)), min_size=2, max_size=8, unique=True),
    st.lists(st.floats(-2.0, 2.0), min_size=8, max_size=8),
)
def test_a_level_table_goes_through_its_points_and_never_beyond_its_neighbours(
    angles: list[float], levels: list[float]
) -> None:
    angles = sorted(angles)
    points = [{"angle_deg": angle, "level_mm": level} for angle, level in zip(angles, levels, strict=False)]
    track = only("run_out", kind="table", points=points)
    known = np.array(levels[: len(angles)])
    seen = sampled(track, np.radians(angles))[:, 0]
    assert np.allclose(seen - seen[0], known - known[0], atol=1e-9)
    assert sampled(track, np.zeros(1))[0, 0] == pytest.approx(0.0, abs=1e-12)
    for i in range(len(angles) - 1):
        between = sampled(track, np.radians(np.linspace(angles[i], angles[i + 1], 50)))[:, 0]
        low, high = sorted((seen[i], seen[i + 1]))
        assert between.min() >= low - 1e-9
        assert between.max() <= high + 1e-9
    outside = sampled(track, np.radians([angles[0] - 5.0, angles[-1] + 5.0]))
    assert np.allclose(outside, [[seen[0], 0.0, 0.0], [seen[-1], 0.0, 0.0]])


def test_a_level_table_has_no_corner() -> None:
    points = [{"angle_deg": a, "level_mm": v} for a, v in ((0.0, 0.3), (4.0, 1.0), (8.0, 0.2), (20.0, 0.5))]
    track = only("run_out", kind="table", points=points)
    slopes = sampled(track, np.radians(np.linspace(-1.0, 21.0, 22001)))[:, 1]
    assert np.abs(np.diff(slopes)).max() < 2e-3 * np.abs(slopes).max()


def test_a_level_wave_starts_at_nothing_either_way_of_the_rail() -> None:
    track = only("run_out", kind="sine", amplitude_mm=1.5, period_deg=45.0, phase_deg=30.0)
    angle = np.linspace(-90.0, 90.0, 361)
    expected = 1.5 * (np.sin(np.radians(360.0 / 45.0 * angle + 30.0)) - math.sin(math.radians(30.0)))
    assert np.allclose(sampled(track, np.radians(angle))[:, 0], expected, atol=1e-9)


@settings(max_examples=50, deadline=None)
@given(st.lists(st.tuples(st.floats(-5.0, 5.0), st.floats(0.5, 5.0), st.floats(0.0, 8.0)), min_size=1, max_size=4))
def test_items_add_up(moves: list[tuple[float, float, float]]) -> None:
    items = [
        {"kind": "move", "up_mm": way, "speed_mm_s": speed, "acceleration_mm_s2": 3.0, "start_s": start}
        for way, speed, start in moves
    ]
    items.append({"kind": "sine", "amplitude_mm": 0.5, "frequency_hz": 1.0})
    jolt = {"kind": "step", "height_mm": 1.0, "at_s": 3.0}
    together = Disturbances.model_validate({"vertical": items, "impacts": [jolt]})
    at = np.linspace(0.0, RUN_S, 401)
    alone = sum(sampled(only("vertical", **item), at) for item in items) + sampled(only("impacts", **jolt), at)
    (track,) = disturbances.tracks(together, RUN_S).values()
    inside = slice(1, -1)  # at a corner of the acceleration either side is right
    assert np.allclose(sampled(track, at)[inside, :2], alone[inside, :2], atol=1e-9)


def test_each_disturbance_reaches_its_own_channel() -> None:
    tone = {"kind": "tone", "amplitude_mm": 1.0, "frequency_hz": 1.0}
    blow = {"kind": "impulse", "impulse_n_s": 1.0, "at_s": 1.0}
    prescribed = Disturbances.model_validate(
        {
            "floor": [{**tone, "axis": axis} for axis in ("vertical", "radial", "tangential")],
            "impacts": [{**blow, "axis": axis} for axis in ("tangential", "normal", "vertical")],
            "mass": [{"change_kg": 1.0, "at_s": 1.0}],
            "run_out": [{"kind": "sine", "amplitude_mm": 1.0, "period_deg": 90.0}],
        }
    )
    assert set(disturbances.tracks(prescribed, RUN_S)) == set(range(layout.FLOOR_RADIAL, layout.CHANNELS))
    assert disturbances.tracks(Disturbances(), RUN_S) == {}


def test_no_move_is_no_motion() -> None:
    turn = kinds.Rotate(kind="rotate", angle_deg=0.0, speed_deg_s=1.0, acceleration_deg_s2=1.0)
    assert np.all(sampled(disturbances.rotation(turn), np.linspace(0.0, 5.0, 11)) == 0.0)
