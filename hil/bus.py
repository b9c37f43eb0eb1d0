"""The simulated wire as python-can interfaces: ``rigsim`` over the hub's socket, and its twin within one process."""

from __future__ import annotations

import errno
import select
import socket
from collections import deque
from collections.abc import Callable
from time import time

import can
from can.typechecking import CanFilters

from hil.hub import Hub
from hil.wire import ERROR_FLAG, EXTENDED_FLAG, FRAME, FRAME_SIZE, STANDARD_MASK, frame_of, message_of

PassTime = Callable[[Callable[[], bool], float], None]
"""Let simulated time pass until the function returns true, for that many seconds at most."""
_GONE = frozenset({errno.EPIPE, errno.ECONNRESET, errno.ENOTCONN, errno.EBADF})


class RigSimBus(can.BusABC):
    """``can.Bus(interface="rigsim", channel=SOCKET)``: a client of ``python -m hil serve``.

    Filters work as in the kernel: a refused frame is never seen and does not end a drain; error frames pass.

    Raises:
        can.CanInitializationError: no process serves the socket.
        can.CanOperationError: the simulated rig has ended, or the send buffer is full.
    """

    def __init__(self, channel: str, can_filters: CanFilters | None = None, **kwargs: object) -> None:
        self.channel = str(channel)
        self.channel_info = f"rigsim:{self.channel}"
        self._accepted: bytes | None = None
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET | socket.SOCK_CLOEXEC)
        try:
            self._socket.connect(self.channel)
        except OSError as error:
            self._socket.close()
            reason = f"{self.channel_info}: no simulated rig is served here ({error.strerror or error})"
            raise can.CanInitializationError(reason) from None
        self._socket.setblocking(False)
        self._recv = self._socket.recv
        self._poll = select.poll()
        self._poll.register(self._socket, select.POLLIN)
        super().__init__(channel=channel, can_filters=can_filters, **kwargs)

    def fileno(self) -> int:
        """Descriptor that is readable when a frame waits."""
        return self._socket.fileno()

    def send(self, msg: can.Message, timeout: float | None = None) -> None:  # noqa: ARG002 - never waits
        """Hand a frame to the hub; a full buffer is an error at once, like ENOBUFS."""
        try:
            self._socket.send(frame_of(msg))
        except BlockingIOError:
            raise can.CanOperationError(f"{self.channel_info}: send buffer full", errno.ENOBUFS) from None
        except OSError as error:
            raise self._failure(error) from None

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """The next frame, as python-can gives it; a call that does not wait needs none of its clock, loop and log."""
        if timeout != 0:
            return super().recv(timeout)
        message, filtered = self._recv_internal(0)
        return message if message is None or filtered or self._matches_filters(message) else None

    def shutdown(self) -> None:
        """Close the connection."""
        super().shutdown()
        self._socket.close()

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        while True:
            try:
                frame = self._recv(FRAME_SIZE)
            except BlockingIOError:
                if timeout == 0 or not self._wait(timeout):
                    return None, True
                continue
            except OSError as error:
                raise self._failure(error) from None
            if not frame:
                raise can.CanOperationError(f"{self.channel_info}: the simulated rig has gone", errno.EPIPE)
            message = message_of(frame, time(), self.channel)
            if self._accepted is None:
                return message, True
            if message.is_extended_id or message.is_error_frame or self._accepted[message.arbitration_id]:
                return message, not message.is_extended_id

    def _wait(self, timeout: float | None) -> bool:
        try:
            return bool(self._poll.poll(None if timeout is None else timeout * 1000))
        except OSError as error:
            raise self._failure(error) from None

    def _apply_filters(self, filters: CanFilters | None) -> None:
        self._accepted = _acceptance(filters) if filters else None

    def _failure(self, error: OSError) -> can.CanOperationError:
        reason = "the simulated rig has gone" if error.errno in _GONE else error.strerror
        return can.CanOperationError(f"{self.channel_info}: {reason}", error.errno)


class InProcessBus(can.BusABC):
    """The same wire within one process, for lockstep: a frame has arrived when ``send`` returns.

    Receive stamps are the hub's time (s). A ``recv`` with a time-out lets simulated time pass until a frame has come.
    """

    def __init__(self, hub: Hub, can_filters: CanFilters | None = None, pass_time: PassTime | None = None) -> None:
        """``pass_time``: for a ``recv`` with a time-out; without it no time passes."""
        self.channel_info = "rigsim in process"
        self._hub = hub
        self._frames: deque[bytes] = deque()
        self._pass_time = pass_time
        self._accepted: bytes | None = None
        self._port = hub.attach(self._take)
        super().__init__(channel="in-process", can_filters=can_filters)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:  # noqa: ARG002 - never waits
        """Deliver a frame to every other port of the hub."""
        self._port.send(frame_of(msg))

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """The next frame; None: none has come within ``timeout`` seconds of simulated time."""
        if timeout and not self._frames and self._pass_time is not None:
            self._pass_time(lambda: bool(self._frames), timeout)
        if not self._frames:
            return None
        now_ns = self._hub.now_ns
        message = message_of(self._frames.popleft(), now_ns() * 1e-9 if now_ns else 0.0)
        refused = self._accepted is not None and message.is_extended_id and not self._matches_filters(message)
        return None if refused else message

    def shutdown(self) -> None:
        """Leave the hub."""
        super().shutdown()
        self._hub.detach(self._port)

    def _take(self, frame: bytes) -> None:
        if self._accepted is not None and not _accepts(self._accepted, frame):
            return
        self._frames.append(frame)

    def _apply_filters(self, filters: CanFilters | None) -> None:
        self._accepted = _acceptance(filters) if filters else None


def _acceptance(filters: CanFilters) -> bytes:
    """One byte per standard identifier: whether any of the filters lets it pass."""
    return bytes(
        any((can_id ^ f["can_id"]) & f["can_mask"] == 0 and not f.get("extended", False) for f in filters)
        for can_id in range(STANDARD_MASK + 1)
    )


def _accepts(accepted: bytes, frame: bytes) -> bool:
    """Standard frames pass by the table, error frames always; python-can itself filters extended frames."""
    can_id: int = FRAME.unpack(frame)[0]
    return bool(can_id & (ERROR_FLAG | EXTENDED_FLAG) or accepted[can_id & STANDARD_MASK])
