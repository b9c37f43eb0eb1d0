"""A simulated rig on a hub, a controller on its bus, and a clock that only this bench moves."""

from __future__ import annotations

import struct
from typing import Any, cast

from pydantic import BaseModel

from hil.hub import Hub
from hil.rig import SimulatedRig
from hil.wire import FRAME
from rigctl.config import rig_file as config
from rigctl.config.settings import RigSettings
from rigctl.devices import objects
from rigctl.devices.objects import Controlword, drive_state
from rigctl.model.device_states import STATUSWORD, DriveState
from tests.builders.paths import ROOT

REPOSITORY = ROOT
MS = 1_000_000
SAME_CLOCKS = {name: {"clock_ppm": 0.0} for name in ("drive", "cell", "inclinometer")}
"""For ``simulation``: without clock errors, frames can be counted by the millisecond."""
SIZES = {1: "<B", 2: "<H", 4: "<I"}


def changed(settings: RigSettings | None = None, /, **sections: dict[str, Any]) -> RigSettings:
    """Settings with some values of some sections replaced; a dictionary for a section inside one is merged likewise."""
    return cast(RigSettings, _merged(settings or SETTINGS, sections))


def _merged(section: Any, values: dict[str, Any]) -> Any:
    update = {}
    for name, value in values.items():
        before = getattr(section, name)  # an unknown name is a mistake of the test
        inner = isinstance(value, dict) and isinstance(before, BaseModel)
        update[name] = _merged(before, value) if inner else value
    return section.model_copy(update=update)


SETTINGS = changed(config.load(REPOSITORY / "config/paper_rig.yaml"), simulation=SAME_CLOCKS)


class RigBench:
    """Frames sent by the rig collect in ``frames`` as (identifier, data)."""

    def __init__(self, settings: RigSettings = SETTINGS, start_ns: int = 0, **rig: Any) -> None:
        self.t_ns = start_ns
        self.frames: list[tuple[int, bytes]] = []
        self.hub = Hub()
        self._port = self.hub.attach(self._take)
        self.rig = SimulatedRig(settings, start_ns, self.hub.attach(self._give).send, **rig)

    def send(self, can_id: int, data: bytes = b"") -> None:
        self._port.send(FRAME.pack(can_id, len(data), data))

    def wait(self, ms: int) -> None:
        """Let time pass without a frame."""
        for _ in range(ms):
            self.t_ns += MS
            self.rig.advance(self.t_ns)
            self.rig.supervise(self.t_ns)

    def drive(self, ms: int, controlword: int, velocity_mm_s: float = 0.0) -> None:
        """Send what a healthy controller at 1 kHz sends: heartbeat, command and SYNC every millisecond."""
        for _ in range(ms):
            self.send(objects.HEARTBEAT_BASE + SETTINGS.can.controller_node, b"\x05")
            self.command(controlword, velocity_mm_s)
            self.send(objects.SYNC_COB)
            self.wait(1)

    def command(self, controlword: int, velocity_mm_s: float = 0.0) -> None:
        payload = objects.DRIVE_RPDO.codec.pack(controlword, round(velocity_mm_s * 1000))
        self.send(objects.RPDO1_BASE + self.rig.drive.id, payload)

    def nmt(self, command: int, node: int = 0) -> None:
        self.send(objects.NMT_COB, bytes([command, node]))

    def enable(self) -> None:
        """Start the nodes, watch heartbeat and commands, and bring the drive to OPERATION ENABLED."""
        node = self.rig.drive.id
        self.write(node, objects.MODE_OF_OPERATION, 0, 9, 1)
        self.write(node, objects.CONSUMER_HEARTBEAT, 1, SETTINGS.can.controller_node << 16 | 60, 4)
        self.write(node, objects.RPDO1_COMMUNICATION, 5, 30, 2)
        self.nmt(1)
        for word in (Controlword.SHUTDOWN, Controlword.SWITCH_ON):
            self.drive(2, word)
        self.drive(SETTINGS_BRAKE_MS + 3, Controlword.ENABLE_OPERATION)
        assert self.state() is DriveState.OPERATION_ENABLED

    def write(self, node: int, index: int, subindex: int, value: int, size: int) -> int:
        """Expedited SDO download; returns the abort code, 0 = done."""
        mask = (1 << 8 * size) - 1
        request = struct.pack("<BHBI", 0x23 | (4 - size) << 2, index, subindex, value & mask)
        command, _, _, code = struct.unpack("<BHBI", self.ask(node, request))
        return int(code) if command == 0x80 else 0

    def read(self, node: int, index: int, subindex: int = 0) -> int:
        """Expedited SDO upload of an unsigned number."""
        answer = self.ask(node, struct.pack("<BHBI", 0x40, index, subindex, 0))
        assert answer[0] & 0xE3 == 0x43, f"{index:04X}:{subindex:02X} answered {answer.hex(' ')}"
        return int.from_bytes(answer[4 : 8 - (answer[0] >> 2 & 3)], "little")

    def state(self) -> DriveState:
        """State of the drive, as a controller reads it."""
        return drive_state(self.read(self.rig.drive.id, STATUSWORD))

    def sent(self, can_id: int) -> list[bytes]:
        return [data for found, data in self.frames if found == can_id]

    def emergencies(self, node: int) -> list[int]:
        return [struct.unpack_from("<H", data)[0] for data in self.sent(objects.EMCY_BASE + node)]

    def ask(self, node: int, request: bytes) -> bytes:
        """Send one SDO request; returns its one response."""
        before = len(self.sent(objects.SDO_TX_BASE + node))
        self.send(objects.SDO_RX_BASE + node, request)
        answers = self.sent(objects.SDO_TX_BASE + node)[before:]
        assert len(answers) == 1, f"{len(answers)} answers to {request.hex(' ')}"
        return answers[0]

    def _give(self, frame: bytes) -> None:
        self.rig.receive(frame)

    def _take(self, frame: bytes) -> None:
        can_id, size, data = FRAME.unpack(frame)
        self.frames.append((can_id, data[:size]))


assert SETTINGS.simulation is not None
SETTINGS_BRAKE_MS = SETTINGS.simulation.drive.brake_ms
