"""The simulated I/O node on its bus: its identity, its frames and its settings."""

from __future__ import annotations

import pytest

from hil.nodes.dictionary import Abort
from rigctl.config.io_section import IoSettings
from rigctl.devices import objects
from rigctl.model.device_states import NmtState
from tests.builders.rig_bench import SETTINGS, RigBench

NODE = 6
FITTED = SETTINGS.model_copy(update={"io": IoSettings(e_stop_input=9)})
COMMUNICATION, VALID_COB = objects.TPDO1_COMMUNICATION, objects.TPDO1_BASE + NODE
OFF = 1 << 31
CLOSED, OPEN = b"\x00\x02", b"\x00\x00"


@pytest.fixture
def bench() -> RigBench:
    """A node that is OPERATIONAL and sends every 20 ms at least, every 5 ms at most."""
    bench = RigBench(FITTED)
    timed(bench, inhibit=50, event=20)
    bench.nmt(1)
    return bench


def timed(bench: RigBench, *, inhibit: int, event: int) -> None:
    assert bench.write(NODE, COMMUNICATION, 1, VALID_COB | OFF, 4) == 0
    assert bench.write(NODE, COMMUNICATION, 3, inhibit, 2) == 0
    assert bench.write(NODE, COMMUNICATION, 5, event, 2) == 0
    assert bench.write(NODE, COMMUNICATION, 1, VALID_COB, 4) == 0


def inputs(bench: RigBench, ms: int) -> list[bytes]:
    """Frames it sends within so many milliseconds."""
    before = len(bench.sent(VALID_COB))
    bench.wait(ms)
    return bench.sent(VALID_COB)[before:]


def test_a_rig_without_the_section_has_no_such_node_and_no_contact_to_open() -> None:
    bench = RigBench()
    bench.nmt(1)
    bench.wait(100)
    assert bench.rig.io is None
    assert not [can_id for can_id, _ in bench.frames if can_id & 0x7F == NODE]
    assert bench.write(objects.SIMULATOR_NODE, objects.SIM_IO_E_STOP, 0, 1, 1) == Abort.DEVICE_STATE
    assert bench.read(objects.SIMULATOR_NODE, objects.SIM_IO_E_STOP) == 0


def test_it_tells_what_it_is(bench: RigBench) -> None:
    assert bench.read(NODE, objects.DEVICE_TYPE) == objects.DEVICE_TYPE_401
    assert bench.read(NODE, objects.DEVICE_TYPE) & 0xFFFF == 401
    assert bench.read(NODE, objects.INPUTS_8) == 2
    assert [bench.read(NODE, objects.INPUTS_8, block) for block in (1, 2)] == [0, 2]


def test_its_second_input_block_can_be_mapped_alone(bench: RigBench) -> None:
    assert bench.write(NODE, COMMUNICATION, 1, VALID_COB | OFF, 4) == 0
    assert bench.write(NODE, objects.TPDO1_MAPPING, 0, 0, 1) == 0
    assert bench.write(NODE, objects.TPDO1_MAPPING, 1, objects.INPUTS_8 << 16 | 2 << 8 | 8, 4) == 0
    assert bench.write(NODE, objects.TPDO1_MAPPING, 0, 1, 1) == 0
    assert bench.write(NODE, COMMUNICATION, 1, VALID_COB, 4) == 0
    assert inputs(bench, 30)[-1] == CLOSED[1:]


def test_it_says_how_it_stands_once_it_is_operational_and_then_by_its_event_timer(bench: RigBench) -> None:
    assert inputs(bench, 1) == [CLOSED]
    assert inputs(bench, 200) == [CLOSED] * 10


def test_no_sync_makes_it_send() -> None:
    bench = RigBench(FITTED)
    timed(bench, inhibit=0, event=0)
    bench.nmt(1)
    bench.drive(600, 0)
    assert bench.sent(VALID_COB) == [CLOSED]  # once; 255 is no number of SYNCs


def test_a_press_is_told_at_once_where_the_inhibit_time_is_over(bench: RigBench) -> None:
    inputs(bench, 11)
    bench.rig.io.press_e_stop(True)  # type: ignore[union-attr]
    assert inputs(bench, 1) == [OPEN]
    bench.rig.io.press_e_stop(False)  # type: ignore[union-attr]
    assert inputs(bench, 4) == []
    assert inputs(bench, 1) == [CLOSED]


def test_an_input_that_flickers_sends_no_more_often_than_the_inhibit_time(bench: RigBench) -> None:
    inputs(bench, 10)
    sent = []
    for tick in range(500):
        bench.rig.io.press_e_stop(tick % 2 == 0)  # type: ignore[union-attr]
        sent += inputs(bench, 1)
    assert 20 < len(sent) <= 500 / 5 + 1


def test_it_is_silent_unless_operational_and_says_everything_anew_when_it_is_again(bench: RigBench) -> None:
    inputs(bench, 10)
    bench.nmt(0x02, NODE)
    bench.rig.io.press_e_stop(True)  # type: ignore[union-attr]
    assert inputs(bench, 100) == []
    bench.nmt(0x01, NODE)
    assert inputs(bench, 1) == [OPEN]


def test_events_that_are_masked_or_off_wait_for_the_timer(bench: RigBench) -> None:
    inputs(bench, 10)
    assert bench.write(NODE, objects.INPUT_EVENT_MASK_8, 2, 0xFD, 1) == 0
    inputs(bench, 20)
    bench.rig.io.press_e_stop(True)  # type: ignore[union-attr]
    assert inputs(bench, 8) == []
    assert inputs(bench, 20) == [OPEN]
    assert bench.write(NODE, objects.INPUT_EVENT_MASK_8, 2, 0xFF, 1) == 0
    assert bench.write(NODE, objects.INPUT_EVENTS, 0, 0, 1) == 0
    inputs(bench, 25)
    bench.rig.io.press_e_stop(False)  # type: ignore[union-attr]
    assert inputs(bench, 5) == []
    assert inputs(bench, 20) == [CLOSED]


def test_an_input_can_be_inverted(bench: RigBench) -> None:
    assert bench.write(NODE, objects.INPUT_POLARITY_8, 2, 0x02, 1) == 0
    assert bench.read(NODE, objects.INPUTS_8, 2) == 0
    bench.rig.io.press_e_stop(True)  # type: ignore[union-attr]
    assert bench.read(NODE, objects.INPUTS_8, 2) == 2


def test_the_inhibit_time_of_a_tpdo_in_use_stands(bench: RigBench) -> None:
    assert bench.write(NODE, COMMUNICATION, 3, 10, 2) == Abort.UNSUPPORTED_ACCESS
    assert bench.read(NODE, COMMUNICATION, 3) == 50


def test_one_button_has_two_contacts_and_the_io_nodes_can_open_alone(bench: RigBench) -> None:
    simulator, drive = objects.SIMULATOR_NODE, bench.rig.drive
    for index, pressed, seen in (
        (objects.SIM_E_STOP, 1, (True, True)),
        (objects.SIM_E_STOP, 0, (False, False)),
        (objects.SIM_IO_E_STOP, 1, (False, True)),
        (objects.SIM_IO_E_STOP, 0, (False, False)),
    ):
        assert bench.write(simulator, index, 0, pressed, 1) == 0
        assert (drive.e_stop_pressed, bench.rig.io.e_stop_pressed) == seen  # type: ignore[union-attr]
        assert bench.read(simulator, objects.SIM_IO_E_STOP) == int(seen[1])
    assert bench.emergencies(drive.id) == [objects.EmcyCode.EXTERNAL]  # once, by its own contact


def test_a_reset_takes_its_settings_and_says_so(bench: RigBench) -> None:
    bench.nmt(0x81, NODE)
    assert bench.sent(objects.HEARTBEAT_BASE + NODE)[-1] == bytes([NmtState.BOOT_UP])
    assert [bench.read(NODE, COMMUNICATION, sub) for sub in (3, 5)] == [0, 0]
    bench.nmt(0x01, NODE)
    assert inputs(bench, 100) == [CLOSED]
