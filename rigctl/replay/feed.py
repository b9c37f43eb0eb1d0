"""A recording as input of the loop: clock, bus, commands and holds that repeat what was recorded."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import can
import numpy as np
import numpy.typing as npt

from rigctl.control.bus.hold_sockets import Hold
from rigctl.ipc.record import COMMAND, FrameFlag
from rigctl.model.states import Flag

Slots = npt.NDArray[np.void]
BATCH_TICKS = 1000
_STOPPING = Flag.STOPPING.value
_KIND = FrameFlag.ERROR.value | FrameFlag.REMOTE.value | FrameFlag.EXTENDED.value


@dataclass
class Tick:
    """Inputs and outputs of one tick; frames as (identifier, data)."""

    t_ns: int
    woke_ns: int
    sent_ns: int  # time at which it sent its frames
    ended_ns: int
    skipped: int  # periods missed since the tick before
    failures: int  # frames of the tick that the bus did not take
    end_requests: int  # so far: 1, or 2 where a second one has left a load that delayed the end
    received: list[can.Message]
    sent: list[tuple[int, bytes]]
    commands: list[tuple[Any, ...]]  # slots without their numbers
    holds: list[Hold]


def ticks(records: Slots, frames: Slots, commands: Slots, holds: Slots, taken: tuple[int, int]) -> Iterator[Tick]:
    """The ticks of ``records``, which must have no gap.

    Args:
        records: of one control process, from its first.
        frames: of at least the same time.
        commands: slots of the command ring.
        holds: slots of the ring of holds, which the loop has taken.
        taken: number of the last command and of the last hold before the first tick.
    """
    woke = records["t_ns"] + records["lateness_ns"]
    # A received frame carries the wake-up time of its tick, a sent frame a time between that and the next wake-up.
    begins = np.searchsorted(frames["t_ns"], woke).tolist()
    begins.append(_end_of_last(frames, begins[-1]) if begins else 0)
    skipped = np.diff(records["skipped"].astype(np.int64), prepend=0).tolist()
    failures = np.diff(records["send_failures"].astype(np.int64), prepend=0).tolist()
    ended = (woke[:-1] + records["work_ns"][1:]).tolist() + woke[-1:].tolist()
    stopping, delayed = records["flags"] & _STOPPING != 0, np.isfinite(records["end_s"])
    requests = ((stopping | delayed) + (stopping & np.logical_or.accumulate(delayed)).astype(np.int64)).tolist()
    ordered = _Given(commands, taken[0], tuple(field.name for field in COMMAND.fields))
    held = _Given(holds, taken[1], ("uid", "pid"))
    upto = zip(records["command_seq"].tolist(), records["hold_seq"].tolist(), strict=True)
    rows = zip(records["t_ns"].tolist(), woke.tolist(), ended, skipped, failures, requests, upto, strict=True)
    for i, (t_ns, woke_ns, ended_ns, missed, failed, requested, (last, last_hold)) in enumerate(rows):
        received, sent, sent_ns = _frames(frames[begins[i] : begins[i + 1]])
        yield Tick(
            t_ns, woke_ns, sent_ns or woke_ns, ended_ns, missed, failed, requested, received, sent,
            ordered.upto(last), [Hold(uid, pid, "") for uid, pid in held.upto(last_hold)],
        )  # fmt: skip


class _Given:
    """Slots that the loop has taken, given out in the ticks in which it took them."""

    def __init__(self, slots: Slots, taken: int, names: tuple[str, ...]) -> None:
        self._slots, self._names = deque(slots[slots["seq"] > taken]), names

    def upto(self, last: int) -> list[tuple[Any, ...]]:
        """Values of the slots up to the number ``last`` that have not been given out."""
        given = []
        while self._slots and self._slots[0]["seq"] <= last:
            slot = self._slots.popleft()
            given.append(tuple(slot[name].item() for name in self._names))
        return given


def _end_of_last(frames: Slots, begin: int) -> int:
    """End of the frames of the tick that begin at ``begin``; a tick sends all its frames at one instant."""
    sent = np.flatnonzero(frames["sent"][begin:])
    if not len(sent):
        return len(frames)
    return int(np.searchsorted(frames["t_ns"], frames["t_ns"][begin + sent[0]], side="right"))


def _frames(slots: Slots) -> tuple[list[can.Message], list[tuple[int, bytes]], int]:
    received, sent, sent_ns = [], [], 0
    for _, t_ns, can_id, is_sent, dlc, data in slots.tolist():
        content = data.ljust(8, b"\0")[:dlc]
        if is_sent:
            sent.append((can_id, content))
            sent_ns = t_ns
        else:
            received.append(_message(can_id, dlc, content))
    return received, sent, sent_ns


def _message(can_id: int, dlc: int, data: bytes) -> can.Message:
    if not can_id & _KIND:
        return can.Message(arbitration_id=can_id, is_extended_id=False, dlc=dlc, data=data)
    remote = bool(can_id & FrameFlag.REMOTE.value)
    return can.Message(
        arbitration_id=can_id & 0x1FFFFFFF,
        is_extended_id=bool(can_id & FrameFlag.EXTENDED.value),
        is_remote_frame=remote,
        is_error_frame=bool(can_id & FrameFlag.ERROR.value),
        dlc=dlc,
        data=None if remote else data,
    )


class RecordedClock:
    """`rigctl.control.clock.Clock` that repeats the recorded readings."""

    def __init__(self, started_ns: int) -> None:
        self._tick: Tick | None = None
        self._now_ns = started_ns
        self._readings: deque[int] = deque()

    def begin(self, tick: Tick) -> None:
        """Set the tick that ``next_tick`` returns next."""
        self._tick = tick
        self._readings = deque((tick.woke_ns, tick.sent_ns, tick.ended_ns))

    def now(self) -> int:
        """The next of the tick's three readings: woken up, about to send, done."""
        if self._readings:
            self._now_ns = self._readings.popleft()
        return self._now_ns

    def next_tick(self) -> tuple[int, int]:
        """Grid point and periods skipped before it."""
        assert self._tick is not None
        return self._tick.t_ns, self._tick.skipped


class RecordedBus(can.BusABC):
    """Gives the frames of a tick, keeps the sent frames, and refuses those that the bus did not take when recorded."""

    def __init__(self) -> None:
        self.channel_info = "recording"
        self._received: deque[can.Message] = deque()
        self._recorded: deque[tuple[int, bytes]] = deque()
        self._failures = 0
        self.sent: list[tuple[int, bytes]] = []
        super().__init__(channel="recording")

    def begin(self, tick: Tick) -> None:
        """Set the frames of the next tick."""
        self._received = deque(tick.received)
        self._recorded = deque(tick.sent)
        self._failures = tick.failures
        self.sent = []

    def recv(self, timeout: float | None = None) -> can.Message | None:  # noqa: ARG002 - never waits
        """The next frame, or None."""
        return self._received.popleft() if self._received else None

    def send(self, msg: can.Message, timeout: float | None = None) -> None:  # noqa: ARG002 - never waits
        """Keep a frame.

        Raises:
            can.CanOperationError: the bus did not take it when recorded.
        """
        expected = self._recorded[0][0] if self._recorded else None
        if self._failures and msg.arbitration_id != expected:
            self._failures -= 1
            raise can.CanOperationError("not taken, as recorded")
        if self._recorded:
            self._recorded.popleft()
        self.sent.append((msg.arbitration_id, bytes(msg.data)))
