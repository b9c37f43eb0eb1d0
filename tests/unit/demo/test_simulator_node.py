"""The demo's requests to the simulator's own node on a bus that loses frames, in simulated time."""

from __future__ import annotations

import struct
from collections.abc import Callable

import pytest

from hil.hub import Port
from hil.wire import FRAME
from rigctl.config.simulation_section import DevicesSettings
from rigctl.demo.script import DemoError
from rigctl.demo.simulator_node import ANSWER_S, SimulatorNode
from rigctl.devices import objects as od
from tests.builders.rig_bench import SETTINGS
from tests.builders.rig_on_hub import RigOnHub

REQUEST, ANSWER = od.SDO_RX_BASE + od.SIMULATOR_NODE, od.SDO_TX_BASE + od.SIMULATOR_NODE
STOP_NODE = FRAME.pack(od.NMT_COB, 2, bytes([2, od.SIMULATOR_NODE]).ljust(8, b"\0"))


class Losing:
    """A rig on a wire that loses the first frame with this identifier and object; from a start on, it answers late."""

    def __init__(self, can_id: int = 0, index: int = 0, late_ms: int = 0) -> None:
        self.rig = RigOnHub(SETTINGS)
        self.node = SimulatorNode(self.rig.bus, lambda: self.rig.t_ns)
        self.starts = self.lost = 0
        self._losing, self._late_ms = (can_id, index), late_ms
        self.rig.hub.tap = self._tap

    def _tap(self, _port: Port, frame: bytes) -> list[bytes]:
        can_id, _size, data = FRAME.unpack(frame)
        (index,) = struct.unpack_from("<H", data, 1)
        if (can_id, index) == self._losing and not self.lost:
            self.lost += 1
            return []
        if (can_id, index) == (REQUEST, od.SIM_MOTION_START):
            self.starts += 1
            self.rig.rig.simulator.behave(DevicesSettings(sdo_ms=self._late_ms))
        return [frame]


@pytest.mark.parametrize("index", [od.SIM_MOTION_START, od.SIM_MOTION_STATE])
@pytest.mark.parametrize("can_id", [REQUEST, ANSWER], ids=["request", "answer"])
def test_a_lost_frame_starts_the_move_once(can_id: int, index: int) -> None:
    found = Losing(can_id, index)
    found.node.start_move()
    assert (found.lost, found.starts) == (1, 1)
    assert found.rig.rig.truth.moving
    assert found.node.moving()


@pytest.mark.parametrize("can_id", [REQUEST, ANSWER], ids=["request", "answer"])
def test_a_state_whose_frame_is_lost_is_read_again(can_id: int) -> None:
    found = Losing(can_id, od.SIM_MOTION_STATE)
    assert not found.node.moving()
    assert found.lost == 1


def test_a_write_whose_answer_is_lost_is_repeated() -> None:
    found = Losing(ANSWER, od.SIM_E_STOP)
    found.node.write(od.SIM_E_STOP, 1)
    assert (found.lost, found.node.read(od.SIM_E_STOP)) == (1, 1)


def test_an_answer_that_comes_too_late_is_none_of_the_next_request() -> None:
    found = Losing(late_ms=round(1200 * ANSWER_S))
    found.node.start_move()
    assert found.starts == 1
    assert found.rig.rig.truth.moving


@pytest.mark.parametrize("request_of", [SimulatorNode.moving, SimulatorNode.start_move])
def test_a_node_that_never_answers_is_one_line(request_of: Callable[[SimulatorNode], object]) -> None:
    found = Losing()
    found.rig.take(STOP_NODE)
    with pytest.raises(
        DemoError, match=r"^the simulated rig does not answer within 0\.5 s, 3 times \(node 112, "
    ) as no:
        request_of(found.node)
    assert "\n" not in str(no.value)


def test_a_request_that_is_refused_is_one_line() -> None:
    with pytest.raises(
        DemoError, match=r"^the simulated rig refuses a request \(node 112, object 0x2003\): Code 0x0800"
    ):
        Losing().node.write(od.SIM_IO_E_STOP, 1)
