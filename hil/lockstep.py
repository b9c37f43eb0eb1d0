"""The real loop and the simulated rig in one process under a simulated clock: same loop, same frames, no waiting."""

from __future__ import annotations

import contextlib
from collections import deque
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

from hil.bus import InProcessBus
from hil.hub import Hub
from hil.loop_view import LoopView
from hil.operated_rig import CommandRefusedError
from hil.rig import SimulatedRig
from rigctl.config.settings import RigSettings
from rigctl.control.bus.hold_sockets import GivenHolds, Hold
from rigctl.control.clock import SimulatedClock
from rigctl.control.law.tension import Gains
from rigctl.control.load.brake_flag import KeptBrake
from rigctl.control.load.homed import LastStroke
from rigctl.control.load.last_stroke import brake_of
from rigctl.control.logbook import Rings
from rigctl.control.loop import LawFactory, Loop
from rigctl.control.modes import command_slot
from rigctl.devices import startup
from rigctl.ipc.correction import Correction
from rigctl.ipc.memory_folder import memory_folder
from rigctl.ipc.record import HOLD_ID
from rigctl.ipc.runtime_folder import Runtime
from rigctl.model.states import Mode
from rigctl.model.verbs import Refusal, Setting, Verb

START_NS = 1_000_000_000
STARTING_NS = 500_000_000  # devices that answer at once are up by START_NS
PASSING_NS = 1_000_000  # step of the rig's time while start-up waits for an answer
WORK_NS = 100_000  # frames of a tick reach the rig this long after its grid point, as on the bus

HISTORY_S, UNREAD_S = 4, 16
"""Time that the rings of records and frames hold, and that unread records are kept."""
_NOTES = 128  # no gateway writes them here; HOLDs are few
LIMIT_S = 3.0
ARM_LIMIT_S = 25.0  # slow devices take up to 15 s to send their settings; stop and brake test follow


class SkippingClock(SimulatedClock):
    """A simulated clock that can make the next tick late.

    ``skip`` grid points are missed, and the tick after them wakes ``late_ns`` after its own; then both are 0 again.
    """

    skip = late_ns = 0

    def __init__(
        self, period_ns: int, advance: Callable[[int], None], start_ns: int, pass_to: Callable[[int], None]
    ) -> None:
        """``advance`` ends a period of the world, ``pass_to`` lets time pass within one."""
        super().__init__(period_ns, advance, start_ns)
        self._pass_to, self._woke_ns = pass_to, start_ns

    def next_tick(self) -> tuple[int, int]:
        """Advance the world to the next grid point that is not missed, and on by the tick's lateness."""
        missed, late_ns, self.skip, self.late_ns = self.skip, self.late_ns, 0, 0
        for _ in range(missed):
            super().next_tick()
        point_ns, _ = super().next_tick()
        self._woke_ns = point_ns + late_ns
        if late_ns:
            self._pass_to(self._woke_ns)
        return point_ns, missed

    def now(self) -> int:
        """When the last tick woke."""
        return self._woke_ns


class Lockstep:
    """The loop and the rig, one tick at a time. `lockstep()` builds it and removes its rings afterwards."""

    def __init__(
        self,
        settings: RigSettings,
        gains: Gains,
        runtime: Runtime,
        *,
        log: bool = False,
        law: LawFactory | None = None,
        correction: Correction | None = None,
        last_stroke: LastStroke = LastStroke(),  # noqa: B008 - frozen
        kept_brake: KeptBrake = KeptBrake(),  # noqa: B008 - frozen
        host_checks: int = 0,
        built: RigSettings | None = None,
        history_s: int = HISTORY_S,
    ) -> None:
        """``log`` keeps every frame, with its time, in ``frames``. For the other arguments see `Loop`.

        ``built``: the rig file that the simulated rig is built by, where the loop believes in another plant.
        ``history_s``: time that the rings of records and frames hold, for who reads them more seldom.

        Raises:
            RoomError: the memory of the rings is not free.
        """
        runtime.make_rings(settings, history_s=history_s, notes=_NOTES)
        self.settings, self.runtime = settings, runtime
        self.rig_ns = START_NS - STARTING_NS
        self.hub = Hub(lambda: self.rig_ns)
        port = self.hub.attach(self._to_rig)
        self.rig: SimulatedRig = SimulatedRig(built or settings, self.rig_ns, port.send)
        self._stranger = self.hub.speaker()
        self._keep_log = log
        self.frames: list[tuple[int, bytes]] = self.hub.log
        self.bus = bus = InProcessBus(self.hub, pass_time=self._pass_time)
        try:
            self.report = self._bring_up()
        except startup.StartupError:
            bus.shutdown()
            raise
        self._pass_time(lambda: False, (START_NS - self.rig_ns) * 1e-9)
        self.clock = self._clock_of_now()
        self._records = runtime.records.reader()
        self._read_from = settings.loop.rate_hz * history_s // 2  # records that wait
        self._waiting = 0  # ticks since the records were last read
        self._unread: deque[npt.NDArray[Any]] = deque(maxlen=max(1, 2 * UNREAD_S // history_s))
        self._replies = runtime.replies.reader()
        self._commands = runtime.commands.writer()
        self.holds = GivenHolds()
        self.events = runtime.events.reader()

        def make_loop(last: LastStroke, brake: KeptBrake) -> Loop:
            return Loop(
                settings,
                gains,
                bus,
                self.clock,
                Rings.of(runtime),
                supervised=self.report.supervised,
                law=law,
                correction=correction,
                process_data=self.report.process_data,
                watched=self.report.watched,
                found=self.report.found,
                last_stroke=last,
                kept_brake=brake,
                host_checks=host_checks,
                holds=self.holds,
            )

        self._make_loop = make_loop
        self.loop = self._make_loop(last_stroke, kept_brake)
        self.view = LoopView(self.loop)
        """What no record shows."""
        self._id = 0
        self.on_advance: Callable[[], None] | None = None
        """Called after every period of the rig, whether the loop ticks then or misses it."""
        self.reply: Any = None  # to the last command

    @property
    def record(self) -> Any:
        """The newest record, by the names of `rigctl.model.signals`; None before the first tick."""
        return self._records.latest()

    def tick(self) -> None:
        """One tick of the loop; one that ended in order to start anew is followed by the next, as by the supervisor."""
        self.loop.tick()
        self._waiting += 1
        if self._waiting >= self._read_from:
            self._waiting = 0
            self._unread.append(self._records.read())
        if self.view.starts_anew:
            self.start_anew()

    def start_anew(self) -> None:
        """Bring the devices up and make a new loop on the same rig, as the supervisor does with the control process."""
        last, record = LastStroke(self.loop.inbox.drive.stroke_mm), self._records.latest()
        brake = KeptBrake() if record is None else brake_of(record)
        self.report = self._bring_up()
        self.clock = self._clock_of_now()
        self.loop = self._make_loop(last, brake)
        self.view = LoopView(self.loop)

    def _bring_up(self) -> startup.StartupReport:
        return startup.bring_up(self.bus, self.settings, lambda: self.rig_ns)

    def _to_rig(self, frame: bytes) -> None:
        self.rig.receive(frame)

    def _clock_of_now(self) -> SkippingClock:
        """The loop's clock, whose next grid point is the first ahead of the rig's time."""
        period_ns = self.settings.loop.period_ns
        return SkippingClock(period_ns, self._advance, self.rig_ns - self.rig_ns % period_ns, self._pass_to)

    def _pass_time(self, arrived: Callable[[], bool], seconds: float) -> None:
        """Advance the rig while start-up waits for a frame."""
        end_ns = self.rig_ns + round(seconds * 1e9)
        while self.rig_ns < end_ns and not arrived():
            self.rig_ns = min(self.rig_ns + PASSING_NS, end_ns)
            self.rig.advance(self.rig_ns)
            self.rig.supervise(self.rig_ns)

    def _pass_to(self, t_ns: int) -> None:
        self.rig_ns = t_ns + WORK_NS
        self.rig.advance(self.rig_ns)
        self.rig.supervise(self.rig_ns)

    def _advance(self, t_ns: int) -> None:
        self._pass_to(t_ns)
        if not self._keep_log:
            self.hub.log.clear()
        if self.on_advance is not None:
            self.on_advance()

    def close(self) -> None:
        """Leave the bus."""
        self.bus.shutdown()

    def run(self, seconds: float) -> npt.NDArray[Any]:
        """Run for ``seconds`` of simulated time; returns the records of that time."""
        self.read_records()
        slots = []
        for i in range(round(seconds * self.settings.loop.rate_hz)):
            self.tick()
            if i % 1000 == 999:
                slots.append(self.read_records())
        return np.concatenate([*slots, self.read_records()])

    def read_records(self) -> npt.NDArray[Any]:
        """Records written since they were last read, of the last ``UNREAD_S``."""
        records = np.concatenate([*self._unread, self._records.read()])
        self._unread.clear()
        self._waiting = 0
        return records

    def inject(self, frame: bytes) -> None:
        """Put a frame on the bus as a foreign node would."""
        self._stranger.send(frame)

    def give(self, verb: Verb | Setting, *values: float, age_ns: int = 0) -> int:
        """Put a command on the ring for the next tick, without waiting for the reply; returns its id.

        ``values``: in the order of `rigctl.model.verbs.VALUES`; 0 by default.
        """
        self._id += 1
        self._commands.write(*command_slot(self.clock.now() - age_ns, self._id, verb, *(values or (0.0,))))
        return self._id

    def command(self, verb: Verb | Setting, *values: float, limit_s: float | None = None, age_ns: int = 0) -> Refusal:
        """Give a command, stamped ``age_ns`` ago, through the command ring and run until the loop replies.

        ``limit_s``: longest wait for the reply; by default ``ARM_LIMIT_S`` for ARM, else ``LIMIT_S``.
        """
        if limit_s is None:
            limit_s = ARM_LIMIT_S if verb is Verb.ARM else LIMIT_S
        return self.answer(self.give(verb, *values, age_ns=age_ns), limit_s, repr(verb))

    def do(self, verb: Verb | Setting, *values: float) -> None:
        """Give a command that has to be accepted.

        Raises:
            CommandRefusedError: it was refused.
        """
        if (refusal := self.command(verb, *values)) is not Refusal.NONE:
            raise CommandRefusedError(f"{verb.name} was refused: {refusal.name}")

    def answer(self, id_: int, limit_s: float = LIMIT_S, what: str = "a command") -> Refusal:
        """Run until the loop replies to the command ``id_``, or find the reply that has come."""
        return self._answer(what, id_.__eq__, limit_s)

    def hold(self, *, limit_s: float = 3.0) -> Refusal:
        """Give HOLD as a user of the rig's computer and run until the loop replies."""
        self.holds.append(Hold(0, 0, "test"))
        return self._answer("HOLD", HOLD_ID.__and__, limit_s)

    def _answer(self, what: str, is_its_id: Callable[[int], object], limit_s: float) -> Refusal:
        for _ in range(round(limit_s * self.settings.loop.rate_hz)):
            self.tick()
            if self._find_reply(is_its_id):
                return Refusal(int(self.reply["reason"]))
        raise TimeoutError(f"{what} was not answered within {limit_s} s")

    def reply_to(self, id_: int) -> Any:
        """The reply to the command ``id_``, if it has come since replies were last read; else None."""
        return self.reply if self._find_reply(id_.__eq__) else None

    def _find_reply(self, is_its_id: Callable[[int], object]) -> bool:
        for reply in self._replies.read():
            if is_its_id(int(reply["id"])):
                self.reply = reply
                return True
        return False

    def run_until(self, mode: Mode, limit_s: float) -> None:
        """Run until the loop is in ``mode``.

        Raises:
            TimeoutError: the loop did not reach the mode.
        """
        for _ in range(round(limit_s * self.settings.loop.rate_hz)):
            if self.loop.machine.mode is mode:
                return
            self.tick()
        raise TimeoutError(f"not in {mode.name} within {limit_s} s, but in {self.loop.machine.mode.name}")


@contextlib.contextmanager
def lockstep(
    settings: RigSettings,
    gains: Gains,
    *,
    log: bool = False,
    law: LawFactory | None = None,
    correction: Correction | None = None,
    last_stroke: LastStroke = LastStroke(),  # noqa: B008 - frozen
    kept_brake: KeptBrake = KeptBrake(),  # noqa: B008 - frozen
    host_checks: int = 0,
    built: RigSettings | None = None,
    history_s: int = HISTORY_S,
) -> Iterator[Lockstep]:
    """A `Lockstep` whose rings are removed afterwards.

    Raises:
        RoomError: the memory of its rings is not free.
    """
    with memory_folder("rigctl-lockstep-") as folder:
        subject = Lockstep(
            settings, gains, Runtime(folder), log=log, law=law, correction=correction, last_stroke=last_stroke,
            kept_brake=kept_brake, host_checks=host_checks, built=built, history_s=history_s,
        )  # fmt: skip
        try:
            yield subject
        finally:
            subject.close()
