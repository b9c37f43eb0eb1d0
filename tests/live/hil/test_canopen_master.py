"""The served devices against canopen's own master: SDO, NMT, EMCY, and its PDO decoder as the oracle of the layouts."""

from __future__ import annotations

import canopen
import pytest

from rigctl.devices import objects
from rigctl.devices.objects import Controlword, EmcyCode, PdoLayout, drive_state
from rigctl.model.device_states import STATUSWORD, DriveState
from tests.builders.waiting import until

pytestmark = pytest.mark.real_time
CELL, SLOPE, DRIVE, BENCH = 2, 3, 4, 112


class Rig:
    """A controller made of canopen's parts: it sends a SYNC and waits for the samples."""

    def __init__(self, network: canopen.Network) -> None:
        self.network = network
        self.payloads: dict[int, bytes] = {}
        for node in (CELL, SLOPE, DRIVE):
            network[node].tpdo.read()
            network.subscribe(objects.TPDO1_BASE + node, self._take)
        network[SLOPE].sdo[objects.TPDO1_COMMUNICATION][2].raw = 1
        network[DRIVE].rpdo.read()
        network[DRIVE].sdo[objects.MODE_OF_OPERATION].raw = objects.CYCLIC_SYNCHRONOUS_VELOCITY
        network.nmt.state = "OPERATIONAL"

    def sync(self) -> None:
        self.payloads.clear()
        self.network.sync.transmit()
        until(lambda: len(self.payloads) == 3)

    def command(self, controlword: int, velocity_um_s: int = 0) -> None:
        rpdo = self.network[DRIVE].rpdo[1]
        rpdo[objects.CONTROLWORD].raw = controlword
        rpdo[objects.TARGET_VELOCITY].raw = velocity_um_s
        rpdo.transmit()
        self.sync()

    def bring_to(self, state: DriveState, controlword: int) -> None:
        def there() -> bool:
            self.command(controlword)
            return drive_state(self.network[DRIVE].sdo[STATUSWORD].raw) is state

        until(there)

    def _take(self, can_id: int, data: bytearray, _: float) -> None:
        self.payloads[can_id - objects.TPDO1_BASE] = bytes(data)


@pytest.fixture
def rig(network: canopen.Network) -> Rig:
    return Rig(network)


def test_sdo_identity_and_scale(network: canopen.Network) -> None:
    assert network[CELL].sdo[objects.DEVICE_TYPE].raw == objects.DEVICE_TYPE_404
    assert network[CELL].sdo[objects.AI_PHYSICAL_UNIT][1].raw == objects.SI_UNIT_NEWTON
    assert network[CELL].sdo[objects.AI_DECIMAL_DIGITS][1].raw == objects.CELL_DECIMAL_DIGITS
    assert network[SLOPE].sdo[objects.SLOPE_RESOLUTION].raw == objects.SLOPE_RESOLUTION_MDEG
    assert network[DRIVE].sdo["SI unit velocity"].raw == objects.SI_MICROMETRE_PER_SECOND
    assert network[DRIVE].sdo["Manufacturer device name"].raw == "Cylinder drive"  # a segmented upload
    assert abs(network[CELL].sdo[objects.AI_PROCESS_VALUE][1].raw) < 300  # a slack rope: noise of 30 mN rms
    with pytest.raises(canopen.SdoAbortedError):
        network[CELL].sdo[objects.AI_DECIMAL_DIGITS][1].raw = 2


@pytest.mark.parametrize(
    ("node", "layout"), [(CELL, objects.CELL_TPDO), (SLOPE, objects.SLOPE_TPDO), (DRIVE, objects.DRIVE_TPDO)]
)
def test_tpdos_mean_the_same_to_canopen_and_to_our_layouts(rig: Rig, node: int, layout: PdoLayout) -> None:
    rig.sync()
    values = layout.codec.unpack(rig.payloads[node])
    decoded = rig.network[node].tpdo[1]
    assert decoded.cob_id == layout.cob_base + node
    assert [(v.index, v.subindex) for v in decoded] == [(index, sub) for index, sub, _ in layout.fields]
    decoded.data = bytearray(rig.payloads[node])
    assert tuple(variable.raw for variable in decoded) == values


def test_the_drive_moves_and_the_truth_follows(rig: Rig) -> None:
    for state, word in (
        (DriveState.READY_TO_SWITCH_ON, Controlword.SHUTDOWN),
        (DriveState.SWITCHED_ON, Controlword.SWITCH_ON),
        (DriveState.OPERATION_ENABLED, Controlword.ENABLE_OPERATION),
    ):
        rig.bring_to(state, word)
    truth = rig.network[BENCH].sdo

    def tensioned() -> bool:
        rig.command(Controlword.ENABLE_OPERATION, 20_000)
        return bool(truth[objects.SIM_TRUE_VERTICAL_MN].raw > 5000)

    until(tensioned)
    rig.command(Controlword.QUICK_STOP)
    until(lambda: drive_state(rig.network[DRIVE].sdo[STATUSWORD].raw) is DriveState.SWITCH_ON_DISABLED)
    rig.sync()
    stroke_um = rig.network[DRIVE].sdo[objects.POSITION_ACTUAL].raw
    true_um = truth[objects.SIM_TRUE_STROKE_UM].raw
    assert stroke_um == pytest.approx(true_um, abs=4)  # the encoder on the motor does not see the screw's ripple
    assert true_um > 2000
    newton = objects.CELL_TPDO.codec.unpack(rig.payloads[CELL])[0] * objects.N_PER_CELL_UNIT
    assert newton == pytest.approx(truth[objects.SIM_TRUE_VERTICAL_MN].raw / 1000, abs=0.2)  # the noise, 6 sigma


def test_the_drive_tells_of_a_lost_controller_by_emergency(rig: Rig) -> None:
    drive = rig.network[DRIVE]
    drive.sdo[objects.CONSUMER_HEARTBEAT][1].raw = 1 << 16 | 60
    rig.network.send_message(objects.HEARTBEAT_BASE + 1, b"\x05")
    until(lambda: drive.emcy.log)
    assert drive.emcy.log[0].code == EmcyCode.HEARTBEAT_LOST
    until(lambda: drive_state(drive.sdo[STATUSWORD].raw) is DriveState.FAULT)


def test_the_move_is_started_over_the_bus(rig: Rig) -> None:
    bench = rig.network[BENCH].sdo
    bench[objects.SIM_MOTION_START].raw = 1
    assert bench[objects.SIM_MOTION_STATE].raw == 1

    def leans() -> bool:
        rig.sync()
        return bool(objects.SLOPE_TPDO.codec.unpack(rig.payloads[SLOPE])[0] >= 5)

    until(leans)


def test_mappings_written_by_canopen_are_honoured(rig: Rig) -> None:
    rig.network.nmt.state = "PRE-OPERATIONAL"
    pdo = rig.network[DRIVE].tpdo[1]
    pdo.clear()
    pdo.add_variable(objects.VELOCITY_ACTUAL)
    pdo.add_variable(objects.MODE_DISPLAY)
    pdo.save()
    rig.network.nmt.state = "OPERATIONAL"
    rig.sync()
    assert rig.payloads[DRIVE] == bytes([0, 0, 0, 0, objects.CYCLIC_SYNCHRONOUS_VELOCITY])
