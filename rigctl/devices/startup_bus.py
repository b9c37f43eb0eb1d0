"""The bus during start-up: one thread sends a request, reads frames until its answer has come, and goes on.

canopen's own way is a thread that reads the bus, whose turn may come after the time-out of an answer that has arrived;
and its time-outs read the computer's clock, where the loop has another in lockstep. Here the bus waits (`recv` with a
time-out), and the limit of a wait is read from the clock that was passed in.
"""

from __future__ import annotations

import errno
from collections.abc import Callable

import can
import canopen
from canopen.sdo import SdoClient, SdoCommunicationError

from rigctl.devices import sdo
from rigctl.devices.frame_kind import OWN_KIND, kind_of
from rigctl.devices.objects import HEARTBEAT_BASE
from rigctl.model.device_states import NmtState

_QUEUE_IS_FULL = frozenset({None, errno.ENOBUFS, errno.EAGAIN})  # None: python-can's own "Transmit buffer full"
_FULL_S = 1.0
_MOMENT_NS = 100_000_000
_SEND_AGAIN_S = 0.005


class QueueFullError(can.CanOperationError):
    """A frame found no room in the send queue for as long as start-up waits: no device acknowledges."""


class StartupBus:
    """A bus, the time on it, and canopen's network of the devices under configuration."""

    def __init__(
        self,
        bus: can.BusABC,
        now_ns: Callable[[], int],
        say: Callable[[str], None] = lambda _line: None,
        waits: Callable[[str], None] = lambda _device: None,
    ) -> None:
        """``now_ns``: the clock on which a ``recv`` of ``bus`` takes its time-out.

        ``say``: called with one line before a long wait. ``waits``: with the device that each request goes to.
        """
        self.bus, self.now_ns, self._say, self.waits = bus, now_ns, say, waits
        self.network = _Network(self)
        self.boots_until_ns = 0
        """Until then a send queue may stay full, because the devices that would acknowledge boot."""
        self.reported: dict[int, NmtState] = {}
        """NMT state in the newest heartbeat of each device."""

    def until_ns(self, seconds: float) -> int:
        """The time ``seconds`` from now."""
        return self.now_ns() + round(seconds * 1e9)

    def receive(self, until_ns: int) -> can.Message | None:
        """The next frame of the rig's own kind, which canopen has then seen; None: none came before ``until_ns``.

        canopen itself takes a frame with a 29-bit identifier for one of 11 bits with the same number.

        Raises:
            can.CanError: the bus cannot be read.
        """
        while (left_ns := until_ns - self.now_ns()) > 0 and (message := self.bus.recv(left_ns * 1e-9)) is not None:
            if kind_of(message) == OWN_KIND:
                for listener in self.network.listeners:
                    listener(message)
                return message
        return None

    def send(self, message: can.Message) -> None:
        """Send a frame; one that finds no room in the send queue is sent again.

        Raises:
            QueueFullError: there was no room until ``boots_until_ns``, and for a second.
            can.CanError: the bus cannot be sent to.
        """
        begun_ns, waits = self.now_ns(), False
        until_ns = max(self.boots_until_ns, self.until_ns(_FULL_S))
        while True:
            try:
                return self.bus.send(message)
            except can.CanOperationError as error:
                if error.error_code not in _QUEUE_IS_FULL:
                    raise
            now_ns = self.now_ns()
            if now_ns >= until_ns:
                raise QueueFullError(
                    f"the send queue has been full for {(now_ns - begun_ns) * 1e-9:.0f} s, as no device acknowledges "
                    "(can.boot_wait_s): is the rig on and connected?"
                )
            if not waits and now_ns - begun_ns > _MOMENT_NS:
                waits = True
                self._say(
                    "the send queue is full, as no device acknowledges: waiting for "
                    f"{(until_ns - now_ns) * 1e-9:.0f} s more at most (can.boot_wait_s)"
                )
            self.hear(lambda: False, self.until_ns(_SEND_AGAIN_S))

    def hear(self, heard: Callable[[], bool], until_ns: int) -> bool:
        """Receive frames until ``heard()``, at most until ``until_ns``; whether it is."""
        while not heard():
            if self.receive(until_ns) is None and self.now_ns() >= until_ns:
                return heard()
        return True

    def add(self, node: int, answer_s: float, name: str = "") -> canopen.RemoteNode:
        """A device, which answers a request within ``answer_s``; ``name``: for who waits for it."""
        remote: canopen.RemoteNode = self.network.add_node(_RemoteNode(node, self, name))
        remote.sdo.RESPONSE_TIMEOUT = answer_s
        self.network.subscribe(HEARTBEAT_BASE + node, self._on_heartbeat)
        return remote

    def _on_heartbeat(self, can_id: int, data: bytearray, _timestamp: float) -> None:
        if len(data) == 1 and data[0] & 0x7F in NmtState._value2member_map_:
            self.reported[can_id - HEARTBEAT_BASE] = NmtState(data[0] & 0x7F)


class _Network(canopen.Network):  # type: ignore[misc]  # canopen has no types
    """canopen's network, which waits for room in the send queue."""

    def __init__(self, line: StartupBus) -> None:
        super().__init__(line.bus)
        self._line = line

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        """Send a frame, see `StartupBus.send`."""
        self._line.send(can.Message(arbitration_id=can_id, data=data, is_remote_frame=remote, is_extended_id=False))


class _SdoClient(SdoClient):  # type: ignore[misc]  # canopen has no types
    """canopen's client, which reads the bus itself while it waits for an answer."""

    def __init__(self, node: _RemoteNode, rx_cobid: int, tx_cobid: int) -> None:
        super().__init__(rx_cobid, tx_cobid, node.object_dictionary)
        self._bus, self._name = node.startup_bus, node.name
        self._asked: tuple[int, int] | None = None

    def send_request(self, request: bytes) -> None:
        """Send a request, see canopen."""
        self._asked = sdo.multiplexer(request)
        self._bus.waits(self._name)
        super().send_request(request)

    def read_response(self) -> bytes:
        """The answer to the last request, see canopen; one to an earlier request, which came late, is passed over."""
        until_ns = self._bus.until_ns(self.RESPONSE_TIMEOUT)
        while self._bus.hear(lambda: not self.responses.empty(), until_ns):
            late = self._asked is not None and sdo.answered(self.responses.queue[0]) not in (None, self._asked)
            if not late:
                answer: bytes = super().read_response()
                return answer
            self.responses.get_nowait()
        raise SdoCommunicationError("No SDO response received")


class _RemoteNode(canopen.RemoteNode):  # type: ignore[misc]  # canopen has no types
    """canopen's node with such a client."""

    def __init__(self, node: int, startup_bus: StartupBus, name: str) -> None:
        self.startup_bus, self.name = startup_bus, name
        super().__init__(node, canopen.ObjectDictionary())  # types and names: rigctl.devices.eds_file

    def add_sdo(self, rx_cobid: int, tx_cobid: int) -> _SdoClient:
        """The client that canopen's constructor asks for, before the node has a network."""
        client = _SdoClient(self, rx_cobid, tx_cobid)
        self.sdo_channels.append(client)
        return client
