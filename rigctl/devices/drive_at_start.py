"""The drive as a start finds it: its state is read first, and a drive that is powered is stopped and taken off power.

A controller that has crashed may have left the drive enabled, and moving. Nothing that a start does to a node may come
before: NMT commands and a new configuration would reach a motor that carries the load. (CiA 402 device control by SDO.)
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NoReturn

from rigctl.devices import objects as od
from rigctl.devices.drive import LeftInDrive
from rigctl.devices.objects import Controlword, drive_state
from rigctl.devices.remote_node import RemoteNode, SilentError, StartupError
from rigctl.devices.startup_bus import StartupBus
from rigctl.model.device_states import STATUSWORD, DriveState, NmtState

POWERED = frozenset({DriveState.SWITCHED_ON, DriveState.OPERATION_ENABLED, DriveState.QUICK_STOP_ACTIVE})
"""States in which the motor may have torque."""
POLL_S = 0.02
STOP_MOST_S = 5.0
"""Of a ramp that the drive does not state."""
MARGIN_S = 0.5
"""Beyond ramp and brake: the drive's own cycle, jerk and answers."""


class DriveAtStart:
    """The drive, by SDO, before it is configured. ``found``: what a former controller had left."""

    def __init__(self, bus: StartupBus, drive: RemoteNode, brake_s: float, say: Callable[[str], None]) -> None:
        """``brake_s``: time that its brake takes to close. ``say``: called with one line for what was found."""
        self._bus, self._drive, self._brake_s, self._say = bus, drive, brake_s, say
        self.found: list[LeftInDrive] = []

    def state(self) -> DriveState:
        """0x6041 now."""
        return drive_state(self._drive.read(STATUSWORD))

    def known_state(self, until_ns: int) -> DriveState:
        """The drive's state; one that is silent is waited for until ``until_ns``.

        A node in NMT STOPPED takes no SDO: one that reports it or stays silent is sent PRE-OPERATIONAL and read again.

        Raises:
            StartupError: the state stays unknown; the drive was sent NMT stop.
        """
        try:
            self._drive.await_answer(
                STATUSWORD, until_ns, self._say, ends=lambda: self._drive.reported is NmtState.STOPPED
            )
            return self.state()
        except SilentError:
            self._drive.remote.nmt.state = "PRE-OPERATIONAL"
        try:
            return self.state()
        except SilentError as silent:
            self._stop()
            raise StartupError(f"{silent} The state of the drive is unknown, so it was sent NMT stop") from None

    def take_off_power(self, found: DriveState) -> None:
        """Stop a drive that is powered on its own ramp, then disable its voltage; a fault reaction ends by itself.

        Raises:
            StartupError: it stays powered; it was sent NMT stop, and no heartbeat is sent that would keep it enabled.
        """
        if found is DriveState.FAULT_REACTION_ACTIVE:
            self._wait(lambda state: state is not DriveState.FAULT_REACTION_ACTIVE, self._ramp_s())
            found = self.state()
        if found not in POWERED:
            return
        words = found.name.replace("_", " ")
        self._say(f"{self._drive.name} found in {words}: it is stopped and taken off power before anything else")
        try:
            self._drive.enforce("quick stop option", od.QUICK_STOP_RAMP_THEN_OFF, od.QUICK_STOP_OPTION, 0)
            ramp_s = self._ramp_s()
            self._drive.write(Controlword.QUICK_STOP, od.CONTROLWORD, verify=False)
            self._wait(lambda state: state not in POWERED, ramp_s)
            self._drive.write(Controlword.DISABLE_VOLTAGE, od.CONTROLWORD, verify=False)
            left = self._wait(lambda state: state not in POWERED, 0.0)
        except StartupError as error:
            self._give_up(str(error))
        if left in POWERED:
            self._give_up(f"{self._drive.name} stays in {left.name.replace('_', ' ')} after disable voltage")
        self.found.append(LeftInDrive(STATUSWORD, found, left))

    def clear_targets(self) -> None:
        """Set target velocity and velocity offset to 0, which a former controller may have left.

        A drive that keeps another offset can be inspected; it cannot be armed (`rigctl.devices.startup`).
        """
        for index in (od.TARGET_VELOCITY, od.VELOCITY_OFFSET):
            if self._drive.has(index) and (value := self._drive.read(index)):
                self._drive.write(0, index, verify=False)
                left = self._drive.read(index)
                self.found.append(LeftInDrive(index, value, left))
                kept = f", and it keeps {left}" if left else ""
                self._say(f"{self._drive.where(index, 0)}: found {value} of a former controller, set to 0{kept}")

    def _ramp_s(self) -> float:
        """How long its quick stop ramp (0x6085) takes from its speed (0x606C), both in the drive's own units."""
        drive = self._drive
        if not (drive.has(od.QUICK_STOP_DECELERATION) and drive.has(od.VELOCITY_ACTUAL)):
            return STOP_MOST_S
        ramp = drive.read(od.QUICK_STOP_DECELERATION)
        return min(abs(drive.read(od.VELOCITY_ACTUAL)) / ramp, STOP_MOST_S) if ramp > 0 else STOP_MOST_S

    def _wait(self, done: Callable[[DriveState], bool], ramp_s: float) -> DriveState:
        """Read the state until ``done``, at most for ramp, brake and margin; the last state read."""
        until_ns = self._bus.until_ns(ramp_s + self._brake_s + MARGIN_S)
        while not done(state := self.state()) and self._bus.now_ns() < until_ns:
            self._bus.hear(lambda: False, self._bus.until_ns(POLL_S))
        return state

    def _stop(self) -> None:
        """NMT stop, twice, since a frame may be lost and the drive takes no SDO afterwards that would show it."""
        for _ in range(2):
            self._drive.remote.nmt.state = "STOPPED"

    def _give_up(self, why: str) -> NoReturn:
        self._stop()
        raise StartupError(f"{why}: it was sent NMT stop and gets no heartbeat: use the emergency stop") from None
