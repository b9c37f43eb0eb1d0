"""The two python-can buses on the simulated wire."""

from __future__ import annotations

import errno
import select
import tempfile
import threading
from collections.abc import Callable, Iterator

import can
import pytest

from hil.bus import InProcessBus
from hil.bus_link import POLLS_PER_RETRY, BusLink
from hil.hub import Hub
from hil.hub_server import HubServer
from hil.wire import ERROR_FLAG, EXTENDED_FLAG, FRAME
from rigctl.config.can_section import CanSettings
from tests.builders.waiting import patience_s


def frame(can_id: int, data: bytes = b"") -> bytes:
    return FRAME.pack(can_id, len(data), data)


def message(can_id: int, data: bytes = b"") -> can.Message:
    return can.Message(arbitration_id=can_id, data=data, is_extended_id=False)


def ids(bus: can.BusABC) -> list[int]:
    found = []
    while (received := bus.recv(0)) is not None:
        found.append(received.arbitration_id)
    return found


class Line:
    """A served hub with a local port and one client, opened as any program would."""

    def __init__(self, folder: str) -> None:
        self.hub = Hub()
        self.server = HubServer(folder + "/rig.sock", self.hub)
        self.heard: list[bytes] = []
        self.port = self.hub.attach(self.heard.append)
        self.bus = can.Bus(interface="rigsim", channel=folder + "/rig.sock")
        self.server.poll(0)


@pytest.fixture
def line() -> Iterator[Line]:
    with tempfile.TemporaryDirectory(prefix="bus", dir="/tmp") as folder:
        line = Line(folder)
        yield line
        line.bus.shutdown()
        line.server.close()


def test_messages_go_both_ways(line: Line) -> None:
    line.bus.send(message(0x204, b"abcdef"))
    line.server.poll(0)
    assert line.heard == [frame(0x204, b"abcdef")]
    line.port.send(frame(0x182, b"12345"))
    received = line.bus.recv(0)
    assert received is not None
    assert (received.arbitration_id, bytes(received.data), received.is_rx) == (0x182, b"12345", True)
    assert line.bus.recv(0) is None


def test_a_blocking_receive_waits_for_the_frame(line: Line) -> None:
    sender = threading.Timer(0.05, line.port.send, [frame(0x123)])
    sender.start()
    received = line.bus.recv(patience_s())
    sender.join()
    assert received is not None and received.arbitration_id == 0x123
    assert line.bus.recv(0.001) is None


def test_refused_frames_do_not_end_a_drain(line: Line) -> None:
    line.bus.set_filters([{"can_id": 0x182, "can_mask": 0x7FF}, {"can_id": 0x700, "can_mask": 0x780}])
    for can_id in (0x80, 0x183, 0x182, 0x184, 0x704, 0x182):
        line.port.send(frame(can_id))
    assert ids(line.bus) == [0x182, 0x704, 0x182]


def test_error_frames_pass_every_filter_and_extended_ones_only_theirs(line: Line) -> None:
    line.bus.set_filters([{"can_id": 0x182, "can_mask": 0x1FFFFFFF, "extended": True}])
    line.port.send(frame(0x182))
    line.port.send(frame(0x40 | ERROR_FLAG, bytes(8)))
    line.port.send(frame(0x182 | EXTENDED_FLAG))
    line.port.send(frame(0x183 | EXTENDED_FLAG))
    error, extended = line.bus.recv(0), line.bus.recv(0)
    assert error is not None and error.is_error_frame and error.arbitration_id == 0x40
    assert extended is not None and extended.is_extended_id
    assert line.bus.recv(0) is None


def test_a_full_send_buffer_is_an_error_at_once(line: Line) -> None:
    with pytest.raises(can.CanOperationError) as full:
        for _ in range(100_000):
            line.bus.send(message(1))
    assert full.value.error_code == errno.ENOBUFS


def test_nobody_there_is_a_clear_sentence() -> None:
    with pytest.raises(can.CanInitializationError, match=r"rigsim:/tmp/nobody\.sock: no simulated rig is served here"):
        can.Bus(interface="rigsim", channel="/tmp/nobody.sock")


def test_a_rig_that_goes_is_an_operation_error(line: Line) -> None:
    line.server.close()
    with pytest.raises(can.CanOperationError, match="has gone"):
        line.bus.recv(0)
    with pytest.raises(can.CanOperationError, match="has gone"):
        line.bus.send(message(1))


def test_its_descriptor_tells_when_a_frame_waits(line: Line) -> None:
    assert select.select([line.bus], [], [], 0)[0] == []
    line.port.send(frame(1))
    assert select.select([line.bus], [], [], 0)[0] == [line.bus]


def test_the_twin_in_process_delivers_before_send_returns() -> None:
    hub = Hub(lambda: 1_500_000_000)
    first, second = InProcessBus(hub), InProcessBus(hub, [{"can_id": 5, "can_mask": 0x7FF}])
    first.send(message(4))
    first.send(message(5, b"x"))
    received = second.recv(0)
    assert received is not None and received.arbitration_id == 5
    assert received.timestamp == pytest.approx(1.5)
    assert second.recv(0) is None and first.recv(0) is None
    for bus in (first, second):
        bus.shutdown()


def test_a_wait_on_the_twin_lets_simulated_time_pass_until_a_frame_has_come() -> None:
    """A start-up in lockstep depends on no thread's turn and on no clock of this computer."""
    passed_s: list[float] = []
    hub = Hub()
    device = InProcessBus(hub)

    def pass_time(arrived: Callable[[], bool], seconds: float) -> None:
        assert not arrived()
        passed_s.append(seconds)
        if seconds > 0.3:
            device.send(message(0x582))
            assert arrived()

    with device, InProcessBus(hub, pass_time=pass_time) as bus:
        assert bus.recv(0) is None
        assert bus.recv(0.2) is None
        received = bus.recv(0.4)
        assert received is not None and received.arbitration_id == 0x582
    assert passed_s == [0.2, 0.4]


def test_a_foreign_bus_carries_the_rigs_frames() -> None:
    """python-can's own in-process bus stands for SocketCAN, which this kernel may lack (see ``tests/guest``)."""
    heard: list[bytes] = []
    link = BusLink(CanSettings(interface="virtual", channel="hil-link", bitrate_bit_s=1_000_000), heard.append)
    with can.Bus(interface="virtual", channel="hil-link") as other:
        other.send(message(0x80))
        other.send(can.Message(arbitration_id=1, is_fd=True, data=bytes(12)))
        other.send(message(0x204, b"abc"))
        link.poll(0.001)
        assert heard == [frame(0x80), frame(0x204, b"abc")]
        link.send(frame(0x182, b"12345"))
        received = other.recv(patience_s())
        assert received is not None and bytes(received.data) == b"12345"
    assert (link.received, link.malformed, link.delivered, link.lost) == (2, 1, 1, 0)
    link.close()
    link.send(frame(1))
    assert link.lost == 1


def test_a_foreign_bus_that_vanished_is_opened_again(line: Line) -> None:
    rigsim = CanSettings(interface="rigsim", channel=str(line.server.path), bitrate_bit_s=None)
    link = BusLink(rigsim, lambda _: None)
    line.server.close()
    link.poll(0.0)
    link.send(frame(1))
    again = Line(str(line.server.path.parent))
    for _ in range(POLLS_PER_RETRY):
        link.poll(0.0)
    again.server.poll(0)
    link.send(frame(2))
    again.server.poll(0)
    assert again.heard == [frame(2)]
    assert (link.errors, link.lost) == (1, 1)
    link.close()
    again.bus.shutdown()
    again.server.close()
