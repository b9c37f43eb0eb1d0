"""Rows of the catalogue: sensors that stop measuring and stay plausible, so that only the probe finds them."""

from __future__ import annotations

from hil.faults import in_device
from hil.faults.expected import Around, Expected, InjectedFault, Reaction
from hil.faults.in_device import CELL, SPEED, STROKE, both, reads, stuck
from rigctl.model.states import Mode

TENTH_N = 30.0
"""A tenth of the target: what a cell that does not measure may do unseen."""
_NOISE_N = 0.03
_STIFF = Around(change=(("plant.spring_n_mm", 30.0), ("limits", ())))
_SOFT = Around(change=(("limits", ()),))
_HELD: Expected = {Mode.COMPENSATING: Reaction.HELD}
_OFF: Expected = {Mode.COMPENSATING: Reaction.DRIVE_OFF}
_UNTIL_S = 8.0
"""Until the probe is on in COMPENSATING, and some to spare."""

PROBE = (
    *(
        InjectedFault(
            f"cell_frozen_{way}{rig}",
            f"the cell's noise goes on about the set-point, {plus:+g} N off{where}, and no limit is in the file",
            reads(CELL, times=0.0, plus=300.0 + plus, noise=_NOISE_N),
            _HELD,
            seconds=seconds,
            band_n=TENTH_N,
            around=around,
            why="the stroke runs away, and the cell does not show it",
        )
        for rig, where, around, seconds in (("", "", _SOFT, 6.0), ("_stiff", ", on a spring of 30 N/mm", _STIFF, 4.0))
        for way, plus in (("high", 0.05), ("low", -0.05))
    ),
    InjectedFault(
        "cell_frozen_on_set_point",
        "the cell's noise goes on about the set-point itself",
        reads(CELL, times=0.0, plus=300.0, noise=_NOISE_N),
        _HELD,
        seconds=_UNTIL_S + 12.0,
        band_n=TENTH_N,
        why="by the probe, or by what the noise moves the stroke meanwhile",
    ),
    InjectedFault(
        "cell_drift",
        "the cell drifts by -6 N/s",
        reads(CELL, drift_s=-6.0),
        _HELD,
        seconds=7.0,
        band_n=TENTH_N,
        why="the stroke follows, and the tension shows nothing of it",
    ),
    InjectedFault(
        "encoder_stuck_at_rest",
        "position and speed of the drive stay where they are while the payload rests",
        both(stuck(STROKE), reads(SPEED, times=0.0)),
        _OFF,
        seconds=_UNTIL_S + 12.0,
        band_n=3.0,
        why="the tension answers the probe, the position does not",
    ),
    InjectedFault(
        "motor_motionless_at_rest",
        "the motor does not turn, and the drive's states go on, while the payload rests",
        in_device.ignores_commands(),
        _OFF,
        seconds=_UNTIL_S + 12.0,
        band_n=3.0,
        why="by the probe, or by a command that has grown by then",
    ),
)
