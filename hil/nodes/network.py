"""canopen's network on the rig's own wire: frames go straight to a port, and no thread is started."""

from __future__ import annotations

from collections.abc import Callable

import canopen

from hil.wire import FRAME, FRAME_SIZE, REMOTE_FLAG, STANDARD_MASK

Handler = Callable[[int, bytes, float], None]


class RigNetwork(canopen.Network):  # type: ignore[misc]
    """All simulated devices of one process.

    Args:
        send: puts a 16-byte frame on the wire.
    """

    def __init__(self, send: Callable[[bytes], None]) -> None:
        super().__init__()
        self.subscribers: dict[int, list[Handler]] = {}  # canopen's own would queue LSS frames for ever
        self.send_frame = send

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        """Send one frame (canopen calls this for SDO responses)."""
        flag = REMOTE_FLAG if remote else 0
        self.send_frame(FRAME.pack(can_id | flag, len(data), bytes(data)))

    def send_periodic(self, can_id: int, data: bytes, period: float, remote: bool = False) -> NoTask:  # noqa: ARG002
        """Do nothing: periodic frames are produced on the rig's time, see ``Node.supervise``."""
        return NoTask()

    def receive(self, frame: bytes) -> None:
        """Dispatch one frame; these devices ignore extended, remote and error frames."""
        if len(frame) != FRAME_SIZE:
            return
        can_id, size, data = FRAME.unpack(frame)
        if can_id <= STANDARD_MASK:
            self.notify(can_id, data[:size], 0.0)

    def notify(self, can_id: int, data: bytes, timestamp: float) -> None:
        """Hand data to the subscribers of its identifier."""
        for handler in self.subscribers.get(can_id, ()):
            handler(can_id, data, timestamp)


class NoTask:
    """Stands for a periodic task that canopen may update or stop."""

    def update(self, data: bytes) -> None:
        """Nothing to update."""

    def stop(self) -> None:
        """Nothing to stop."""
