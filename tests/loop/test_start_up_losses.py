"""A start with one frame lost, or refused by the send queue, at each of its steps: it comes up, or names the cause.

Also a bus on which no device acknowledges until the devices boot, and one that goes down at a step.
"""

from __future__ import annotations

import errno
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

import can
import pytest

from hil.hub import Port
from hil.wire import FRAME
from rigctl.config.settings import RigSettings
from rigctl.devices import objects as od
from rigctl.devices.remote_node import StartupError
from rigctl.model.device_states import NmtState
from tests.builders.rig_bench import changed
from tests.builders.rig_on_hub import START_NS, RigOnHub

RESET_NODES = FRAME.pack(od.NMT_COB, 2, bytes([0x81, 0]).ljust(8, b"\0"))
QUEUE = 10  # frames in the kernel's send queue
Loss = Callable[[bool, int, bytes], list[bytes]]
"""From whether the controller sends, the number of the frame in its direction, and the frame: what reaches the wire."""


class Outcome(NamedTuple):
    """How a start ended: ``why`` is empty where it came up. Frames of the controller and of the devices are counted."""

    sent: int
    answered: int
    why: str
    running: bool
    watched: int
    said: list[str]


def lost(ours: bool, number: int) -> Loss:
    """The frame of this number in one direction is lost."""
    return lambda by_us, at, frame: [] if (by_us, at) == (ours, number) else [frame]


def refused(number: int, times: int = 1, code: int = errno.ENOBUFS) -> Loss:
    """The send queue has no room for this frame so many times."""
    left = [times]

    def loss(by_us: bool, at: int, frame: bytes) -> list[bytes]:
        if by_us and at >= number and left[0]:
            left[0] -= 1
            raise can.CanOperationError("Failed to transmit: it is full", code)
        return [frame]

    return loss


def nothing(_by_us: bool, _at: int, frame: bytes) -> list[bytes]:
    """No loss."""
    return [frame]


class Bench:
    """A rig that is started again and again: each time from power-on, or as a daemon's second start finds it."""

    def __init__(self, settings: RigSettings, *, again: bool) -> None:
        """``again``: the devices run already."""
        self._rig, self._again = RigOnHub(settings), again
        if again:
            assert self.start(nothing).running

    def start(self, loss: Loss) -> Outcome:
        """Start the devices with this loss."""
        rig, count = self._rig, {True: 0, False: 0}

        def tap(sender: Port, frame: bytes) -> list[bytes]:
            ours = sender is not rig.port
            count[ours] += 1
            return loss(ours, count[ours], frame)

        if not self._again:
            rig.take(RESET_NODES)
            rig._pass_time(lambda: False, 0.1)
        rig.hub.tap = tap
        why, watched = "", 0
        try:
            report = rig.bring_up()
            assert report.supervised
            watched = len(report.watched)
        except StartupError as error:
            why = str(error)
        finally:
            rig.hub.tap = None
        running = all(node.nmt_state is NmtState.OPERATIONAL for node in rig.rig.nodes if node.id < 100)
        return Outcome(count[True], count[False], why, running, watched, list(rig.said))


@pytest.fixture(scope="module")
def quick(settings: RigSettings) -> RigSettings:
    """Devices that answer within a millisecond, so that a lost frame costs little of the simulated time."""
    waits = {name: {"sdo_timeout_ms": 20} for name in settings.canopen_nodes}
    return changed(settings, can={"heartbeat_ms": 5}, **waits)


@pytest.fixture(params=[False, pytest.param(True, marks=pytest.mark.long)], ids=["first", "second"])
def bench(request: pytest.FixtureRequest, quick: RigSettings) -> Bench:
    return Bench(quick, again=request.param)


@pytest.mark.parametrize("ours", [True, False], ids=["to a device", "from a device"])
def test_one_lost_frame_is_not_final(bench: Bench, ours: bool) -> None:
    whole = bench.start(nothing)
    steps = whole.sent if ours else whole.answered
    assert steps > 60
    for number in range(1, steps + 1):
        found = bench.start(lost(ours, number))
        assert (found.why, found.running, found.watched) == ("", True, whole.watched), f"frame {number}"


def test_a_queue_that_is_full_for_a_moment_is_not_final(bench: Bench) -> None:
    whole = bench.start(nothing)
    for number in range(1, whole.sent + 1):
        found = bench.start(refused(number))
        assert (found.why, found.running, found.watched) == ("", True, whole.watched), f"frame {number}"
        assert found.said == whole.said, "a moment is not worth a line"


def test_a_bus_that_goes_down_ends_the_start_in_one_line(settings: RigSettings) -> None:
    bench = Bench(settings, again=False)
    channel = f"{settings.can.interface}:{settings.can.channel}"
    for number in range(1, bench.start(nothing).sent + 1, 7):
        found = bench.start(refused(number, times=10**9, code=errno.ENETDOWN))
        assert found.why == f"{channel}: Failed to transmit: it is full [Error Code {errno.ENETDOWN}]"


class Unacknowledged(RigOnHub):
    """A rig whose devices boot at ``boots_ns``: until then the controller's frames stay in its send queue."""

    def __init__(self, settings: RigSettings, boots_ns: float) -> None:
        super().__init__(settings)
        self._boots_ns, self._queue = boots_ns, deque[tuple[Port, bytes]]()
        self.hub.tap = self._tap

    def _tap(self, sender: Port, frame: bytes) -> list[bytes]:
        if self.t_ns >= self._boots_ns:
            return [frame]
        if sender is not self.port and len(self._queue) == QUEUE:
            raise can.CanOperationError("Transmit buffer full")  # python-can's own words, without a number
        if sender is not self.port:
            self._queue.append((sender, frame))
        return []

    def _pass_time(self, arrived: Callable[[], bool], seconds: float) -> None:
        if self.t_ns >= self._boots_ns:
            while self._queue:
                self.hub.put(*self._queue.popleft())
        super()._pass_time(arrived, seconds)


def test_a_bus_without_acknowledgement_until_the_devices_boot_comes_up(settings: RigSettings) -> None:
    rig = Unacknowledged(settings, START_NS + 6e9)
    report = rig.bring_up()
    assert report.supervised
    assert 6.0 < (rig.t_ns - START_NS) * 1e-9 < 9.0
    full = [line for line in rig.said if "send queue is full" in line]
    assert len(full) == 1, "said once, not for each frame"
    assert full[0].startswith(f"rigsim:{settings.can.channel}: ") and full[0].endswith("at most (can.boot_wait_s)")
    assert all(node.nmt_state is NmtState.OPERATIONAL for node in rig.rig.nodes if node.id < 100)


def test_one_that_stays_without_is_given_up_with_the_likely_cause(settings: RigSettings) -> None:
    short = changed(settings, can={"boot_wait_s": 4.0})
    rig = Unacknowledged(short, float("inf"))
    with pytest.raises(StartupError) as raised:
        rig.bring_up()
    said = str(raised.value)
    assert said.count(settings.can.channel) == 1
    assert said.isprintable() and "is the rig on and connected?" in said
    assert (rig.t_ns - START_NS) * 1e-9 == pytest.approx(4.0, abs=1.5)


def test_an_answer_that_comes_after_its_time_out_is_not_taken_for_another_objects(settings: RigSettings) -> None:
    """The first answers of the drive are late by more than its time-out, each then comes in the next one's place."""
    rig = RigOnHub(settings)
    late: deque[tuple[int, bytes]] = deque()
    held = [3]

    def tap(sender: Port, frame: bytes) -> list[bytes]:
        can_id = FRAME.unpack(frame)[0]
        if sender is rig.port and can_id == od.SDO_TX_BASE + settings.cylinder.node:
            if held[0]:
                held[0] -= 1
                late.append((rig.t_ns, frame))
                return []
            before = [each for _, each in late]
            late.clear()
            return [*before, frame]
        return [frame]

    rig.hub.tap = tap
    report = rig.bring_up()
    clean = RigOnHub(settings).bring_up()
    assert {(x.node, x.index, x.sub): x.wanted for x in report.watched} == {
        (x.node, x.index, x.sub): x.wanted for x in clean.watched
    }
