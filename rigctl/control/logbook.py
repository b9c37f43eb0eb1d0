"""Writes the loop's records, events and replies into rings, as numbers; the gateway words them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from rigctl.config.settings import RigSettings
from rigctl.control.bus.hold_sockets import Hold
from rigctl.control.bus.inbox import Inbox
from rigctl.control.bus.network_state import Notices
from rigctl.control.bus.outbox import Outbox
from rigctl.control.bus.readback import Lost
from rigctl.control.commands.situation import Situation, slot_values
from rigctl.control.excitation.trials import LoadBin
from rigctl.control.law.move_learning import News
from rigctl.control.law.run_out import stale_ns
from rigctl.control.law.tension import TensionLaw
from rigctl.control.load.homed import StrokeVerdict
from rigctl.control.observer import Observer
from rigctl.control.power.machine import Change, Machine
from rigctl.control.watch.safety import Trip
from rigctl.ipc import ring
from rigctl.ipc.hold_socket import NAME_BYTES
from rigctl.ipc.record import COMMAND, EVENT, FRAME, HOLD, RECORD, REPLY, SITUATION, Slot
from rigctl.ipc.ring import RingReader, RingWriter
from rigctl.ipc.runtime_folder import Runtime
from rigctl.model.events import Kind
from rigctl.model.samples import Quality
from rigctl.model.states import Flag, HeldBy
from rigctl.model.verbs import Refusal

NOTICE_NS = 1_000_000_000
NOTICES_KEPT = 64
_OWN_SLOTS = 1024
ZERO_C_K = 273.15
_STALE = Quality.STALE.value
_UNCONFIRMED = Flag.STROKE_UNCONFIRMED.value
_OFF, _BRAKE_FAILS, _CARRIES = Flag.DRIVE_OFF.value, Flag.BRAKE_FAILS.value, Flag.CARRIES.value
_ENABLED, _ARMING, _STOPPING = Flag.DRIVE_ENABLED.value, Flag.ARMING.value, Flag.STOPPING.value


@dataclass(frozen=True)
class Rings:
    """Rings of the loop: records, events, replies, frames and the HOLDs that it has taken out, commands in."""

    records: RingWriter
    events: RingWriter
    replies: RingWriter
    frames: RingWriter
    holds: RingWriter
    situations: RingWriter
    commands: RingReader

    @classmethod
    def of(cls, runtime: Runtime) -> Rings:
        """The loop's ends of a runtime folder's rings."""
        return cls(
            runtime.records.writer(), runtime.events.writer(), runtime.replies.writer(), runtime.frames.writer(),
            runtime.holds.writer(), runtime.situations.writer(), runtime.commands.reader(),
        )  # fmt: skip

    @classmethod
    def in_own_memory(cls) -> Rings:
        """Rings that no other process reads or writes, for a loop that is run to warm it up."""

        def out(slot: Slot) -> RingWriter:
            return RingWriter(ring.in_own_memory(slot.dtype, _OWN_SLOTS), slot.layout)

        commands = RingReader(ring.in_own_memory(COMMAND.dtype, _OWN_SLOTS), COMMAND.dtype)
        return cls(out(RECORD), out(EVENT), out(REPLY), out(FRAME), out(HOLD), out(SITUATION), commands)


class Logbook:
    """Writes a tick's record, events and replies."""

    def __init__(self, settings: RigSettings, rings: Rings) -> None:
        self._rings = rings
        self._values, self._in_order = RECORD.by_name()
        self._noticed: dict[tuple[Kind, int, int], int] = {}  # earliest time of the next one
        self._slope_stale_ns, rail = settings.safety.inclination_stale_ms * 1_000_000, settings.rail_encoder
        self._rail_stale_ns = stale_ns(rail) if rail is not None else 0
        self._failures = self._receive_failures = 0

    def record(  # noqa: PLR0915 - one line for each field of the record
        self, tick: int, t_ns: int, lateness_ns: int, work_ns: int, machine: Machine, observer: Observer,
        law: TensionLaw, outbox: Outbox, command_seq: int, causes: int, checks: int, *, arming: bool,
        stroke_known: bool, carries: bool, end_s: float, slipped_n: float, brake_fails: bool, added_mm_s: float,
        learned_mm_s: float, move: int,
    ) -> None:  # fmt: skip
        """The record of this tick.

        ``work_ns`` is of the tick before, ``command_seq`` is the last command taken.
        ``causes``: see `rigctl.control.watch.safety.Watch.standing`. ``checks``: bits of the checks that bar arming.
        ``slipped_n``, ``brake_fails``: see `rigctl.control.load.brake_flag.BrakeFlag`. ``added_mm_s``,
        ``learned_mm_s``: to the law's command, by a trial or the probe, and by a move that was learnt.
        """
        inbox, snapshot, kalman, slope = observer.inbox, observer.snapshot, observer.filter, observer.inclination
        cell, drive, tangential, normal = kalman.cell, kalman.drive, slope.tangential, slope.normal
        flags = law.limits | (_ENABLED if snapshot.drive_enabled else 0) | (_ARMING if arming else 0)
        flags |= (0 if stroke_known else _UNCONFIRMED) | (_BRAKE_FAILS if brake_fails else 0)
        flags |= (_STOPPING if machine.sequence.ends else 0) | (_OFF if observer.shown_off else 0)
        flags |= _CARRIES if carries else 0
        values = self._values
        values.t_ns = t_ns
        values.tick = tick
        values.skipped = observer.skips.total
        values.lateness_ns = lateness_ns
        values.work_ns = work_ns
        values.mode = machine.mode
        values.held_by = snapshot.held_by
        values.power_off = snapshot.power_off
        values.load_at_rest = snapshot.load_at_rest
        values.sink_mm_s = snapshot.sinking.speed_mm_s
        sinks_mm_s = -snapshot.sinking.speed_mm_s
        values.slack_s = snapshot.sinking.left_mm / sinks_mm_s if sinks_mm_s > 0.0 else math.nan
        values.end_s = end_s
        values.slipped_n = slipped_n
        values.fault = machine.fault
        values.flags = flags
        values.tension_n = inbox.cell.tension_n
        values.reading_n = inbox.cell.reading_n
        measured = inbox.cell_correction
        second = inbox.second
        values.second_n = second.tension_n
        values.force_gap_n = second.gap_n
        values.fused_n = second.offset_n
        values.creep_n = measured.creep_n
        values.crept_1_n, values.crept_2_n = measured.crept
        values.zero_drift_n = measured.zero_drift_n
        values.cell_temperature_c = measured.temperature_c
        values.tension_age_ns = snapshot.cell_age_ns
        values.tension_quality = inbox.cell.quality | (0 if snapshot.cell_heard else _STALE)
        values.tangential_rad = inbox.slope.tangential_rad
        values.normal_rad = inbox.slope.normal_rad
        values.inclination_age_ns = snapshot.inclination_age_ns
        values.inclination_quality = inbox.slope.quality | (
            _STALE if snapshot.inclination_age_ns > self._slope_stale_ns else 0
        )
        values.stroke_mm = inbox.drive.stroke_mm
        values.speed_mm_s = inbox.drive.speed_mm_s
        values.drive_age_ns = snapshot.drive_age_ns
        values.drive_quality = 0 if snapshot.drive_heard else _STALE
        values.statusword = inbox.drive.statusword
        values.controlword = outbox.controlword
        values.command_mm_s = law.command_mm_s
        values.excitation_mm_s = added_mm_s
        values.sensitivity_peak, values.sensitivity_peak_error = (
            observer.sensitivity_peak,
            observer.sensitivity_peak_error,
        )
        values.target_n = law.target_n
        values.setpoint_n = law.rope_setpoint_n
        values.vertical_n = inbox.cell.tension_n * observer.cosine
        values.estimate_n, values.estimate_mm_s, values.disturbance_mm_s = kalman.state
        values.integral_mm_s = law.integral_mm_s
        values.innovation_n = cell.innovation
        values.innovation_n2 = cell.variance
        values.tension_verdict = cell.verdict
        values.tension_nis = cell.nis
        values.speed_innovation_mm_s = drive.innovation
        values.speed_innovation_mm2_s2 = drive.variance
        values.speed_verdict = drive.verdict
        values.speed_nis = drive.nis
        (
            values.tangential_estimate_rad,
            values.tangential_rate_rad_s,
            values.normal_estimate_rad,
            values.normal_rate_rad_s,
        ) = slope.state
        values.tangential_innovation_rad = tangential.innovation
        values.tangential_innovation_rad2 = tangential.variance
        values.tangential_verdict = tangential.verdict
        values.tangential_nis = tangential.nis
        values.normal_innovation_rad = normal.innovation
        values.normal_innovation_rad2 = normal.variance
        values.normal_verdict = normal.verdict
        values.normal_nis = normal.nis
        values.stretch_mm_s = kalman.known_mm_s - observer.run_out_mm_s
        values.frames_sent = outbox.sent
        values.frames_received = inbox.received
        values.frames_lost = inbox.frames_missing()
        values.frames_refused = inbox.refused
        values.send_failures = outbox.failures
        values.error_frames = inbox.network.error_frames
        values.rail_rad = inbox.rail.rad
        values.rail_quality = inbox.rail.quality | (_STALE if snapshot.rail_age_ns > self._rail_stale_ns else 0)
        values.run_out_mm_s = observer.run_out_mm_s
        values.learned_mm_s = learned_mm_s
        values.move = move
        values.drive_current_a = snapshot.drive_status.current_a
        values.drive_temperature_c = snapshot.drive_status.temperature_c
        values.checks = checks
        values.command_seq = command_seq
        values.hold_seq = self._rings.holds.head
        values.cause_bits = causes
        self._rings.records.write(*self._in_order(values))

    def event(
        self, t_ns: int, kind: Kind, a: int = 0, b: int = 0, value: float = 0.0, limit: float = 0.0, text: bytes = b""
    ) -> None:
        """Write an event; `Kind` gives the meaning of its numbers."""
        self._rings.events.write(t_ns, kind, a, b, value, limit, text)

    def held(self, t_ns: int, before: HeldBy, after: HeldBy, left_s: float, text: bytes) -> None:
        """What carries the load has changed; once a second of each, should it come and go."""
        self.notice(t_ns, Kind.HELD, before, after, text, left_s)

    def stroke(self, t_ns: int, found: StrokeVerdict) -> None:
        """Whether the drive's position is believed, and why."""
        text = found.why.encode()[:80]
        self.event(t_ns, Kind.STROKE, int(found.believed), 0, number(found.reads_mm), found.last_mm, text)

    def notice(self, t_ns: int, kind: Kind, a: int, b: int, text: bytes = b"", value: float = 0.0) -> None:
        """Write an event, at most once a second each, so that a babbling bus does not drown the others."""
        if t_ns >= self._noticed.get((kind, a, b), 0):
            if len(self._noticed) >= NOTICES_KEPT:
                self._noticed.clear()
            self._noticed[kind, a, b] = t_ns + NOTICE_NS
            self.event(t_ns, kind, a, b, value, text=text)

    def situation(self, t_ns: int, mode: int, situation: Situation) -> None:
        """What the answers to commands depend on now, for the displays."""
        self._rings.situations.write(*slot_values(t_ns, mode, situation))

    def reply(
        self, t_ns: int, id_: int, refusal: Refusal, checks: int, mode: int, figures: Mapping[str, float]
    ) -> None:
        """Answer to the command ``id_``; ``figures``: by the names of their fields in `REPLY`."""
        finite = {name: number(value) for name, value in figures.items()}
        self._rings.replies.write(
            *REPLY.values(
                t_ns=t_ns, id=id_, accepted=refusal is Refusal.NONE, reason=refusal, checks=checks, mode=mode, **finite
            )
        )

    def hold(self, t_ns: int, id_: int, hold: Hold) -> None:
        """A HOLD from a user of this computer, as it was taken."""
        self._rings.holds.write(t_ns, id_, hold.uid, hold.pid, hold.operator.encode()[:NAME_BYTES])
        self.event(t_ns, Kind.LOCAL_HOLD, hold.uid, hold.pid, text=(hold.operator or "this user").encode()[:80])
        if hold.closed:
            self.event(t_ns, Kind.HOLD_SOCKET_CLOSED, hold.uid, hold.pid)

    def load_bin(self, t_ns: int, part: LoadBin) -> None:
        """A part of a record of the cell's creep."""
        millikelvin = round(1e3 * (part.cell_c + ZERO_C_K)) if math.isfinite(part.cell_c) else 0
        text = f"{part.rms_n:.5f}".encode()
        self.event(t_ns, Kind.LOAD_STEP, part.samples, max(0, millikelvin), part.mean_n, part.after_s, text)

    def trip(self, t_ns: int, kind: Kind, trip: Trip) -> None:
        """A trip of a row of the safety table, with value, limit and action."""
        self.event(t_ns, kind, trip.fault, trip.action, trip.value, trip.limit, trip.text.encode()[:80])

    def moves(self, t_ns: int, news: list[News]) -> None:
        """What was learnt from a move, or why nothing was; empties ``news``."""
        for told in news:
            kind = Kind.LEARNT if not told.ended else Kind.NOT_LEARNT
            self.event(t_ns, kind, told.number, told.taught, told.rms_n, number(told.first_n), told.ended.encode()[:80])
        news.clear()

    def mode_changes(self, t_ns: int, changes: Sequence[Change], safe_frames: int) -> None:
        """Every change of mode, with the event behind it and the commands of no speed sent in a row before it."""
        for change in changes:
            self.event(t_ns, Kind.MODE, change.before, change.after, float(change.event), float(safe_frames))

    def bus_notices(self, t_ns: int, notices: Notices | None, lost: Lost | None, inbox: Inbox, outbox: Outbox) -> None:
        """Events from the devices, the bus and the read-back of this tick."""
        if notices is not None:
            for node, code, manufacturer in notices.emergencies:
                self.notice(t_ns, Kind.EMERGENCY, node, code, manufacturer)
            for node, where, words in notices.foreign_sdo:
                self.notice(t_ns, Kind.FOREIGN_SDO, node, where, words.encode()[:80])
        if lost is not None:
            item, found = lost.item, math.nan if lost.found is None else float(lost.found)
            where = item.index << 8 | item.sub
            self.event(t_ns, Kind.SETTING_LOST, item.node, where, found, float(item.wanted), lost.words.encode()[:80])
        if notices is not None:
            for node, state in notices.node_states:
                self.notice(t_ns, Kind.NODE_STATE, node, state)
            for class_, details in notices.bus_errors:
                self.notice(t_ns, Kind.BUS_ERROR, class_, details)
        if outbox.failures != self._failures:
            self._failures = outbox.failures
            self.notice(t_ns, Kind.SEND_FAILED, 0, 0, outbox.failure_text.encode()[:80])
        if inbox.receive_failures != self._receive_failures:
            self._receive_failures = inbox.receive_failures
            self.notice(t_ns, Kind.RECEIVE_FAILED, 0, 0, inbox.failure_text.encode()[:80])


def number(value: float) -> float:
    """A value for a slot: 0 where it is not finite."""
    return value if math.isfinite(value) else 0.0
