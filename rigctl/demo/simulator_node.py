"""The simulator's own node, which moves the mechanism and has the plant's truth: by SDO, on the bus of a running loop.

A program that a busy computer keeps from reading the bus loses frames. So a request without an answer is repeated, on a
connection of its own, which no frames have filled meanwhile.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import can
import canopen
from canopen.sdo import SdoClient

from rigctl.demo.script import DemoError
from rigctl.devices import objects as od
from rigctl.devices.remote_node import TRIES, repeated
from rigctl.devices.startup_bus import StartupBus

ANSWER_S = 0.5


class SimulatorNode:
    """See the module. Each of its functions raises `DemoError` where the node does not answer, or refuses."""

    def __init__(self, open_bus: Callable[[], can.BusABC], now_ns: Callable[[], int]) -> None:
        """``now_ns``: the clock on which a ``recv`` of the bus takes its time-out."""
        self._open_bus, self._now_ns = open_bus, now_ns

    def read(self, index: int) -> int:
        """Value of an object."""
        data: bytes = self._repeated(index, lambda sdo: sdo.upload(index, 0))
        return int.from_bytes(data, "little", signed=True)

    def write(self, index: int, value: int) -> None:
        """Write an object of one byte."""
        self._repeated(index, lambda sdo: sdo.download(index, 0, bytes([value])))

    def moving(self) -> bool:
        """Whether the mechanism moves."""
        return bool(self.read(od.SIM_MOTION_STATE))

    def start_move(self) -> None:
        """Start the mechanism's move, unless it moves, as after a start whose answer was lost: it refuses a second."""
        self._repeated(
            od.SIM_MOTION_START,
            lambda sdo: any(sdo.upload(od.SIM_MOTION_STATE, 0)) or sdo.download(od.SIM_MOTION_START, 0, b"\1"),
        )

    def _repeated(self, index: int, transfer: Callable[[SdoClient], Any]) -> Any:
        """Result of a transfer of this object, which errors name."""
        where = f"node {od.SIMULATOR_NODE}, object 0x{index:04X}"
        try:
            return repeated(lambda: self._once(transfer))
        except canopen.SdoCommunicationError:
            raise DemoError(
                f"the simulated rig does not answer within {ANSWER_S:g} s, {TRIES} times ({where}); its processes are "
                "ended: play it again, with --lockstep in simulated time"
            ) from None
        except canopen.SdoAbortedError as error:
            raise DemoError(f"the simulated rig refuses a request ({where}): {error}") from None

    def _once(self, transfer: Callable[[SdoClient], Any]) -> Any:
        bus = self._open_bus()
        try:
            return transfer(StartupBus(bus, self._now_ns).add(od.SIMULATOR_NODE, ANSWER_S).sdo)
        finally:
            bus.shutdown()
