"""The bus during start-up: one thread sends a request, reads frames until its answer has come, and goes on.

canopen's own way is a thread that reads the bus, whose turn may come after the time-out of an answer that has arrived;
and its time-outs read the computer's clock, where the loop has another in lockstep. Here the bus waits (`recv` with a
time-out), and the limit of a wait is read from the clock that was passed in.
"""

from __future__ import annotations

from collections.abc import Callable

import can
import canopen
from canopen.sdo import SdoClient, SdoCommunicationError

from rigctl.devices.objects import HEARTBEAT_BASE, NmtState


class StartupBus:
    """A bus, the time on it, and canopen's network of the devices under configuration."""

    def __init__(self, bus: can.BusABC, now_ns: Callable[[], int]) -> None:
        """``now_ns``: the clock on which a ``recv`` of ``bus`` takes its time-out."""
        self.bus, self.now_ns = bus, now_ns
        self.network = canopen.Network(bus)
        self.reported: dict[int, NmtState] = {}
        """NMT state in the newest heartbeat of each device."""

    def until_ns(self, seconds: float) -> int:
        """The time ``seconds`` from now."""
        return self.now_ns() + round(seconds * 1e9)

    def receive(self, until_ns: int) -> can.Message | None:
        """The next frame, which canopen has then seen; None: none came before ``until_ns``.

        Raises:
            can.CanError: the bus cannot be read.
        """
        left_ns = until_ns - self.now_ns()
        message = self.bus.recv(left_ns * 1e-9) if left_ns > 0 else None
        if message is not None:
            for listener in self.network.listeners:
                listener(message)
        return message

    def hear(self, heard: Callable[[], bool], until_ns: int) -> bool:
        """Receive frames until ``heard()``, at most until ``until_ns``; whether it is."""
        while not heard():
            if self.receive(until_ns) is None and self.now_ns() >= until_ns:
                return heard()
        return True

    def add(self, node: int, answer_s: float) -> canopen.RemoteNode:
        """A device, which answers a request within ``answer_s``."""
        remote: canopen.RemoteNode = self.network.add_node(_RemoteNode(node, self))
        remote.sdo.RESPONSE_TIMEOUT = answer_s
        self.network.subscribe(HEARTBEAT_BASE + node, self._on_heartbeat)
        return remote

    def _on_heartbeat(self, can_id: int, data: bytearray, _timestamp: float) -> None:
        if data and data[0] & 0x7F in NmtState._value2member_map_:
            self.reported[can_id - HEARTBEAT_BASE] = NmtState(data[0] & 0x7F)


class _SdoClient(SdoClient):  # type: ignore[misc]  # canopen has no types
    """canopen's client, which reads the bus itself while it waits for an answer."""

    def __init__(self, node: _RemoteNode, rx_cobid: int, tx_cobid: int) -> None:
        super().__init__(rx_cobid, tx_cobid, node.object_dictionary)
        self._bus = node.startup_bus

    def read_response(self) -> bytes:
        """The answer to the last request, see canopen."""
        if not self._bus.hear(lambda: not self.responses.empty(), self._bus.until_ns(self.RESPONSE_TIMEOUT)):
            raise SdoCommunicationError("No SDO response received")
        answer: bytes = super().read_response()
        return answer


class _RemoteNode(canopen.RemoteNode):  # type: ignore[misc]  # canopen has no types
    """canopen's node with such a client."""

    def __init__(self, node: int, startup_bus: StartupBus) -> None:
        self.startup_bus = startup_bus
        super().__init__(node, canopen.ObjectDictionary())  # types and names: rigctl.devices.eds_file

    def add_sdo(self, rx_cobid: int, tx_cobid: int) -> _SdoClient:
        """The client that canopen's constructor asks for, before the node has a network."""
        client = _SdoClient(self, rx_cobid, tx_cobid)
        self.sdo_channels.append(client)
        return client
