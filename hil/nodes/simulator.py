"""The simulator node: tests start the move, press the emergency stop and read the truth through it."""

from __future__ import annotations

import pathlib
from collections.abc import Callable

from hil.nodes.cylinder_drive import CylinderDrive, ServiceTool
from hil.nodes.dictionary import Abort, refuse
from hil.nodes.io_node import IoNode
from hil.nodes.network import RigNetwork
from hil.nodes.node import Node
from hil.plant import Plant
from rigctl.devices import objects

SERIAL = 112001


class Simulator(Node):
    """Objects 0x2000 (start), 0x2001 (moving), 0x2100 (true vertical tension), 0x2101 (true stroke), and the E-stop.

    The emergency stop is one button (0x2002) with a contact for the drive and one for the I/O node, where there is one;
    0x2003 opens that of the I/O node alone. 0x2004 (um/s) makes a service tool move the drive.

    Args:
        start_motion: starts the move; False when it cannot (one is under way, or there is none to start).
        drive: drive whose emergency stop is pressed and released.
        io: I/O node that mirrors it, if one is fitted.
    """

    def __init__(
        self,
        network: RigNetwork,
        eds: pathlib.Path,
        plant: Plant,
        start_motion: Callable[[], bool],
        drive: CylinderDrive,
        io: IoNode | None,
    ) -> None:
        super().__init__(network, objects.SIMULATOR_NODE, eds, plant, SERIAL)
        self._start_motion = start_motion
        self.writers[objects.SIM_MOTION_START, 0] = self._start
        self.readers[objects.SIM_MOTION_START, 0] = lambda: 0
        self._drive, self._io = drive, io
        self.writers[objects.SIM_E_STOP, 0] = self._press
        self.writers[objects.SIM_IO_E_STOP, 0] = self._open_io_contact
        self.readers[objects.SIM_IO_E_STOP, 0] = lambda: int(io is not None and io.e_stop_pressed)
        self.readers[objects.SIM_E_STOP, 0] = lambda: int(drive.e_stop_pressed)
        self.writers[objects.SIM_TOOL_UM_S, 0] = self._connect_tool
        self.readers[objects.SIM_TOOL_UM_S, 0] = lambda: round(drive.tool.speed_mm_s * 1000) if drive.tool else 0
        self.readers[objects.SIM_MOTION_STATE, 0] = lambda: int(plant.moving)
        self.readers[objects.SIM_TRUE_VERTICAL_MN, 0] = lambda: round(plant.truth.vertical_n * 1000)
        self.readers[objects.SIM_TRUE_STROKE_UM, 0] = lambda: round(plant.truth.stroke_mm * 1000)

    def _press(self, value: int) -> None:
        self._drive.press_e_stop(bool(value))
        if self._io is not None:
            self._io.press_e_stop(bool(value))

    def _connect_tool(self, speed_um_s: int) -> None:
        self._drive.take_over(ServiceTool(speed_um_s * objects.MM_S_PER_VELOCITY_UNIT) if speed_um_s else None)

    def _open_io_contact(self, value: int) -> None:
        if self._io is None:
            raise refuse(Abort.DEVICE_STATE)
        self._io.press_e_stop(bool(value))

    def _start(self, value: int) -> None:
        if value == 1 and not self._start_motion():
            raise refuse(Abort.DEVICE_STATE)
