"""Disturbances as tracks of the plant: cubic segments and tones, in closed form."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from hil.plant import layout, moves
from hil.plant.inputs import SEGMENT_COLUMNS, Track
from hil.plant.moves import Row
from hil.scenario import kinds
from hil.scenario.kinds import Disturbances

NOISE_TONES = 60
_FLOOR = {"radial": layout.FLOOR_RADIAL, "tangential": layout.FLOOR_TANGENTIAL, "vertical": layout.FLOOR_VERTICAL}
_FORCE = {"tangential": layout.FORCE_TANGENTIAL, "normal": layout.FORCE_NORMAL, "vertical": layout.FORCE_VERTICAL}
_BEFORE_RAD = 100.0 * 2.0 * math.pi
"""The rail's angle never gets this far back."""

Floats = npt.NDArray[np.float64]
Tracks = dict[int, Track]


def tracks(disturbances: Disturbances, duration_s: float) -> Tracks:
    """All disturbances as tracks, by channel of ``hil.plant.layout``.

    Args:
        disturbances: from the scenario file.
        duration_s: of the run; a disturbance without an end of its own goes on beyond it.
    """
    parts: dict[int, list[Track]] = {}

    def add(channel: int, track: Track) -> None:
        parts.setdefault(channel, []).append(track)

    for turn in disturbances.mechanism:
        add(layout.MECHANISM, rotation(turn))
    for lift in disturbances.vertical:
        add(layout.HEIGHT, heave(lift, duration_s) if isinstance(lift, kinds.Heave) else vertical_move(lift))
    for level in disturbances.run_out:
        add(layout.RUN_OUT, level_table(level) if isinstance(level, kinds.LevelTable) else level_wave(level))
    for shake in disturbances.floor:
        tones = floor_tone(shake, duration_s) if isinstance(shake, kinds.FloorTone) else floor_noise(shake, duration_s)
        add(_FLOOR[shake.axis], tones)
    for impact in disturbances.impacts:
        if isinstance(impact, kinds.Impulse):
            add(_FORCE[impact.axis], impulse(impact))
        else:
            add(layout.HEIGHT, jolt(impact))
    for change in disturbances.mass:
        add(layout.MASS, mass_change(change))
    return {channel: summed(found) for channel, found in parts.items()}


def rotation(turn: kinds.Rotate | kinds.OutAndBack) -> Track:
    """Mechanism's angle, rad."""
    angle, speed, acceleration = map(math.radians, (turn.angle_deg, turn.speed_deg_s, turn.acceleration_deg_s2))
    dwell_s, repeats = (turn.dwell_s, turn.repeats) if isinstance(turn, kinds.OutAndBack) else (0.0, 0)
    return _ways(angle, speed, acceleration, turn.start_s, dwell_s, repeats)


def vertical_move(lift: kinds.Lift | kinds.LiftAndBack) -> Track:
    """Mechanism's height, mm."""
    dwell_s, repeats = (lift.dwell_s, lift.repeats) if isinstance(lift, kinds.LiftAndBack) else (0.0, 0)
    return _ways(lift.up_mm, lift.speed_mm_s, lift.acceleration_mm_s2, lift.start_s, dwell_s, repeats)


def heave(sine: kinds.Heave, duration_s: float) -> Track:
    """Mechanism's height, mm, as a sine."""
    wave = (sine.amplitude_mm, sine.frequency_hz, math.radians(sine.phase_deg))
    return _passing([wave], sine.start_s, sine.duration_s, sine.fade_s, duration_s)


def level_table(table: kinds.LevelTable) -> Track:
    """Level of the rail, mm against rad, 0 at its start: monotone cubics (Fritsch, Carlson 1980), flat outside.

    Value and slope are continuous everywhere; between two neighbours it stays between their levels.
    """
    from scipy.interpolate import CubicHermiteSpline, PchipInterpolator  # 0.2 s: only where there is a table

    at = np.radians([point.angle_deg for point in table.points])
    level = np.array([point.level_mm for point in table.points])
    slopes = PchipInterpolator(at, level).derivative()(at)
    slopes[[0, -1]] = 0.0
    curve = CubicHermiteSpline(at, level, slopes)
    start = level[0] if at[0] >= 0.0 else level[-1] if at[-1] <= 0.0 else float(curve(0.0))
    rows = np.zeros((len(at), SEGMENT_COLUMNS))
    rows[:, 0] = at
    rows[:-1, 1:] = curve.c[::-1].T
    rows[-1, 1] = level[-1]
    rows[:, 1] -= start
    return Track(segments=rows)


def level_wave(wave: kinds.LevelWave) -> Track:
    """Level of the rail, mm against rad, as a sine; 0 where the rail starts."""
    period, phase = math.radians(wave.period_deg), math.radians(wave.phase_deg)
    before = math.ceil(_BEFORE_RAD / period) * period
    offset = -wave.amplitude_mm * math.sin(phase)
    tone = (wave.amplitude_mm, 2.0 * math.pi / period, phase, -before, math.inf)
    return Track(segments=np.array([(-before, offset, 0.0, 0.0, 0.0)]), tones=np.array([tone]))


def floor_tone(tone: kinds.FloorTone, duration_s: float) -> Track:
    """Motion of the gantry, mm."""
    wave = (tone.amplitude_mm, tone.frequency_hz, math.radians(tone.phase_deg))
    return _passing([wave], tone.start_s, tone.duration_s, tone.fade_s, duration_s)


def floor_noise(noise: kinds.FloorNoise, duration_s: float) -> Track:
    """Motion of the gantry, mm: one tone at a random place in each of ``NOISE_TONES`` equal parts of the band.

    Equal amplitudes, so that the band is flat and its root mean square exact (over a time long against the inverse of
    the tones' distance).
    """
    random = np.random.default_rng([noise.seed, _FLOOR[noise.axis]])
    places = np.arange(NOISE_TONES) + random.random(NOISE_TONES)
    frequencies = noise.from_hz + (noise.to_hz - noise.from_hz) * places / NOISE_TONES
    phases = random.uniform(0.0, 2.0 * math.pi, NOISE_TONES)
    amplitude = noise.rms_mm * math.sqrt(2.0 / NOISE_TONES)
    waves = [(amplitude, float(f), float(phase)) for f, phase in zip(frequencies, phases, strict=True)]
    return _passing(waves, noise.start_s, noise.duration_s, noise.fade_s, duration_s)


def impulse(kind: kinds.Impulse) -> Track:
    """Force on the payload, N: half a sine whose area is the impulse."""
    force = 0.5 * math.pi * kind.impulse_n_s / kind.duration_s
    end = kind.at_s + kind.duration_s
    return Track(tones=np.array([(force, math.pi / kind.duration_s, 0.0, kind.at_s, end)]), end=end)


def jolt(step: kinds.Jolt) -> Track:
    """Mechanism's height, mm: four cubics of equal and opposite third derivative, acceleration continuous."""
    quarter = 0.25 * step.rise_s
    jerk = 0.5 * step.height_mm / quarter**3
    rows: list[Row] = []
    at, value, rate, acceleration = step.at_s, 0.0, 0.0, 0.0
    for sign in (1.0, -1.0, -1.0, 1.0):
        third = sign * jerk
        rows.append((at, value, rate, 0.5 * acceleration, third / 6.0))
        value += quarter * (rate + quarter * (0.5 * acceleration + quarter * third / 6.0))
        rate += quarter * (acceleration + 0.5 * quarter * third)
        acceleration += quarter * third
        at += quarter
    end = step.at_s + step.rise_s
    return Track(segments=np.array([*rows, (end, step.height_mm, 0.0, 0.0, 0.0)]), end=end)


def mass_change(change: kinds.MassChange) -> Track:
    """Change of the payload's mass, kg."""
    end = change.at_s + change.ramp_s
    rows: list[Row] = [(change.at_s - 1.0, 0.0, 0.0, 0.0, 0.0)]
    if change.ramp_s > 0.0:
        rows.append((change.at_s, 0.0, change.change_kg / change.ramp_s, 0.0, 0.0))
    return Track(segments=np.array([*rows, (end, change.change_kg, 0.0, 0.0, 0.0)]), end=end)


def summed(parts: Sequence[Track]) -> Track:
    """One track that is the sum of several, with segments cut at the ends of all."""
    curves = [part.segments for part in parts if len(part.segments)]
    starts = np.unique(np.concatenate([curve[:, 0] for curve in curves])) if curves else np.zeros(0)
    rows = np.zeros((len(starts), SEGMENT_COLUMNS))
    rows[:, 0] = starts
    for curve in curves:
        rows[:, 1:] += [_expanded(curve, at) for at in starts]
    tones = np.concatenate([part.tones for part in parts])
    return Track(rows, tones, max(part.end for part in parts))


def _expanded(curve: Floats, at: float) -> tuple[float, float, float, float]:
    """Coefficients about ``at`` of the cubic that holds there."""
    i = int(np.searchsorted(curve[:, 0], at, side="right")) - 1
    if i < 0:
        return float(curve[0, 1]), 0.0, 0.0, 0.0
    start, c0, c1, c2, c3 = map(float, curve[i])
    d = at - start
    return c0 + d * (c1 + d * (c2 + d * c3)), c1 + d * (2.0 * c2 + 3.0 * d * c3), c2 + 3.0 * d * c3, c3


def _ways(way: float, speed: float, acceleration: float, start_s: float, dwell_s: float, repeats: int) -> Track:
    """Out once (``repeats`` 0), or out and back ``repeats`` times, with a rest before each way but the first."""
    places = [0.0, way] if repeats == 0 else [0.0, *[way, 0.0] * repeats]
    rows: list[Row] = []
    at = start_s
    for origin, target in itertools.pairwise(places):
        if rows:
            at += dwell_s
        leg, at = moves.leg(at, origin, target, speed, acceleration)
        rows += leg
    return Track(segments=np.array(rows), end=at)


def _passing(
    waves: Sequence[tuple[float, float, float]], start_s: float, length_s: float | None, fade_s: float, run_s: float
) -> Track:
    """Sines (amplitude, Hz, rad) whose amplitude rises, and with a length falls, as half a cosine.

    ``(1 - cos(pi t / fade)) / 2`` times a sine is three sines, so that the fades are tones too.
    """
    end_s = math.inf if length_s is None else start_s + length_s
    steady_s = start_s + fade_s
    falling_s = end_s - fade_s
    beat = math.pi / fade_s
    parts = [(start_s, steady_s, 0.5, 0.0), (start_s, steady_s, -0.25, beat), (start_s, steady_s, -0.25, -beat)]
    parts += [(steady_s, falling_s, 1.0, 0.0)]
    if length_s is not None:
        parts += [(falling_s, end_s, 0.5, 0.0), (falling_s, end_s, 0.25, beat), (falling_s, end_s, 0.25, -beat)]
    tones: list[Row] = []
    for amplitude, frequency, phase in waves:
        omega = 2.0 * math.pi * frequency
        for first, last, share, beside in parts:
            now = phase + omega * (first - start_s)
            tones.append((share * amplitude, omega + beside, now, first, last))
    return Track(tones=np.array(tones), end=min(end_s, run_s))
