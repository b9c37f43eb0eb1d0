"""``python -m tests.builders.faulty_rig FILE``: the simulated rig in real time, with faults put in while it runs.

Each line of standard input is a fault of `FAULTS`; an empty line takes all of them out again.
"""

from __future__ import annotations

import contextlib
import os
import pathlib
import struct
import sys
import threading
from collections.abc import Callable
from time import monotonic_ns
from typing import ClassVar

from hil.faults import in_device
from hil.nodes.tension_amplifier import TensionAmplifier
from hil.serve import WAIT_S, Line, Service
from rigctl.config import rig_file
from rigctl.ipc.termination import ENDING, on_signals

_CAN_ID = struct.Struct("<I")
_TPDO1 = 0x180
PRIORITY = 1
TRIP_CODE = 0x2310  # continuous over current (CiA 402)


class FaultyService(Service):
    """A served rig whose devices can be made to misbehave; only the thread that serves it touches them."""

    silent: frozenset[int] = frozenset()
    waiting: ClassVar[list[str]] = []
    _how: Callable[[int], int] | None = None

    def _join(self) -> tuple[Line, Callable[[bytes], None]]:
        line, send = super()._join()

        def heard(frame: bytes) -> None:
            if _CAN_ID.unpack_from(frame)[0] not in self.silent:
                send(frame)

        return line, heard

    def run(self) -> None:
        """See `Service`; the faults that were asked for come between two turns."""
        while not self._stopping:
            self.line.poll(WAIT_S)
            while self.waiting:
                self.inject(self.waiting.pop(0))
            now_ns = monotonic_ns()
            self.rig.advance(now_ns)
            self.rig.supervise(now_ns)

    def inject(self, fault: str) -> None:
        """Put a fault in, "" takes all out."""
        FAULTS[fault](self)

    def cell_reads(self, how: Callable[[int], int]) -> None:
        """What the cell's amplifier sends instead of its reading."""
        if self._how is None:
            assert isinstance(self.rig.cell, TensionAmplifier)
            self.rig.cell.distort(*in_device.CELL, lambda raw: raw if self._how is None else self._how(raw))
        self._how = how

    def heal(self) -> None:
        """Take every fault out."""
        self.silent = frozenset()
        self.cell_reads(lambda raw: raw)
        self.rig.drive.defect = None
        self.rig.drive.press_e_stop(False)

    def fall_silent(self) -> None:
        """The cell's amplifier sends no samples."""
        assert isinstance(self.rig.cell, TensionAmplifier)
        self.silent = frozenset({_TPDO1 + self.settings.canopen_nodes["tension_cell"]})

    def run_away(self) -> None:
        """The motor turns by itself while it has power."""
        drive = self.rig.drive
        drive.defect = lambda _, braked: (0.0 if drive.stopping else 4.0, braked)


FAULTS: dict[str, Callable[[FaultyService], object]] = {
    "": FaultyService.heal,
    "e_stop": lambda service: service.rig.drive.press_e_stop(True),
    "cell_silent": FaultyService.fall_silent,
    "cell_high": lambda service: service.cell_reads(lambda raw: raw * 3 // 2),
    "rope_lost": lambda service: service.cell_reads(lambda _: 0),
    "drive_trips": lambda service: service.rig.drive.trip(TRIP_CODE),
    "runs_away": FaultyService.run_away,
}


def main(file: pathlib.Path) -> None:
    """Serve until SIGTERM."""
    service = FaultyService(rig_file.load(file))

    def read() -> None:
        for line in sys.stdin:
            service.waiting.append(line.strip())
        os._exit(0)

    on_signals(lambda *_: service.stop(), *ENDING)
    threading.Thread(target=read, daemon=True).start()
    print(service.ready, flush=True)
    with contextlib.suppress(PermissionError):  # devices do not wait for a browser on the same computer
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    try:
        service.run()
    finally:
        service.close()


if __name__ == "__main__":
    main(pathlib.Path(sys.argv[1]))
