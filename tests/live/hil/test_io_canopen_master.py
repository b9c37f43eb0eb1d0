"""The served I/O node against canopen's own master: its identity, its PDO as canopen saves it, and the inputs read."""

from __future__ import annotations

import pathlib
from typing import Any

import canopen
import pytest

from rigctl.config.io_section import IoSettings
from rigctl.devices import codecs, objects
from tests.builders.paths import ROOT

pytestmark = pytest.mark.real_time
IO = IoSettings(e_stop_input=10)


@pytest.fixture
def rig_file(rig_file: pathlib.Path) -> pathlib.Path:
    """The rig of the other tests here, with an I/O node."""
    rig_file.write_text(f"{rig_file.read_text()}\nio: {{e_stop_input: {IO.e_stop_input}}}\n")
    return rig_file


@pytest.fixture
def node(network: canopen.Network) -> Any:
    eds = ROOT / "config/eds/io_node.eds"
    found = network.add_node(IO.node, str(eds))
    found.sdo.RESPONSE_TIMEOUT, found.sdo.MAX_RETRIES = 5.0, 3
    return found


def received(pdo: Any) -> list[tuple[int, bool]]:
    """The next frame: each input byte as canopen reads it, and whether our decoder sees the stop pressed."""
    assert pdo.wait_for_reception(10.0) is not None
    data = bytes(pdo.data)
    decode = codecs.inputs_decoder(objects.inputs_tpdo(1))
    return [(variable.raw, not decode(data[i : i + 1]) & IO.mask) for i, variable in enumerate(pdo)]


def test_it_is_a_401_with_sixteen_digital_inputs(node: Any) -> None:
    assert node.sdo[objects.DEVICE_TYPE].raw == objects.DEVICE_TYPE_401
    assert node.sdo["Manufacturer device name"].raw == "I/O node"
    assert node.sdo[objects.INPUTS_8][0].raw == 2
    assert [node.sdo[objects.INPUTS_8][block].raw for block in (1, 2)] == [0, IO.mask]
    assert node.sdo[objects.INPUT_EVENTS].raw is True


def test_a_pdo_as_canopen_saves_it_is_sent_by_timer_and_on_a_press_and_read_alike(
    network: canopen.Network, node: Any
) -> None:
    node.tpdo.read()
    pdo = node.tpdo[1]
    assert (pdo.trans_type, [(v.index, v.subindex) for v in pdo]) == (255, [(0x6000, 1), (0x6000, 2)])
    pdo.clear()
    pdo.add_variable(objects.INPUTS_8, IO.block)
    pdo.inhibit_time, pdo.event_timer = 50, 20
    pdo.save()
    assert [node.sdo[objects.TPDO1_COMMUNICATION][sub].raw for sub in (2, 3, 5)] == [255, 50, 20]
    assert node.sdo[objects.TPDO1_MAPPING][1].raw == objects.inputs_tpdo(IO.block).mapping[0]
    network.nmt.state = "OPERATIONAL"
    assert [received(pdo) for _ in range(3)] == [[(IO.mask, False)]] * 3
    network[objects.SIMULATOR_NODE].sdo[objects.SIM_IO_E_STOP].raw = 1
    frames = [received(pdo) for _ in range(5)]
    assert frames[-1] == [(0, True)]
    assert node.emcy.log == network[4].emcy.log == []  # no fault of the node, and the drive's contact is closed
    network[objects.SIMULATOR_NODE].sdo[objects.SIM_IO_E_STOP].raw = 0
    assert [received(pdo) for _ in range(5)][-1] == [(IO.mask, False)]


def test_its_heartbeat_is_heard(node: Any) -> None:
    node.sdo[objects.PRODUCER_HEARTBEAT].raw = 20
    assert node.nmt.wait_for_heartbeat(10.0) == "PRE-OPERATIONAL"
