"""The test bench's own handle on the simulated rig, as a CANopen node: start the move, see the truth."""

from __future__ import annotations

import pathlib
from collections.abc import Callable

from hil.nodes.cylinder_drive import CylinderDrive
from hil.nodes.dictionary import Abort, refuse
from hil.nodes.network import RigNetwork
from hil.nodes.node import Node
from hil.plant import Plant
from rigctl.devices import objects

SERIAL = 112001


class Simulator(Node):
    """Objects 0x2000 (start), 0x2001 (moving), 0x2002 (E-stop), 0x2100 (true vertical tension), 0x2101 (true stroke).

    Args:
        start_motion: starts the move; False when it cannot (one is under way, or there is none to start).
        drive: whose emergency stop is pressed and released.
    """

    def __init__(
        self,
        network: RigNetwork,
        eds: pathlib.Path,
        plant: Plant,
        start_motion: Callable[[], bool],
        drive: CylinderDrive,
    ) -> None:
        super().__init__(network, objects.SIMULATOR_NODE, eds, plant, SERIAL)
        self._start_motion = start_motion
        self.writers[objects.SIM_MOTION_START, 0] = self._start
        self.readers[objects.SIM_MOTION_START, 0] = lambda: 0
        self.writers[objects.SIM_E_STOP, 0] = lambda value: drive.press_e_stop(bool(value))
        self.readers[objects.SIM_E_STOP, 0] = lambda: int(drive.e_stop_pressed)
        self.readers[objects.SIM_MOTION_STATE, 0] = lambda: int(plant.moving)
        self.readers[objects.SIM_TRUE_VERTICAL_MN, 0] = lambda: round(plant.truth.vertical_n * 1000)
        self.readers[objects.SIM_TRUE_STROKE_UM, 0] = lambda: round(plant.truth.stroke_mm * 1000)

    def _start(self, value: int) -> None:
        if value == 1 and not self._start_motion():
            raise refuse(Abort.DEVICE_STATE)
