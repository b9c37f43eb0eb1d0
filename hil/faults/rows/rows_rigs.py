"""Rows of the catalogue: the same faults on a stiff spring, at the highest target, and without ``limits``."""

from __future__ import annotations

from collections.abc import Iterator

from hil.faults import in_device, on_bus
from hil.faults.expected import DRIVE_MS, Around, Expected, InjectedFault, Reaction
from hil.faults.in_device import CELL, SPEED, STROKE, both, reads
from hil.faults.stand import Injector
from rigctl.model.parts import Part
from rigctl.model.states import Mode

_MODES = (Mode.HOLD, Mode.COMPENSATING)
_WAIVED = ("safety.waiver", "a study of a rig of its own: no load hangs on it")
_RIGS = (
    ("stiff", "on a spring of 30 N/mm", Around(change=(("plant.spring_n_mm", 31.0), _WAIVED)), 30.0),
    ("highest", "at the highest target", Around(change=(("tension.target_n", 350.0),)), 10.5),
    ("unlimited", "without limits", Around(change=(("limits", ()), _WAIVED)), 9.0),
)
"""Name, words, surroundings, and 1 mm or 3 % of the target in N."""
_OFF: Expected = dict.fromkeys(_MODES, Reaction.DRIVE_OFF)
_HELD: Expected = dict.fromkeys(_MODES, Reaction.HELD)
_EITHER: Expected = dict.fromkeys(_MODES, Reaction.EITHER)
_FAULTS: tuple[tuple[str, str, Injector, Expected], ...] = (
    ("cell_silent", "the cell's samples stop", on_bus.silent(on_bus.cell), _HELD),
    ("cell_gain", "the cell reads 2 % too much", reads(CELL, times=1.02), _EITHER),
    ("encoder_gain", "position and speed are 5 % too large",
     both(reads(STROKE, times=1.05), reads(SPEED, times=1.05)), _EITHER),
    ("creeps", "the motor pays out 2 mm/s faster than commanded", in_device.creeps(-2.0), _OFF),
    ("runs", "the motor winds up by 1 mm/s by itself", in_device.runs_away(1.0), _OFF),
    ("cell_jumps", "the cell reads 80 N more", reads(CELL, plus=80.0), _HELD),
    ("encoder_drifts", "position and speed show 2 mm/s too much",
     both(reads(STROKE, drift_s=2.0), reads(SPEED, plus=2.0)), _EITHER),
    ("sync_lost", "no device receives SYNC any more", on_bus.sync_lost(), _HELD),
    ("rpdo_frozen", "the drive takes the content of one command for that of every one", in_device.rpdo_frozen(),
     _EITHER),
)  # fmt: skip
_STATED = {"encoder_drifts": (Part.DRIVE,)}
"""Where it is not the part of the injector; the figures of docs/faults.md count these rows as the drive's."""


def _rows() -> Iterator[InjectedFault]:
    for rig, where, around, band_n in _RIGS:
        for name, what, injector, expected in _FAULTS:
            yield InjectedFault(
                f"{rig}_{name}", f"{what}, {where}", injector, expected, seconds=1.5, band_n=band_n,
                latency_ms=DRIVE_MS, held_mm=1.0, around=around, part=_STATED.get(name, ()),
            )  # fmt: skip


RIGS = tuple(_rows())
