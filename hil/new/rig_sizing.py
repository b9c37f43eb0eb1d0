"""The settings of a new rig that follow from the decisions, in proportion to the paper's rig.

Forces go with the target, speeds with the largest speed, times with what a stop takes meanwhile
(`rigctl.config.bounds`). The result is judged as every rig file is; nothing here is trusted.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

from hil.new.rig_decisions import DecidedRig
from rigctl.config.bounds import BLIND_MM, GRAVITY_MM_S2, SAMPLES
from rigctl.config.settings import RigSettings
from rigctl.config.strict_yaml import Path

_RANGES = (1.0, 2.0, 5.0)  # rated ranges of tension cells, in decades
_HEADROOM = 1.25  # range of the cell over the trip: the paper's
_RAMP_SHARE = 0.84  # of the largest speed, which the ramp of the tension may take: the paper's
_LEAST_HEARTBEAT_MS, _LEAST_TIMEOUT_MS, _LEAST_DEADLINE_MS = 5, 10, 5  # those of the settings
_SPARE = 1.2
_LEAST_PERIODS = 5  # of the loop, in each limit in time: a tick or two that come late are no loss
_SLOW_HZ = 200
_SLOW_WALK_N = 30.0  # `estimator.tension_walk_n` up to that rate, see the paper's rig file


class Sized(NamedTuple):
    """A setting's value, and the comment beside it where it differs from the paper's rig: None = the old one stays."""

    path: Path
    value: float | int | str
    comment: str | None = ""


def sized(name: str, decided: DecidedRig, paper: RigSettings) -> list[Sized]:
    """Every setting in which the rig differs from the paper's."""
    return [*_named(name), *_forces(decided, paper), *_speeds(decided, paper), *_periods(decided, paper)]


def _named(name: str) -> Iterator[Sized]:
    yield Sized(("rig",), name)
    yield Sized(("can", "channel"), f"/tmp/rigctl-{name}.sock")


def _forces(decided: DecidedRig, paper: RigSettings) -> Iterator[Sized]:
    tension, safety, calibration, simulation = paper.tension, paper.safety, paper.calibration, paper.simulation
    assert calibration is not None and simulation is not None
    target_n = decided.target_n
    share = target_n / tension.target_n
    less = min(1.0, share)
    high_n = _round(share * safety.tension_high_n)
    range_n = next(
        size for decade in range(-1, 6) for unit in _RANGES
        if (size := unit * 10.0**decade) >= _HEADROOM * high_n * (1.0 - 1e-9)
    )  # fmt: skip
    weight_n = round(1e-3 * GRAVITY_MM_S2 * decided.payload_kg, 1)
    yield Sized(("plant", "payload_kg"), decided.payload_kg)
    yield Sized(("plant", "spring_n_mm"), decided.spring_n_mm)
    yield Sized(("tension", "target_n"), target_n)
    yield Sized(("tension", "target_min_n"), _round(share * tension.target_min_n))
    yield Sized(("tension", "target_max_n"), _round(share * tension.target_max_n))
    yield Sized(("tension", "slack_n"), _round(less * tension.slack_n))
    yield Sized(("safety", "tension_high_n"), high_n)
    yield Sized(("safety", "tension_low_n"), _round(share * safety.tension_low_n), None)
    cell = paper.tension_cell
    yield Sized(("tension_cell", "range_n"), range_n)
    noise_n = _round(cell.noise_n * range_n / cell.range_n)
    yield Sized(("tension_cell", "noise_n"), noise_n, "rms at the loop rate, in proportion to the range")
    known_n = weight_n if weight_n <= high_n else target_n
    yield Sized(("calibration", "reference_n"), known_n, f"{1e3 * known_n / GRAVITY_MM_S2:.4g} kg x 9.80665")
    yield Sized(("calibration", "tare_limit_n"), _round(share * calibration.tare_limit_n))
    for at, row in enumerate(paper.limits):
        if row.signal in ("vertical_error_n", "tension_rate_n_s", "tension_n"):
            for key in ("high", "low", "rate"):
                if (limit := getattr(row, key)) is not None:
                    yield Sized(("limits", at, key), _round(share * limit), None)
    drive = simulation.drive
    for key, factor in (("force_n_a", max(1.0, share)), ("friction_n", share), ("creep_n_s_mm", max(1.0, share)),
                        ("seating_load_n", less)):  # fmt: skip
        yield Sized(("simulation", "drive", key), _round(factor * getattr(drive, key)))
    if (per_ampere_n := paper.cylinder.force_per_ampere_n) is not None:
        yield Sized(("cylinder", "force_per_ampere_n"), _round(max(1.0, share) * per_ampere_n))
    for part in ("rail", "pulley"):  # sized with the load: the rope swings as the paper's
        for key in ("mass_kg", "viscous_n_s_m"):
            yield Sized(("simulation", part, key), _round(share * getattr(getattr(simulation, part), key)))
    spring = decided.spring_n_mm / (paper.plant.spring_n_mm or decided.spring_n_mm)
    if (as_one := simulation.rope.damping_n_s_mm) is not None:
        damping = _round(spring * as_one)
        yield Sized(("simulation", "rope", "damping_n_s_mm"), damping, "the same loss in proportion to the stiffness")
    mass = decided.payload_kg / paper.plant.payload_kg
    for key, stiffer in (("spring_damping_n_s_mm", spring), ("rope_damping_n_s_mm", 1.0)):
        damping = _round(getattr(paper.plant, key) * math.sqrt(stiffer * mass))
        yield Sized(("plant", key), damping, "the paper's share of critical, the payload on it")
    drift = _round(share * simulation.cell.drift_n_h)
    yield Sized(("simulation", "cell", "drift_n_h"), drift)


def _speeds(decided: DecidedRig, paper: RigSettings) -> Iterator[Sized]:
    tension, cylinder, plant, safety = paper.tension, paper.cylinder, paper.plant, paper.safety
    speed, share = decided.speed_mm_s, decided.speed_mm_s / tension.speed_max_mm_s
    stiffness = plant.model_copy(update={"spring_n_mm": decided.spring_n_mm}).stiffness_n_mm
    yield Sized(("tension", "speed_max_mm_s"), speed)
    yield Sized(("cylinder", "stroke_max_mm"), decided.stroke_mm)
    ramp = min(decided.target_n / tension.target_n * tension.ramp_n_s, _RAMP_SHARE * speed * stiffness)
    yield Sized(("tension", "ramp_n_s"), _round(ramp), f"{ramp / stiffness:.2g} mm/s of stroke")
    for at, row in enumerate(paper.limits):
        if row.signal in ("speed_mm_s", "disturbance_mm_s"):
            for key in ("high", "low"):
                if (limit := getattr(row, key)) is not None:
                    yield Sized(("limits", at, key), _round(share * limit), None)
        if row.signal == "stroke_mm" and row.high is not None:
            high = decided.stroke_mm - (cylinder.stroke_max_mm - row.high)
            yield Sized(("limits", at, "high"), _round(high), None)
    share_n = decided.target_n / tension.target_n
    high_n, highest_n, lowest_n = (
        _round(share_n * found) for found in (safety.tension_high_n, tension.target_max_n, tension.target_min_n)
    )
    room_n = min(high_n - highest_n, lowest_n)
    room_mm, lag_s = room_n / stiffness, plant.command_delay_s + plant.cylinder_lag_s
    loss_ms = 1e3 * min(BLIND_MM / speed, room_mm / speed - lag_s)
    periods_ms = _periods_ms(paper)
    timeout_ms = _whole(loss_ms, max(cylinder.heartbeat_timeout_ms, periods_ms), _LEAST_TIMEOUT_MS)
    yield Sized(("cylinder", "heartbeat_timeout_ms"), timeout_ms, None)
    yield Sized(("can", "heartbeat_ms"), _whole(timeout_ms / 2, paper.can.heartbeat_ms, _LEAST_HEARTBEAT_MS))
    yield Sized(
        ("cylinder", "command_deadline_ms"),
        _whole(loss_ms, max(cylinder.command_deadline_ms, periods_ms), _LEAST_DEADLINE_MS),
        None,
    )
    overrun = _whole(paper.loop.rate_hz * BLIND_MM / speed, safety.overrun_ticks, SAMPLES)
    yield Sized(("safety", "overrun_ticks"), overrun)
    left_mm = min(BLIND_MM, room_mm - speed * (timeout_ms * 1e-3 + lag_s))
    if left_mm > 0.0:
        stop = max(cylinder.stop_deceleration_mm_s2, _SPARE * speed**2 / (2.0 * left_mm))
        yield Sized(("cylinder", "stop_deceleration_mm_s2"), float(f"{stop:.2g}"))


def _periods(decided: DecidedRig, paper: RigSettings) -> Iterator[Sized]:
    """Limits in time that a slower loop needs longer: as many of its periods, within the stroke's bound meanwhile."""
    safety, most_ms = paper.safety, math.floor(1e3 * BLIND_MM / decided.speed_mm_s)
    for key in ("stale_ms", "bus_silent_ms"):
        yield Sized(("safety", key), min(max(getattr(safety, key), _periods_ms(paper)), most_ms), None)
    share = max(1.0, _periods_ms(paper) / safety.stale_ms)
    for at, row in enumerate(paper.limits):
        if row.signal in ("cell_age_ms", "drive_age_ms") and row.high is not None:
            yield Sized(("limits", at, "high"), _round(share * row.high), None)
    if paper.loop.rate_hz <= _SLOW_HZ:
        walk_n = _round(decided.target_n / paper.tension.target_n * _SLOW_WALK_N)
        yield Sized(("estimator", "tension_walk_n"), walk_n, "calm enough for a slow loop")


def _periods_ms(paper: RigSettings) -> int:
    return math.ceil(1e3 * _LEAST_PERIODS / paper.loop.rate_hz)


def _round(value: float) -> float:
    return float(f"{value:.3g}")


def _whole(most: float, usual: int, least: int) -> int:
    return max(least, min(usual, math.floor(most)))
