"""The simulated wire: every frame reaches every other port, and all ports see the same order."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterable

Receive = Callable[[bytes], None]
Tap = Callable[["Port", bytes], Iterable[bytes]]
"""Maps a frame that a port sends to the frames that go on the wire in its place."""


def _unheard(_frame: bytes) -> None:
    """Of a port that receives nothing."""


class Port:
    """One device's connection to the wire."""

    __slots__ = ("hub", "receive")

    def __init__(self, hub: Hub, receive: Receive) -> None:
        self.hub = hub
        self.receive = receive

    def send(self, frame: bytes) -> None:
        """Put a frame on the wire; it reaches every other port, after every frame sent before it.

        A tap decides what goes on the wire in its place.
        """
        hub = self.hub
        if hub.tap is None:
            hub.put(self, frame)
            return
        with hub.turn:
            for passed in hub.tap(self, frame):
                hub.put(self, passed)


class Hub:
    """Ports of one process.

    A frame sent during a delivery queues behind it, so a response never overtakes its request. Senders in different
    threads take turns.

    Args:
        now_ns: time of the frame log and of in-process receive stamps; without it nothing is logged.
    """

    def __init__(self, now_ns: Callable[[], int] | None = None) -> None:
        self.now_ns = now_ns
        self.log: list[tuple[int, bytes]] = []
        self.tap: Tap | None = None
        """A defect of the wire; an exception it raises reaches the sender."""
        self._ports: tuple[Port, ...] = ()
        self._waiting: deque[tuple[Port, bytes]] = deque()
        self._delivering = False
        self.turn = threading.RLock()
        """Held while frames are delivered; code that must not run meanwhile takes it."""

    def attach(self, receive: Receive) -> Port:
        """A new port; ``receive`` gets each frame the others send, from now on."""
        port = Port(self, receive)
        with self.turn:
            self._ports = (*self._ports, port)
        return port

    def speaker(self) -> Port:
        """A new port that only sends."""
        return Port(self, _unheard)

    def detach(self, port: Port) -> None:
        """Take a port off the wire (harmless when it is off already)."""
        with self.turn:
            self._ports = tuple(p for p in self._ports if p is not port)

    def put(self, sender: Port, frame: bytes) -> None:
        """Deliver ``frame`` without the tap."""
        with self.turn:
            self._waiting.append((sender, frame))
            if self._delivering:
                return
            self._delivering = True
            try:
                while self._waiting:
                    sender, frame = self._waiting.popleft()
                    if self.now_ns is not None:
                        self.log.append((self.now_ns(), frame))
                    for port in self._ports:
                        if port is not sender:
                            port.receive(frame)
            finally:
                self._delivering = False
