"""What is kept of a run, one row a period of the loop: the truth, the mode, and the frames that the loop received."""

from __future__ import annotations

import struct
import zlib
from typing import Any

import numpy as np
import numpy.typing as npt

from hil.lockstep import Lockstep
from hil.nodes.power_stage import StagePhase
from hil.wire import FRAME
from rigctl.devices import objects
from rigctl.devices.process_data import DRIVE_STATUS

ROW = np.dtype(
    [
        ("t_ns", "<i8"),
        ("tension_n", "<f8"), ("stroke_mm", "<f8"), ("free_mm", "<f8"), ("powered", "?"), ("braked", "?"),
        ("enabled", "?"), ("closed", "?"),
        ("mode", "u1"),
        ("command_mm_s", "<f8"), ("cell_n", "<f8"), ("status", "<u2"), ("position_mm", "<f8"), ("speed_mm_s", "<f8"),
        ("long_deg", "<f8"), ("lateral_deg", "<f8"), ("current", "<i2"), ("inputs", "<u4"),
        ("cell_age", "<i4"), ("drive_age", "<i4"), ("slope_age", "<i4"),
        ("others", "<u4"),
    ]
)  # fmt: skip
"""``braked``: the drive is off and leaves the load to its brake, which may not hold. ``enabled`` and ``closed``: as of
`hil.faults.lockstep_run.RecordedTruth`. ``others``: checksum of heartbeats
and emergency messages of this period; ages in periods."""
_LISTENED = range(0x700, 0x780)
_EMERGENCIES = range(0x81, 0x100)
_FORMATS = {"tension_cell": "iB", "cylinder": "Hih", "inclinometer": "hh"}


class FrameWatch:
    """Takes a row after every period. The frame log of the rig has to be kept (``log=True``); it is cleared here."""

    def __init__(self, rig: Lockstep) -> None:
        self._rig = rig
        process_data = rig.report.process_data
        assert process_data is not None
        ids = process_data.can_ids(rig.settings)
        self._cell, self._drive, self._slope = (ids[name] for name in _FORMATS)
        self._status = ids.get(DRIVE_STATUS, -1)
        self._command = objects.RPDO1_BASE + rig.settings.cylinder.node
        self._controller = objects.HEARTBEAT_BASE + rig.settings.can.controller_node
        self._cell_of, self._drive_of, self._slope_of = (
            struct.Struct("<" + pattern).unpack_from for pattern in _FORMATS.values()
        )
        self._last: list[Any] = [0.0, 0.0, 0, 0.0, 0.0, 0.0, 0.0, 0, 0, 0, 0, 0]
        self.rows: list[tuple[Any, ...]] = []

    def __call__(self) -> None:
        """Take the row of this period."""
        rig, last = self._rig, self._last
        others = 0
        last[9] += 1
        last[10] += 1
        last[11] += 1
        for _, frame in rig.hub.log:
            identifier, size, data = FRAME.unpack(frame)
            if identifier == self._cell and size == 5:
                last[1] = self._cell_of(data)[0] * objects.N_PER_CELL_UNIT
                last[9] = 0
            elif identifier == self._drive and size == 8:
                status, position, speed = self._drive_of(data)
                last[2], last[3], last[4] = status, position * 1e-3, speed * 1e-2
                last[10] = 0
            elif identifier == self._command:
                last[0] = int.from_bytes(data[2:6], "little", signed=True) * 1e-3
            elif identifier == self._slope and size == 4:
                last[5], last[6] = (0.01 * value for value in self._slope_of(data))
                last[11] = 0
            elif identifier == self._status:
                last[7], last[8] = int.from_bytes(data[:2], "little", signed=True), int.from_bytes(data[-4:], "little")
            elif (identifier in _LISTENED and identifier != self._controller) or identifier in _EMERGENCIES:
                others = zlib.crc32(frame, others)
        rig.hub.log.clear()
        plant = rig.rig.plant
        truth, control = plant.truth, rig.rig.drive.control
        stage = control.stage
        self.rows.append(
            (
                truth.t_ns, truth.tension_n, truth.stroke_mm, float(plant.parameters["free_length"][0]),
                stage.powered, stage.phase is StagePhase.BRAKED, control.enabled, stage.braked,
                int(rig.loop.machine.mode), *last, others,
            )
        )  # fmt: skip

    def array(self, from_row: int = 0) -> npt.NDArray[Any]:
        """The rows from one on, dtype ``ROW``."""
        return np.array(self.rows[from_row:], ROW)
