"""Start-up against simulated commercial devices: what it accepts, what it leaves unchanged, what it refuses."""

from __future__ import annotations

import struct
from typing import Any

import can
import pytest

from hil.hub import Port
from hil.wire import EXTENDED_FLAG, FRAME, REMOTE_FLAG
from rigctl.config.rail_sections import RailEncoderSettings
from rigctl.config.settings import RigSettings
from rigctl.devices import busload, startup
from rigctl.devices import objects as od
from rigctl.devices.process_data import COMMAND, DRIVE_SPEED, DRIVE_STATUS, DriveUnits, ProcessData, wanted
from rigctl.devices.remote_node import StartupError
from rigctl.devices.startup_bus import StartupBus
from rigctl.model.device_states import NmtState
from tests.builders.rig_bench import SETTINGS, changed
from tests.builders.rig_on_hub import START_NS, RigOnHub
from tests.unit.control.test_plain_inbox import Queue
from tests.unit.hil.test_parameter_sets import with_set

CELL, SLOPE, DRIVE = 2, 3, 4
PER_MM = 209_715.2


class Devices(RigOnHub):
    """A simulated rig that is switched on; ``asked`` collects the SDO requests sent to it."""

    def __init__(self, settings: RigSettings) -> None:
        self.asked: list[bytes] = []
        super().__init__(settings)

    def take(self, frame: bytes) -> None:
        can_id, _, data = FRAME.unpack(frame)
        if can_id & ~0x7F == od.SDO_RX_BASE:
            self.asked.append(bytes([can_id & 0x7F]) + data)
        super().take(frame)

    def written(self, node: int, index: int) -> list[tuple[int, int]]:
        """What was written to the sub-indices of an object."""
        found = []
        for request in self.asked:
            command, at, sub, value = struct.unpack("<BHBI", request[1:])
            if request[0] == node and command & 0xE0 == 0x20 and at == index:
                found.append((sub, value))
        return found


def refusal(settings: RigSettings) -> str:
    with pytest.raises(StartupError) as raised:
        Devices(settings).bring_up()
    assert "\n" not in str(raised.value)
    return str(raised.value)


def drive(**cylinder: Any) -> RigSettings:
    """The stock drive, with other settings."""
    return changed(with_set("stock_drive"), cylinder=cylinder)


def test_default_devices_are_mapped_already_and_no_pdo_is_written() -> None:
    devices = Devices(SETTINGS)
    report = devices.bring_up()
    assert report.supervised
    kept = {(item.node, item.index, item.sub): item.wanted for item in report.watched}
    for node in (CELL, SLOPE, DRIVE):
        assert kept[node, od.TPDO1_COMMUNICATION, 1] & 0x7FF == od.TPDO1_BASE + node
        assert kept[node, od.TPDO1_COMMUNICATION, 2] > 0
    assert (DRIVE, od.QUICK_STOP_DECELERATION, 0) in kept
    assert report.process_data == wanted(SETTINGS)
    assert {name: layout.mapping for name, layout in report.process_data.frames.items()} == {
        "tension_cell": od.CELL_TPDO.mapping, "inclinometer": od.SLOPE_TPDO.mapping, "cylinder": od.DRIVE_TPDO.mapping,
        DRIVE_STATUS: od.DRIVE_TPDO2.mapping, COMMAND: od.DRIVE_RPDO.mapping,
    }  # fmt: skip
    for index in (od.TPDO1_MAPPING, od.TPDO2_MAPPING, od.RPDO1_MAPPING, od.TPDO1_COMMUNICATION):
        assert devices.written(DRIVE, index) == []
    assert devices.written(DRIVE, od.TPDO2_COMMUNICATION)  # off by default, and slower


@pytest.mark.parametrize("node", [CELL, SLOPE, DRIVE])
@pytest.mark.parametrize("rtr", [True, False])
def test_bit_30_of_a_cob_id_stays_as_the_device_has_it(node: int, rtr: bool) -> None:
    other = changed(SETTINGS, simulation={"devices": {"rtr": rtr}}, loop={"rate_hz": 500})
    devices = Devices(changed(other, cylinder={"status_rate_hz": 10}))
    own = devices.rig.nodes[[each.id for each in devices.rig.nodes].index(node)].device
    own.set_data(od.TPDO1_MAPPING, 0, b"\0")  # forces a new mapping
    devices.bring_up()
    flag = 0 if rtr else od.PDO_NO_RTR
    ids = [value for sub, value in devices.written(node, od.TPDO1_COMMUNICATION) if sub == 1]
    assert ids == [od.TPDO1_BASE + node | flag | od.PDO_NOT_VALID, od.TPDO1_BASE + node | flag]
    assert own.sdo[od.TPDO1_COMMUNICATION][1].raw == od.TPDO1_BASE + node | flag


def test_a_fixed_mapping_is_taken_as_it_is_and_read_back() -> None:
    report = Devices(with_set("fixed_mapping")).bring_up()
    frames = report.process_data.frames
    assert frames["tension_cell"].mapping == (0x61500108, 0x10010008, 0x91300120)
    assert frames["tension_cell"].objects == ((od.AI_STATUS, 1), (od.AI_PROCESS_VALUE, 1))
    assert frames["inclinometer"].mapping == (0x60200010, 0x60100010)
    assert frames["cylinder"].mapping == (0x60410010, 0x60640020, 0x60610008)
    assert frames[DRIVE_SPEED].cob_base == 0x380
    assert frames[COMMAND].mapping == (0x60400010, 0x60600008, 0x60FF0020)


def test_what_was_read_back_goes_through_json() -> None:
    found = Devices(with_set("fixed_mapping")).bring_up()
    assert ProcessData.of_json(found.as_json()["process_data"]) == found.process_data


def test_a_variable_mapping_is_written() -> None:
    report = Devices(with_set("stock_drive")).bring_up()
    assert report.process_data == wanted(with_set("stock_drive"))


@pytest.mark.parametrize(
    ("cylinder", "index", "why"),
    [
        ({"velocity_pdo": 2, "status_rate_hz": None}, 0x1A01, "no object 0x606C:00"),
        ({"position_pdo": 4}, 0x1A03, "no object 0x6064:00"),
    ],
)
def test_a_fixed_mapping_that_lacks_what_is_needed_is_refused_by_the_object(
    cylinder: dict[str, Any], index: int, why: str
) -> None:
    said = refusal(changed(drive(**cylinder), simulation={"devices": {"fixed_mapping": True}}))
    assert said.startswith(f"cylinder drive (node 4), object 0x{index:04X}:00: a mapping that cannot be changed")
    assert why in said


def test_an_object_the_device_does_not_have_is_refused_by_its_name() -> None:
    devices = Devices(SETTINGS)
    del devices.rig.drive.device.object_dictionary[od.VELOCITY_ACTUAL_16]
    devices.rig.drive.device.set_data(od.TPDO1_MAPPING, 0, b"\0")
    with pytest.raises(StartupError) as raised:
        devices.bring_up()
    assert str(raised.value).startswith(
        "cylinder drive (node 4), object 0x1A00:03: 0x20440010 refused: Code 0x06040041"
    )


def answered(data: bytes) -> Devices:
    """Devices of which the inclinometer answers 0x6000, 16 bits of 0.001 deg, with these bytes."""
    devices = Devices(SETTINGS)

    def tap(_sender: Port, frame: bytes) -> list[bytes]:
        can_id, size, old = FRAME.unpack(frame)
        if can_id == od.SDO_TX_BASE + SLOPE and old[1:4] == b"\x00\x60\x00":
            head = bytes([0x43 | 4 - len(data) << 2])
            return [FRAME.pack(can_id, size, head + old[1:4] + data.ljust(4, b"\0"))]
        return [frame]

    devices.hub.tap = tap
    return devices


def test_a_value_that_does_not_fit_the_objects_type_is_refused_and_not_cut() -> None:
    with pytest.raises(StartupError) as raised:
        answered(b"\x0a\x00\x01\x00").bring_up()  # 65 546, of which 16 bits are the 10 that is expected
    assert str(raised.value) == (
        "inclinometer (node 3), object 0x6000:00: answered with 4 bytes (0a 00 01 00), expected 2 (UNSIGNED16)"
    )
    with pytest.raises(StartupError, match=r"answered with 1 byte \(0a\), expected 2 \(UNSIGNED16\)"):
        answered(b"\x0a").bring_up()


def test_one_that_a_device_only_pads_is_taken() -> None:
    assert answered(b"\x0a\x00\x00\x00").bring_up().supervised


@pytest.mark.parametrize(
    ("cylinder", "per_mm", "units"),
    [
        ({}, None, DriveUnits()),
        ({"lead_mm": 5.0}, None, DriveUnits()),
        ({"lead_mm": 5.0}, PER_MM, DriveUnits(1 / PER_MM, 1 / PER_MM, 1 / PER_MM)),
        ({"increments_per_mm": PER_MM}, PER_MM, DriveUnits(1 / PER_MM, 1 / PER_MM, 1 / PER_MM)),
        (
            {"increments_per_mm": PER_MM, "speed_units_per_mm_s": 120.0, "ramp_units_per_mm_s2": 12.0},
            PER_MM,
            DriveUnits(1 / PER_MM, 1 / 120.0, 1 / 12.0),
        ),
    ],
)
def test_units_come_from_where_the_rig_file_or_the_drive_says(
    cylinder: dict[str, Any], per_mm: float | None, units: DriveUnits
) -> None:
    devices = Devices(changed(drive(**cylinder), simulation={"drive": {"increments_per_mm": per_mm}}))
    report = devices.bring_up()
    found = report.process_data.units
    assert (found.position_mm, found.speed_mm_s, found.ramp_mm_s2) == pytest.approx(
        (units.position_mm, units.speed_mm_s, units.ramp_mm_s2), rel=1e-12
    )
    ramp = devices.settings.cylinder.stop_deceleration_mm_s2 / units.ramp_mm_s2
    assert devices.written(DRIVE, od.QUICK_STOP_DECELERATION) == [(0, round(ramp))]


@pytest.mark.parametrize(
    ("cylinder", "per_mm", "where", "found", "allowed"),
    [
        ({}, PER_MM, 0x60A8, "found 0x0", "cylinder.increments_per_mm or lead_mm"),
        ({"increments_per_mm": PER_MM}, None, 0x60A8, "1000 units per mm", "expected 209715.2"),
        ({"increments_per_mm": PER_MM, "lead_mm": 10.0}, PER_MM, 0x6092, "found 104857.6 units per mm", "209715.2"),
    ],
)
def test_units_that_are_not_known_or_disagree_are_refused(
    cylinder: dict[str, Any], per_mm: float | None, where: int, found: str, allowed: str
) -> None:
    said = refusal(changed(drive(**cylinder), simulation={"drive": {"increments_per_mm": per_mm}}))
    assert f"object 0x{where:04X}" in said and found in said and allowed in said


@pytest.mark.parametrize(("section", "what"), [("tension_cell", "vendor"), ("cylinder", "product")])
def test_another_vendor_or_product_is_refused_with_both(section: str, what: str) -> None:
    said = refusal(changed(SETTINGS, **{section: {what: 0x1234}}))
    assert f"{section}.{what}" in said and "expected 0x1234" in said and f"found {what} 0x" in said


def test_the_right_vendor_and_product_are_taken() -> None:
    Devices(changed(SETTINGS, cylinder={"vendor": 0, "product": 0x402})).bring_up()


def test_devices_that_boot_are_waited_for_and_named() -> None:
    devices = Devices(with_set("slow_boot"))
    report = devices.bring_up()
    assert report.supervised
    assert [line.split(",")[0] for line in devices.said] == ["waiting for cylinder drive (node 4)"]
    assert devices.t_ns - START_NS >= 5_000_000_000
    assert all(node.nmt_state is NmtState.OPERATIONAL for node in devices.rig.nodes if node.id < 100)


def test_a_device_that_does_not_boot_is_given_up_by_name() -> None:
    settings = changed(with_set("slow_boot"), can={"boot_wait_s": 0.2}, cylinder={"sdo_timeout_ms": 50})
    settings = changed(settings, simulation={"devices": {"boot_s": 60.0}})
    devices = Devices(settings)
    with pytest.raises(StartupError) as raised:
        devices.bring_up()
    said = str(raised.value)
    assert said.startswith("cylinder drive (node 4) does not answer")
    assert "within 50 ms (cylinder.sdo_timeout_ms)" in said
    assert devices.t_ns - START_NS > 200_000_000


def test_a_slow_device_is_heard_out_within_its_own_time_out() -> None:
    devices = Devices(changed(with_set("slow_sdo"), simulation={"devices": {"sdo_ms": 100}}))
    assert devices.bring_up().supervised
    assert devices.t_ns - START_NS > len(devices.asked) * 100_000_000


def test_the_load_of_the_bus_counts_both_frames_of_a_stock_drive() -> None:
    stock = with_set("stock_drive")
    names = {item.name: item.size for item in busload.traffic(stock)}
    assert (names["drive status"], names["drive speed"]) == (6, 4)
    assert busload.traffic(stock, Devices(with_set("fixed_mapping")).bring_up().process_data)[3].size == 7


def test_a_fixed_mapping_too_long_for_the_bus_is_refused() -> None:
    settings = changed(with_set("fixed_mapping"), can={"bitrate_bit_s": 500_000}, loop={"rate_hz": 500})
    load, limit = busload.bus_load(settings), busload.LIMIT
    assert load is not None
    settings = changed(settings, can={"bitrate_bit_s": round(500_000 * load / (limit - 0.001))})
    said = refusal(settings)
    assert "bus load" in said and "expected at most 80%" in said


@pytest.mark.parametrize("can_id", [od.SYNC_COB, od.HEARTBEAT_BASE + SETTINGS.can.controller_node])
def test_another_controller_on_the_bus_ends_the_start(can_id: int) -> None:
    bus = Queue()
    bus.send(can.Message(arbitration_id=od.HEARTBEAT_BASE + DRIVE, data=b"\x05", is_extended_id=False))
    bus.send(can.Message(arbitration_id=can_id, is_extended_id=False))
    with pytest.raises(StartupError):
        startup.refuse_rival(StartupBus(bus, lambda: 0), SETTINGS)


FOREIGN = {"29-bit": EXTENDED_FLAG, "remote": REMOTE_FLAG, "29-bit remote": EXTENDED_FLAG | REMOTE_FLAG}
ABORTED = struct.Struct("<B3sI")  # an SDO abort, and the code of "object does not exist"


@pytest.mark.parametrize("flags", FOREIGN.values(), ids=FOREIGN)
@pytest.mark.parametrize("can_id", [od.SYNC_COB, od.HEARTBEAT_BASE + SETTINGS.can.controller_node])
def test_a_frame_of_another_kind_with_a_controllers_number_is_no_controller(can_id: int, flags: int) -> None:
    devices = Devices(SETTINGS)
    with devices.bus() as bus:
        devices.hub.attach(lambda _frame: None).send(FRAME.pack(can_id | flags, 1, b"\x05"))
        startup.refuse_rival(StartupBus(bus, lambda: devices.t_ns), SETTINGS)
        assert devices.t_ns - START_NS >= startup.listened_s(SETTINGS) * 1e9, "it has listened for its whole time"


@pytest.mark.parametrize("flags", FOREIGN.values(), ids=FOREIGN)
def test_a_frame_of_another_kind_is_no_answer(flags: int) -> None:
    devices = Devices(SETTINGS)

    def aborted_first(port: Port, frame: bytes) -> list[bytes]:
        """Each answer has a foreign frame before it, which is an abort of the same request."""
        can_id, _, data = FRAME.unpack(frame)
        if port is not devices.port or can_id & ~0x7F != od.SDO_TX_BASE:
            return [frame]
        return [FRAME.pack(can_id | flags, 8, ABORTED.pack(0x80, data[1:4], 0x06020000)), frame]

    devices.hub.tap = aborted_first
    assert devices.bring_up() == Devices(SETTINGS).bring_up()


@pytest.mark.parametrize("flags", FOREIGN.values(), ids=FOREIGN)
def test_a_frame_of_another_kind_is_no_heartbeat(flags: int) -> None:
    devices = Devices(SETTINGS)
    heartbeat = od.HEARTBEAT_BASE + DRIVE

    def of_another_kind(_port: Port, frame: bytes) -> list[bytes]:
        can_id, size, data = FRAME.unpack(frame)
        return [FRAME.pack(can_id | flags, size, data)] if can_id == heartbeat else [frame]

    devices.hub.tap = of_another_kind
    devices.bring_up()
    assert "cylinder drive (node 4) has not started: no heartbeat after two commands" in devices.said


def test_a_heartbeat_of_two_bytes_is_none_as_in_the_loop() -> None:
    devices = Devices(SETTINGS)
    heartbeat = od.HEARTBEAT_BASE + DRIVE

    def longer(_port: Port, frame: bytes) -> list[bytes]:
        can_id, _, data = FRAME.unpack(frame)
        return [FRAME.pack(can_id, 2, data)] if can_id == heartbeat else [frame]

    devices.hub.tap = longer
    devices.bring_up()
    assert "cylinder drive (node 4) has not started: no heartbeat after two commands" in devices.said


@pytest.mark.parametrize(("node", "pdo"), [(CELL, od.CELL_TPDO), (SLOPE, od.SLOPE_TPDO), (DRIVE, od.DRIVE_TPDO)])
def test_another_mapping_is_replaced_in_the_order_of_cia_301_and_stands_in_the_device(
    node: int, pdo: od.PdoLayout
) -> None:
    devices = Devices(SETTINGS)
    own = next(each for each in devices.rig.nodes if each.id == node).device
    own.set_data(pdo.mapping_object, 0, b"\1")  # one object of it
    written = []
    for request in (devices.bring_up(), devices.asked)[1]:
        command, index, sub, value = struct.unpack("<BHBI", request[1:])
        if request[0] == node and command & 0xE0 == 0x20 and index in (pdo.communication, pdo.mapping_object):
            written.append((index, sub, value))
    mapping = [(pdo.mapping_object, sub, entry) for sub, entry in enumerate(pdo.mapping, 1)]
    assert [item for item in written if item[0] == pdo.mapping_object] == [
        (pdo.mapping_object, 0, 0), *mapping, (pdo.mapping_object, 0, len(pdo.mapping)),
    ]  # fmt: skip
    first, last = written[0], written[-1]
    assert (first[:2], first[2] >> 31) == ((pdo.communication, 1), 1), "it is switched off first"
    assert (last[:2], last[2] >> 31) == ((pdo.communication, 1), 0), "and on again last"
    in_device = own.sdo[pdo.mapping_object]
    assert tuple(in_device[sub].raw for sub in range(1, in_device[0].raw + 1)) == pdo.mapping


ENCODER = RailEncoderSettings(counts_per_turn=1 << 20, rate_hz=100)


@pytest.mark.parametrize(("total", "good"), [(1 << 20, True), (3 << 20, True), (0, False), ((1 << 20) + 1, False)])
def test_a_rail_encoder_must_wrap_at_the_end_of_a_turn(total: int, good: bool) -> None:
    devices = Devices(SETTINGS.model_copy(update={"rail_encoder": ENCODER}))
    encoder = devices.rig.rail_encoder
    assert encoder is not None
    encoder.readers[od.ENCODER_TOTAL_RANGE, 0] = lambda: total
    if good:
        assert "rail_encoder" in devices.bring_up().process_data.frames
    else:
        with pytest.raises(StartupError, match=f"found {total}, expected whole turns of {1 << 20}"):
            devices.bring_up()
