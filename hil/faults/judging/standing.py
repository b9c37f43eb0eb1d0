"""One fault of the catalogue that is put into a running rig, and taken out again."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from hil.faults.catalogue import BY_ID
from hil.faults.expected import InjectedFault
from hil.faults.stand import FaultyRig, Needs, NoDeviceError, Stand


class FaultRefusedError(ValueError):
    """The fault cannot be put into this rig; ``str()`` is one line."""


def found(name: str) -> InjectedFault:
    """The fault of this id.

    Raises:
        FaultRefusedError: there is none.
    """
    if name not in BY_ID:
        raise FaultRefusedError(f"found {name!r}, expected a fault of the catalogue (python -m hil inject --list)")
    return BY_ID[name]


def hindrance(fault: InjectedFault, *, served: bool) -> str:
    """Why a fault cannot be put into a rig that runs already; empty if it can."""
    if served and fault.needs is Needs.LOOP:
        return "it is a fault of the loop, which is another process: kill or stop that, or use lockstep"
    if fault.needs is Needs.START:
        return "it is a state of the rig from its start, not an event: python -m hil faults plays it"
    return ""


class StandingFault:
    """A fault from its injection to its end.

    At the end the wire, the devices' readings, the drive's behaviour and the mechanics' parameters are as they were.
    What has happened meanwhile stays: a device that rebooted, a setting that was overwritten, a payload that moved.

    Args:
        rig: the running rig.
        fault: of the catalogue.
        now_ns: the rig's time.
        for_s: length; None until `end`.

    Raises:
        FaultRefusedError: the rig lacks the device.
    """

    def __init__(self, rig: FaultyRig, fault: InjectedFault, now_ns: int, for_s: float | None = None) -> None:
        self.id = fault.id
        self._since_ns = now_ns
        self._until_ns = None if for_s is None else now_ns + round(for_s * 1e9)
        self._undo: list[Callable[[], None]] | None = restoring(rig)
        if fault.around.motion is not None:
            rig.rig.plant.start_motion(fault.around.motion(), rig.rig.plant.t_ns)
        try:
            self._step = fault.inject(Stand(rig, f"inject:{fault.id}"))
        except (NoDeviceError, KeyError) as error:
            self.end()
            why = str(error) if isinstance(error, NoDeviceError) else "this rig's device has no such object"
            raise FaultRefusedError(f"{fault.id}: {why}") from None

    def step(self, now_ns: int) -> bool:
        """Go on to ``now_ns``, once a tick; False when the fault has ended."""
        if self._undo is None:
            return False
        if self._until_ns is not None and now_ns >= self._until_ns:
            self.end()
            return False
        if self._step is not None:
            self._step((now_ns - self._since_ns) * 1e-9)
        return True

    def end(self) -> None:
        """Take the fault out; again changes nothing."""
        undo, self._undo = self._undo, None
        for action in undo or ():
            action()


def restoring(rig: FaultyRig) -> list[Callable[[], None]]:
    """What puts back everything that injectors of the catalogue change."""
    simulated, undo = rig.rig, list[Callable[[], None]]()

    def put_back(owner: Any, name: str) -> None:
        value = getattr(owner, name)
        undo.append(lambda: setattr(owner, name, value))

    if rig.hub is not None:
        put_back(rig.hub, "tap")
    put_back(simulated.drive, "defect")
    put_back(simulated.drive, "rpdo_defect")
    put_back(simulated.drive, "hung")
    put_back(simulated.drive, "torque_defect")
    put_back(simulated.drive.control, "persists")
    put_back(simulated.drive.control, "refuses")
    if simulated.second_force is not None:
        put_back(simulated.second_force, "fault_n")
    parameters = np.array(simulated.plant.parameters)
    undo.append(simulated.drive.brake.restore)
    undo.append(lambda: simulated.plant.parameters.__setitem__(slice(None), parameters))
    if simulated.drive.tool is None:
        undo.append(lambda: simulated.drive.take_over(None))
    if simulated.io is not None:
        io, pressed = simulated.io, simulated.io.e_stop_pressed
        put_back(io, "welded")
        put_back(io, "without_power")
        undo.append(lambda: io.press_e_stop(pressed))
    undo.extend(node.putting_back() for node in simulated.nodes)
    return undo
