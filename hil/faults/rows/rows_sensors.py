"""Rows of the catalogue: the cell and the inclinometer."""

from __future__ import annotations

from functools import partial

from hil.faults import in_device, in_plant
from hil.faults.expected import (
    EITHER,
    FROM_START,
    HOLD,
    PASSING,
    RIDE,
    WHEN_MOVING,
    Around,
    InjectedFault,
    Reaction,
)
from hil.faults.in_device import CELL, CELL_STATUS, LATERAL, LONG, both, reads, says, stuck
from hil.faults.rows.bus_devices import AMPLIFIER, INCLINOMETER
from rigctl.devices.objects import SLOPE_INVALID, AiStatus
from rigctl.model.states import Mode

G = 9.80665
WAY_N = 90.0
"""15 mm of stroke: the payload of this rig moves by 10 mm, so a larger motion has another cause."""

_while_turning = partial(InjectedFault, seconds=3.0, around=Around(motion=in_plant.rotating))
"""Shows only on a rope that leans."""
_from_start = partial(InjectedFault, expected=FROM_START, band_n=15.0, from_start=True)
"""Detected in the first tensioning."""

SENSOR_CELL = (
    AMPLIFIER.silent(),
    InjectedFault("cell_stuck", "the cell repeats its last sample to the last bit", stuck(CELL), HOLD, within_ms=300),
    InjectedFault(
        "cell_frozen",
        "the cell's noise goes on about one value, 1 % too low",
        reads(CELL, times=0.99, noise=0.03, freezes=True),
        WHEN_MOVING,
        band_n=WAY_N,
        latency_ms=170,
        seconds=3.0,
        why="the law drives the stroke, and nothing comes of it: so does a payload that moves",
    ),
    InjectedFault(
        "cell_drift_fast",
        "the cell drifts by 20 N/s",
        reads(CELL, drift_s=20.0),
        {
            **{mode: reaction for mode, reaction in PASSING.items() if mode is not Mode.RELEASING},
            Mode.TENSIONING: Reaction.EITHER,
        },
        seconds=4.5,
        band_n=WAY_N,
        why="it looks like a payload that moves, or like a ramp; what ends it is the way the cylinder may go",
    ),
    InjectedFault(
        "cell_drift_slow",
        "the cell drifts by 0.5 N/s",
        reads(CELL, drift_s=0.5),
        RIDE,
        seconds=3.0,
        why="not to be distinguished from a payload that moves: calibration finds it",
    ),
    InjectedFault(
        "cell_jump_up", "80 N more from one sample to the next", reads(CELL, plus=80.0), PASSING, within_ms=60
    ),
    InjectedFault(
        "cell_jump_down", "80 N less from one sample to the next", reads(CELL, plus=-80.0), PASSING, within_ms=60
    ),
    InjectedFault("cell_spike", "one sample in 200 is 80 N too high", reads(CELL, spikes=80.0), RIDE),
    InjectedFault("cell_noisy", "three times the noise", reads(CELL, noise=0.1), RIDE),
    InjectedFault(
        "cell_noise_gross",
        "noise of 20 N rms",
        reads(CELL, noise=20.0),
        {**PASSING, Mode.HOLD: Reaction.EITHER},
        band_n=15,
        within_ms=300,
        why="a stroke that is held does not mind; it trips as soon as it is to move",
    ),
    InjectedFault("cell_overload", "the amplifier says it is overloaded", in_device.overloaded(), HOLD, within_ms=10),
    InjectedFault(
        "cell_pinned_high",
        "it reads the end of its range, 500 N, and says nothing",
        reads(CELL, times=0.0, plus=500.0),
        HOLD,
        within_ms=40,
    ),
    InjectedFault(
        "cell_over_range", "it reads 650 N, more than it can", reads(CELL, times=0.0, plus=650.0), HOLD, within_ms=10
    ),
    InjectedFault(
        "cell_zero", "a broken wire: it reads 0 N", reads(CELL, times=0.0, noise=0.03), PASSING, within_ms=60
    ),
    InjectedFault(
        "cell_nan", "the number that stands for none", says(CELL, in_device.NOT_A_NUMBER), HOLD, within_ms=10
    ),
    InjectedFault(
        "cell_not_valid",
        "its status says that the sample is not valid",
        says(CELL_STATUS, int(AiStatus.NOT_VALID)),
        HOLD,
        within_ms=10,
    ),
    InjectedFault("cell_sign", "its sign turns round", reads(CELL, times=-1.0), HOLD, within_ms=60),
    InjectedFault("cell_unit", "it reads kgf for N", reads(CELL, times=1 / G), PASSING, within_ms=60),
    _from_start("cell_sign_from_start", "mounted the wrong way round", reads(CELL, times=-1.0), seconds=3.0),
    _from_start(
        "cell_unit_from_start",
        "reads kgf for N since power-on",
        reads(CELL, times=1 / G),
        seconds=4.0,
        latency_ms=170,
        why="caught while the tension is a fraction of the target",
    ),
    InjectedFault(
        "cell_frozen_on_slack",
        "the cell's noise goes on about zero since the rope was slack",
        reads(CELL, times=0.0, noise=0.03),
        FROM_START,
        seconds=4.0,
        band_n=30.0,
        from_start=True,
        why="the stroke takes up slack that has gone; the motor's current shows it, within a tenth of the target",
    ),
    _from_start(
        "cell_scale_from_start",
        "reads 0.6 of the tension since power-on",
        reads(CELL, times=0.6),
        seconds=4.0,
        why="a soft mechanism has such a stiffness too; the motor's current rises more than the tension",
    ),
    InjectedFault(
        "cell_scale_no_current",
        "reads 0.62 of the tension since power-on, and no factor gives the motor's current in newtons",
        reads(CELL, times=0.62),
        {Mode.TENSIONING: Reaction.RIDDEN},
        seconds=10.0,
        band_n=190.0,
        from_start=True,
        around=Around((("cylinder.force_per_ampere_n", None),)),
        why="300 N by the cell are 484 N; with the calibration waived, the stiffness found is a warning",
    ),
    AMPLIFIER.emergency("an emergency message, samples go on"),
    AMPLIFIER.reboots("the amplifier"),
    AMPLIFIER.emergency_vendor("samples go on"),
    AMPLIFIER.emergency_none(),
    AMPLIFIER.nmt_stopped("the amplifier"),
    AMPLIFIER.nmt_preop(),
    AMPLIFIER.no_heartbeat(),
    AMPLIFIER.length_wrong("every sample has a byte too few"),
)

SENSOR_SLOPE = (
    INCLINOMETER.silent(),
    _while_turning(
        "slope_stuck",
        "it repeats its last sample while the mechanism turns",
        both(stuck(LONG), stuck(LATERAL)),
        RIDE,
        why="at rest it repeats itself anyhow; at 0.7 deg it is worth 0.0075 %",
    ),
    InjectedFault(
        "slope_drift_slow",
        "it drifts by 1 deg/s",
        reads(LONG, drift_s=1.0),
        RIDE,
        seconds=3.0,
        why="3 deg are worth 0.14 %",
    ),
    InjectedFault(
        "slope_drift_fast",
        "it drifts by 10 deg/s",
        reads(LONG, drift_s=10.0),
        HOLD,
        seconds=3.5,
        why="beyond 14 deg the set-point would be 3 % off",
    ),
    InjectedFault("slope_jump", "20 deg from one sample to the next", reads(LONG, plus=20.0), HOLD, within_ms=300),
    InjectedFault("slope_noisy", "ten times the noise, 0.03 deg rms", reads(LONG, noise=0.03), RIDE),
    InjectedFault(
        "slope_invalid",
        "both axes say that they cannot measure",
        both(says(LONG, SLOPE_INVALID), says(LATERAL, SLOPE_INVALID)),
        HOLD,
        within_ms=30,
    ),
    InjectedFault(
        "slope_axis_invalid", "one axis says that it cannot measure", says(LATERAL, SLOPE_INVALID), HOLD, within_ms=30
    ),
    InjectedFault(
        "slope_over_range", "it reads 60 deg, more than it can", reads(LONG, times=0.0, plus=60.0), HOLD, within_ms=30
    ),
    _while_turning(
        "slope_sign",
        "its sign turns round while the mechanism turns",
        reads(LONG, times=-1.0),
        RIDE,
        why="the cosine does not care",
    ),
    _while_turning(
        "slope_unit",
        "ten times the angle while the mechanism turns",
        reads(LONG, times=10.0),
        EITHER,
        why="7 deg for 0.7 deg are worth 0.74 %, and beyond the limit of 5 deg",
    ),
    INCLINOMETER.emergency("an emergency message, samples go on"),
    INCLINOMETER.reboots(),
    INCLINOMETER.nmt_stopped(),
    INCLINOMETER.nmt_preop(),
    INCLINOMETER.no_heartbeat(),
)
