"""What the drive is commanded in a tick: the controlword that leads to the power of the stage, preload and enable."""

from __future__ import annotations

from rigctl.config.settings import RigSettings
from rigctl.control.bus.inbox import Inbox
from rigctl.control.bus.outbox import Outbox
from rigctl.control.clock import Clock
from rigctl.control.law.tension import TensionLaw
from rigctl.control.load.stroke_hold import SHOWN_MM, StrokeHold
from rigctl.control.observer import Observer
from rigctl.control.power.machine import Machine
from rigctl.control.power.preload import Preload
from rigctl.devices.drive import Power, next_controlword
from rigctl.model.device_states import NmtState

STOPPED_MM_S = 0.05
STOP_LIMIT_NS = 2_000_000_000
START_AGAIN_NS = 300_000_000  # a node has heard heartbeats of ours by then
NOT_AGAIN_NS = 1 << 62
SAFE_FRAMES = 10  # commands of no speed in a row before the drive is switched on, and before it is switched off


class DriveCommand:
    """Call ``send`` once a tick. A drive is switched on and off between commands of no speed, and off at standstill.

    ``start_again_ns``: when `start_again` is due.
    """

    def __init__(
        self, settings: RigSettings, clock: Clock, machine: Machine, observer: Observer, outbox: Outbox,
        law: TensionLaw, stroke: StrokeHold,
    ) -> None:  # fmt: skip
        self._clock, self._machine, self._observer, self._outbox = clock, machine, observer, outbox
        self._inbox: Inbox = observer.inbox
        self._law, self._stroke, self._preload = law, stroke, Preload(settings)
        self.start_again_ns = 0
        self._off_until = 0  # the power of a drive that is to go off stays on until then, while the stroke moves

    @property
    def moves(self) -> bool:
        """The stroke moves, or is commanded to by more than the correction of a held stroke."""
        moving = abs(self._inbox.drive.speed_mm_s) >= STOPPED_MM_S
        return moving or self._law.command_mm_s != self._stroke.command_mm_s

    def send(self, t_ns: int, speed_mm_s: float) -> None:
        """The command PDO of this tick, with SYNC and heartbeat."""
        machine, snapshot, outbox = self._machine, self._observer.snapshot, self._outbox
        power = machine.power(t_ns, drive_enabled=snapshot.drive_enabled, drive_faulted=snapshot.drive_faulted)
        unsafe = outbox.safe_frames < SAFE_FRAMES
        if power is Power.OFF and snapshot.drive_enabled and self._off_waits(t_ns, unsafe=unsafe):
            power = Power.ON  # stop first, then power off: a brake must not stop a moving load
        elif power is Power.ON and not snapshot.drive_enabled and unsafe:
            power = Power.OFF
        elif power is not Power.OFF:
            self._off_until = t_ns + STOP_LIMIT_NS
        if power is Power.OFF and snapshot.power.overdue:
            power = Power.CUT  # a drive that says it is off and has not closed its brake loses its power
        word, preload_n = next_controlword(snapshot.power.state, power), self._preload.look(snapshot)
        enable = power is Power.ON or self._enable_stays()
        outbox.command(word, speed_mm_s, self._clock.now(), preload_n, enable=enable)

    def _enable_stays(self) -> bool:
        """The drive's hard-wired enable, which was set to switch it on, stays until it was off for its brake's time."""
        snapshot = self._observer.snapshot
        return self._outbox.enable.on and (snapshot.drive_may_be_on or not snapshot.power.overdue)

    def _off_waits(self, t_ns: int, *, unsafe: bool) -> bool:
        """The power stays on a little longer: the stroke still moves, or too few commands of no speed were sent."""
        held = abs(self._observer.snapshot.stroke_hold.excursion_mm) <= SHOWN_MM
        return (self.moves or unsafe) and t_ns < self._off_until and held

    def start_again(self, t_ns: int) -> None:
        """Repeat NMT start once to the nodes that are not operational, now that they have our heartbeats.

        Not to one that has booted since its configuration: it has lost it.
        """
        first, self.start_again_ns = self.start_again_ns == 0, NOT_AGAIN_NS
        if first:
            self.start_again_ns = t_ns + START_AGAIN_NS
            return
        for node, state in self._inbox.network.states.items():
            if state == NmtState.PRE_OPERATIONAL and not self._inbox.network.restarted:
                self._outbox.start(node)
