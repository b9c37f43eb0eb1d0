"""Rows of the catalogue: a drive that creeps at command 0, a position or a brake that slips slowly, seen and unseen."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace

from hil.faults import in_device, on_bus
from hil.faults.expected import ARMED, DRIVE_MS, POWER_OFF, RIDE, Around, Expected, InjectedFault, Reaction
from hil.faults.in_device import CELL, SPEED, STROKE, both, reads, stuck
from hil.faults.stand import Injector
from rigctl.model.states import Mode

HELD_MM = 1.0
"""A stroke that has to stay in place moves at most this far before it is corrected, or its brake closed."""
CORRECTED_N, CORRECTED_MM = 3.0, 0.15  # 1 %; 0.45 mm/s until the integral action corrects it
STOPPING_MM = 0.4
"""A drive that stops waits for a standstill, which a motor that creeps never reaches: its power is cut 0.2 mm away."""
_SECONDS = {0.02: 15.0, 0.1: 10.0, 0.45: 4.0, 2.0: 1.5, 8.0: 1.0}
"""How long a creep of so many mm/s is watched: uncorrected, it would exceed the bound by then."""
_LASTS_MM_S, _TOO_FAST_MM_S = 0.05, 0.5
_GROWS_MS, _SINKS_MS = 720.0, 1620.0
"""What goes on has to do so for 0.6 s while the motor holds, for 1.5 s on the brake."""
_LONG = ("hold.park_s", 30.0)
"""The motor holds for as long as a rig file can have it hold."""
_OFF: Expected = {**POWER_OFF, Mode.DISARMED: Reaction.RIDDEN}
_DRIFTS: Expected = {
    **dict.fromkeys(ARMED, Reaction.RIDDEN),
    Mode.HOLD: Reaction.DRIVE_OFF,
    Mode.FAULT: Reaction.DRIVE_OFF,
    Mode.DISARMED: Reaction.LATCHED,
}
_CORRECTED: Expected = {**RIDE, Mode.HOLD: Reaction.DRIVE_OFF, Mode.FAULT: Reaction.DRIVE_OFF}
_WHY = {
    (True, True): "corrected by HOLD and by the law",
    (True, False): "corrected by the law, and by HOLD until the sum of the correction is what a wrong position may do",
    (False, False): "more than a drive that follows needs",
}
_STIFF = ("plant.spring_n_mm", 35.2)  # 34 N/mm with the rope
_WAIVED = ("safety.waiver", "a study of a stiff spring: no load hangs on it")
_SPRINGS: dict[str, tuple[Around, float]] = {
    "": (Around(change=(_LONG,)), 9.0),
    "_stiff": (Around(change=(_LONG, _STIFF, _WAIVED)), 34.0),
    "_highest": (Around(change=(_LONG,), preload_n=350.0), 10.5),
}
"""Rigs on which what one sensor hides is played, with 3 % or, on the stiff spring, 1 mm in N."""
_UNSEEN: tuple[tuple[str, float], ...] = (("", 0.4), ("", -0.4), ("", 0.1), ("_stiff", -0.1), ("_highest", -0.2))


def _creeps() -> Iterator[InjectedFault]:
    for speed_mm_s, seconds in _SECONDS.items():
        corrected = speed_mm_s < _TOO_FAST_MM_S
        expected = RIDE if speed_mm_s < _LASTS_MM_S else _CORRECTED if corrected else _OFF
        for way, does, sign in (("up", "winds up", 1.0), ("down", "pays out", -1.0)):
            row = InjectedFault(
                f"creep_{way}_{round(speed_mm_s * 1000)}",
                f"the motor {does} {speed_mm_s:g} mm/s faster than commanded, seen by its encoder",
                in_device.creeps(sign * speed_mm_s),
                {mode: expected[mode] for mode in expected if expected is not _CORRECTED or mode is not Mode.FAULT},
                seconds=seconds,
                band_n=CORRECTED_N if corrected else 9.0,
                latency_ms=DRIVE_MS,
                held_mm=CORRECTED_MM if corrected else HELD_MM,
                around=Around(change=(_LONG,)),
                why=_WHY[corrected, expected is RIDE],
            )
            yield row
            if expected is _CORRECTED:
                why = "FAULT parks; the stop of the drive does not end, and its power is cut"
                yield replace(
                    row, id=f"{row.id}_fault", expected={Mode.FAULT: Reaction.DRIVE_OFF}, held_mm=STOPPING_MM, why=why
                )


def _hidden(speeds: tuple[tuple[str, float], ...], id_: str, what: str, make: Callable[[float], Injector],
            expected: Expected, why: str, latency_ms: float = DRIVE_MS) -> Iterator[InjectedFault]:  # fmt: skip
    """Rows of two faults, the first latent, at speeds slow enough that a detector with a memory of seconds is blind."""
    for rig, speed_mm_s in speeds:
        around, band_n = _SPRINGS[rig]
        sinks = Mode.DISARMED in expected
        way = "up" if speed_mm_s > 0.0 else "down"
        where = {"": "", "_stiff": ", on a spring of 34 N/mm", "_highest": ", at the highest target"}[rig]
        yield InjectedFault(
            f"{id_}_{way}_{round(abs(speed_mm_s) * 1000)}{rig}",
            f"{what.format(abs(speed_mm_s))}{where}",
            make(speed_mm_s),
            expected,
            seconds=(_SINKS_MM / abs(speed_mm_s) + 1.2) if sinks else (_SEEN_MM / abs(speed_mm_s) + 2.0),
            band_n=band_n,
            held_mm=math.inf if sinks else HELD_MM,
            latency_ms=latency_ms,
            around=around,
            why=why,
        )


def _drifts(speed_mm_s: float) -> Injector:
    return both(reads(STROKE, drift_s=speed_mm_s), reads(SPEED, plus=speed_mm_s))


_SEEN_MM = 1.0
_SINKS_MM = 0.6  # by then it is latched; a slip that goes on moves the load further, and nothing may arm by itself
_ENCODER_STUCK = both(stuck(STROKE), reads(SPEED, times=0.0))
_CELL_FROZEN = reads(CELL, freezes=True, noise=0.03)
_PARKS: Expected = {Mode.HOLD: Reaction.DRIVE_OFF}
UNSEEN: tuple[InjectedFault, ...] = (
    *_hidden(
        _UNSEEN,
        "encoder_stuck_creeps",
        "the encoder has stuck, then the motor creeps by {:g} mm/s",
        lambda speed: both(_ENCODER_STUCK, in_device.creeps(speed)),
        _PARKS,
        "the tension says what the encoder does not: they disagree, nothing is moved, the brake holds",
        _GROWS_MS,
    ),
    *_hidden(
        _UNSEEN,
        "cell_frozen_encoder_drifts",
        "the cell has frozen with its noise, then position and speed drift by {:g} mm/s",
        lambda speed: both(_CELL_FROZEN, _drifts(speed)),
        _PARKS,
        "HOLD's correction moves the load, and the cell denies it: the sum of the correction is bounded",
    ),
    *_hidden(
        (("", 0.3), ("_stiff", -0.1)),
        "cell_silent_encoder_drifts",
        "the cell is silent, then position and speed drift by {:g} mm/s",
        lambda speed: both(on_bus.silent(on_bus.cell), _drifts(speed)),
        _PARKS,
        "the same in FAULT, latched long before: a cell that is silent does not say that nothing moved",
        math.inf,
    ),
    *_hidden(
        (("", -0.5), ("", -0.05), ("_stiff", -0.1), ("_highest", -0.2)),
        "encoder_stuck_brake_slips",
        "the encoder has stuck, then the brake gives way by {:g} mm/s whenever it is closed",
        lambda speed: both(_ENCODER_STUCK, in_device.brake_slips(-speed)),
        {Mode.DISARMED: Reaction.MOVES},
        "the cell sees the load sink; nothing may arm by itself",
        _SINKS_MS,
    ),
)
_MINUTES_S = 120.0


def _minutes() -> Iterator[InjectedFault]:
    """What changes too slowly for any detector of a rate, played until the sum would be more than 3 %."""
    loaded = (Mode.DISARMED, Mode.HOLD, Mode.COMPENSATING)
    for id_, what, injector, modes, band_n in (
        ("cell_drifts_50", "the cell drifts by 0.05 N/s", reads(CELL, drift_s=0.05), loaded, 9.0),
        ("cell_drifts_200", "the cell drifts by 0.2 N/s", reads(CELL, drift_s=-0.2), loaded, 30.0),
        ("encoder_drifts_20", "the encoder drifts by 0.02 mm/s", reads(STROKE, drift_s=0.02), loaded, 9.0),
        ("motor_creeps_20", "the motor pays out 0.02 mm/s", in_device.creeps(-0.02), loaded, 9.0),
    ):  # fmt: skip
        yield InjectedFault(
            f"minutes_{id_}", f"{what} for two minutes", injector, dict.fromkeys(modes, Reaction.EITHER),
            seconds=_MINUTES_S, band_n=band_n, held_mm=1.0 if band_n == 9.0 else math.inf, latency_ms=math.inf,
        )  # fmt: skip


_POSITION_DRIFTS = InjectedFault(
    "position_drifts",
    "its position drifts by 0.3 mm/s, its speed says nothing of it",
    reads(STROKE, drift_s=0.3),
    {mode: _DRIFTS[mode] for mode in (*ARMED, Mode.FAULT)},
    seconds=5.0,
    held_mm=HELD_MM,
    latency_ms=_GROWS_MS,
    why="HOLD corrects what it sees, until the tension disagrees",
)

CREEP: tuple[InjectedFault, ...] = (
    *_creeps(),
    *_minutes(),
    *UNSEEN,
    _POSITION_DRIFTS,
    replace(
        _POSITION_DRIFTS,
        id="position_drifts_braked",
        expected={Mode.DISARMED: _DRIFTS[Mode.DISARMED]},
        latency_ms=_SINKS_MS,
        why="the brake holds the load: what goes on is looked at for longer",
    ),
    InjectedFault(
        "encoder_drifts",
        "position and speed say that it moves by 0.3 mm/s; it does not",
        _drifts(0.3),
        {**_DRIFTS, Mode.DISARMED: Reaction.LATCHED},
        seconds=5.0,
        held_mm=HELD_MM,
        latency_ms=_GROWS_MS,
        why="the same, shown by the tension alone; DISARMED, it looks like a slipping brake, which 200 ms show",
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
