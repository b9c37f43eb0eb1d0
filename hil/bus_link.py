"""The simulated rig on a real bus (SocketCAN, an adapter): any python-can interface, kept in use through its errors."""

from __future__ import annotations

import contextlib
import errno
import time

import can

from hil.hub import Receive
from hil.wire import frame_of, message_of
from rigctl.config.can_section import CanSettings
from rigctl.devices import can_interface

POLLS_PER_RETRY = 200
_VANISHED = frozenset({errno.ENODEV, errno.ENXIO, errno.EBADF, errno.EPIPE, errno.ECONNRESET})


class BusLink:
    """Frames to and from a python-can bus.

    Frames sent while the interface is down (ENETDOWN) or congested (ENOBUFS) are lost; an interface that has vanished
    is opened again. Lost frames and errors are counted.

    Args:
        settings: the rig file's ``can`` section.
        receive: gets each frame.

    Raises:
        can_interface.OpenError: the bus cannot be opened.
    """

    def __init__(self, settings: CanSettings, receive: Receive) -> None:
        self.received = 0
        self.delivered = 0
        self.lost = 0
        self.malformed = 0
        self.errors = 0
        self._polls_without = 0
        self._receive = receive
        self._settings = settings
        self._bus: can.BusABC | None = can_interface.opened(settings)

    def poll(self, timeout_s: float) -> None:
        """Wait at most ``timeout_s`` for a frame, then receive all waiting frames."""
        bus = self._bus
        if bus is None:
            time.sleep(timeout_s)
            self._open_again()
            return
        try:
            message = bus.recv(timeout_s)
            while message is not None:
                self._take(message)
                message = bus.recv(0) if self._bus is bus else None
        except (can.CanError, OSError) as error:
            self._note(error)

    def send(self, frame: bytes) -> None:
        """Send a frame, or count it as lost."""
        if self._bus is None:
            self.lost += 1
            return
        try:
            self._bus.send(message_of(frame, 0.0))
            self.delivered += 1
        except (can.CanError, OSError) as error:
            self.lost += 1
            self._note(error)

    def close(self) -> None:
        """Leave the bus."""
        if self._bus is not None:
            with contextlib.suppress(can.CanError, OSError):
                self._bus.shutdown()
            self._bus = None

    def _take(self, message: can.Message) -> None:
        if message.is_fd:
            self.malformed += 1
            return
        self.received += 1
        self._receive(frame_of(message))

    def _note(self, error: can.CanError | OSError) -> None:
        self.errors += 1
        code = error.error_code if isinstance(error, can.CanError) else error.errno
        if code in _VANISHED:
            self.close()

    def _open_again(self) -> None:
        self._polls_without += 1
        if self._polls_without % POLLS_PER_RETRY:
            return
        with contextlib.suppress(can_interface.OpenError):
            self._bus = can_interface.opened(self._settings)
