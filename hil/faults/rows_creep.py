"""Rows of the catalogue: a drive that creeps at command 0, and a position or a brake that slips slowly."""

from __future__ import annotations

from collections.abc import Iterator

from hil.faults import in_device
from hil.faults.expected import ARMED, DRIVE_MS, POWER_OFF, RIDE, Expected, InjectedFault, Reaction
from hil.faults.in_device import SPEED, STROKE, both, reads
from rigctl.control.modes import Mode

HELD_MM = 1.0
"""A stroke that has to stay in place moves at most this far before it is corrected, or its brake closed."""
CORRECTED_N, CORRECTED_MM = 3.0, 0.15  # 1 %; 0.45 mm/s until the integral action corrects it
_SECONDS = {0.02: 15.0, 0.1: 10.0, 0.45: 4.0, 2.0: 1.5, 8.0: 1.0}
"""How long a creep of so many mm/s is watched: uncorrected, it would exceed the bound by then."""
_TOO_FAST_MM_S = 0.5
_OFF: Expected = {**POWER_OFF, Mode.DISARMED: Reaction.RIDDEN}
_DRIFTS: Expected = {
    **dict.fromkeys(ARMED, Reaction.RIDDEN),
    Mode.HOLD: Reaction.DRIVE_OFF,
    Mode.FAULT: Reaction.DRIVE_OFF,
    Mode.DISARMED: Reaction.LATCHED,
}


def _creeps() -> Iterator[InjectedFault]:
    for speed_mm_s, seconds in _SECONDS.items():
        corrected = speed_mm_s < _TOO_FAST_MM_S
        for way, does, sign in (("up", "winds up", 1.0), ("down", "pays out", -1.0)):
            yield InjectedFault(
                f"creep_{way}_{round(speed_mm_s * 1000)}",
                f"the motor {does} {speed_mm_s:g} mm/s faster than commanded, seen by its encoder",
                in_device.creeps(sign * speed_mm_s),
                RIDE if corrected else _OFF,
                seconds=seconds,
                band_n=CORRECTED_N if corrected else 9.0,
                latency_ms=DRIVE_MS,
                held_mm=CORRECTED_MM if corrected else HELD_MM,
                why="corrected by HOLD and by the law" if corrected else "more than a drive that follows needs",
            )


CREEP: tuple[InjectedFault, ...] = (
    *_creeps(),
    InjectedFault(
        "position_drifts",
        "its position drifts by 0.3 mm/s, its speed says nothing of it",
        reads(STROKE, drift_s=0.3),
        _DRIFTS,
        seconds=5.0,
        held_mm=HELD_MM,
        why="HOLD corrects what it sees, until the reported speed or the tension shows that the load moved",
    ),
    InjectedFault(
        "encoder_drifts",
        "position and speed say that it moves by 0.3 mm/s; it does not",
        both(reads(STROKE, drift_s=0.3), reads(SPEED, plus=0.3)),
        {**_DRIFTS, Mode.DISARMED: Reaction.LATCHED},
        seconds=5.0,
        held_mm=HELD_MM,
        latency_ms=220,
        why="the same, shown by the tension alone; DISARMED, it looks like a slipping brake, which 200 ms tell",
    ),
    InjectedFault(
        "brake_slips_slowly",
        "the brake gives way by 0.15 mm/s whenever it is closed",
        in_device.brake_slips(0.15),
        {Mode.DISARMED: Reaction.MOVES},
        seconds=8.0,
        band_n=9.0,
        latency_ms=DRIVE_MS,
        why="too slow for a limit of the speed; nothing may arm by itself",
    ),
)
