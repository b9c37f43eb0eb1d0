"""Writes the loop's records, events and replies into rings, as numbers; the gateway words them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from rigctl.config.settings import RigSettings
from rigctl.control.events import Kind
from rigctl.control.homed import StrokeVerdict
from rigctl.control.inbox import Inbox
from rigctl.control.machine import Machine
from rigctl.control.modes import Refusal
from rigctl.control.observer import Observer
from rigctl.control.outbox import Outbox
from rigctl.control.readback import Readback
from rigctl.control.safety import Trip
from rigctl.control.tension import TensionLaw
from rigctl.ipc.record import REPLY, Flag, Quality
from rigctl.ipc.ring import RingReader, RingWriter
from rigctl.ipc.runtime_folder import Runtime

NOTICE_NS = 1_000_000_000
NOTICES_KEPT = 64
_STALE = Quality.STALE.value
_UNCONFIRMED = Flag.STROKE_UNCONFIRMED.value
_ENABLED, _ARMING, _STOPPING = Flag.DRIVE_ENABLED.value, Flag.ARMING.value, Flag.STOPPING.value


@dataclass(frozen=True)
class Rings:
    """Rings of the loop: records, events, replies and frames out, commands and holds in."""

    records: RingWriter
    events: RingWriter
    replies: RingWriter
    frames: RingWriter
    commands: RingReader
    holds: RingReader

    @classmethod
    def of(cls, runtime: Runtime) -> Rings:
        """The loop's ends of a runtime folder's rings."""
        return cls(
            runtime.records.writer(), runtime.events.writer(), runtime.replies.writer(), runtime.frames.writer(),
            runtime.commands.reader(), runtime.holds.reader(),
        )  # fmt: skip


class Logbook:
    """Writes a tick's record, events and replies."""

    def __init__(self, settings: RigSettings, rings: Rings) -> None:
        self._rings = rings
        self._noticed: dict[tuple[Kind, int, int], int] = {}  # earliest time of the next one
        self._stale_ns = settings.safety.stale_ms * 1_000_000
        self._slope_stale_ns = settings.safety.inclination_stale_ms * 1_000_000
        self._failures = self._receive_failures = 0
        self.tick = 0

    def record(
        self, t_ns: int, lateness_ns: int, work_ns: int, machine: Machine, observer: Observer, law: TensionLaw,
        outbox: Outbox, command_seq: int, hold_seq: int, causes: int, *, arming: bool, stroke_known: bool,
    ) -> None:  # fmt: skip
        """The record of this tick.

        ``work_ns`` is of the tick before, ``command_seq`` and ``hold_seq`` are the last command and hold taken.
        ``causes``: see `rigctl.control.safety.Watch.standing`.
        """
        inbox, snapshot, kalman, slope = observer.inbox, observer.snapshot, observer.filter, observer.inclination
        x = kalman.state
        flags = law.limits | (_ENABLED if snapshot.drive_enabled else 0) | (_ARMING if arming else 0)
        flags |= 0 if stroke_known else _UNCONFIRMED
        flags |= _STOPPING if machine.stopping else 0
        self._rings.records.write(
            t_ns,
            self.tick,
            observer.skipped,
            lateness_ns,
            work_ns,
            machine.mode,
            machine.fault,
            flags,
            inbox.tension_n,
            inbox.reading_n,
            snapshot.cell_age_ns,
            inbox.cell_quality | (_STALE if snapshot.cell_age_ns > self._stale_ns else 0),
            inbox.tangential_rad,
            inbox.normal_rad,
            snapshot.inclination_age_ns,
            inbox.slope_quality | (_STALE if snapshot.inclination_age_ns > self._slope_stale_ns else 0),
            inbox.stroke_mm,
            inbox.speed_mm_s,
            snapshot.drive_age_ns,
            _STALE if snapshot.drive_age_ns > self._stale_ns else 0,
            inbox.statusword,
            outbox.controlword,
            law.command_mm_s,
            law.target_n,
            law.rope_setpoint_n,
            inbox.tension_n * observer.cosine,
            x[0],
            x[1],
            x[2],
            law.integral_mm_s,
            kalman.cell.innovation,
            kalman.cell.variance,
            kalman.cell.verdict,
            kalman.cell.nis,
            kalman.drive.innovation,
            kalman.drive.variance,
            kalman.drive.verdict,
            kalman.drive.nis,
            *slope.state,
            slope.tangential.innovation,
            slope.tangential.variance,
            slope.tangential.verdict,
            slope.tangential.nis,
            slope.normal.innovation,
            slope.normal.variance,
            slope.normal.verdict,
            slope.normal.nis,
            kalman.known_mm_s - observer.run_out_mm_s,
            outbox.sent,
            inbox.received,
            inbox.frames_missing(),
            inbox.refused,
            outbox.failures,
            inbox.error_frames,
            inbox.rail_rad,
            inbox.rail_quality | (_STALE if observer.rail_age_ns > observer.rail_stale_ns else 0),
            observer.run_out_mm_s,
            snapshot.drive_current_a,
            snapshot.drive_temperature_c,
            snapshot.failed_checks,
            command_seq,
            hold_seq,
            causes,
        )

    def event(
        self, t_ns: int, kind: Kind, a: int = 0, b: int = 0, value: float = 0.0, limit: float = 0.0, text: bytes = b""
    ) -> None:
        """Write an event; `Kind` gives the meaning of its numbers."""
        self._rings.events.write(t_ns, kind, a, b, value, limit, text)

    def stroke(self, t_ns: int, found: StrokeVerdict) -> None:
        """Whether the drive's position is believed, and why."""
        text = found.why.encode()[:80]
        self.event(t_ns, Kind.STROKE, int(found.believed), 0, number(found.reads_mm), found.last_mm, text)

    def notice(self, t_ns: int, kind: Kind, a: int, b: int, text: bytes = b"") -> None:
        """Write an event, at most once a second each, so that a babbling bus does not drown the others."""
        if t_ns >= self._noticed.get((kind, a, b), 0):
            if len(self._noticed) >= NOTICES_KEPT:
                self._noticed.clear()
            self._noticed[kind, a, b] = t_ns + NOTICE_NS
            self.event(t_ns, kind, a, b, text=text)

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

    def trip(self, t_ns: int, kind: Kind, trip: Trip) -> None:
        """A trip of a row of the safety table, with value, limit and action."""
        self.event(t_ns, kind, trip.fault, trip.action, trip.value, trip.limit, trip.text.encode()[:80])

    def mode_changes(self, t_ns: int, machine: Machine, safe_frames: int) -> None:
        """Every change of mode, with the event behind it and the commands of no speed sent in a row before it."""
        if machine.changes:
            for change in machine.changes:
                self.event(t_ns, Kind.MODE, change.before, change.after, float(change.event), float(safe_frames))
            machine.changes.clear()

    def bus_notices(self, t_ns: int, inbox: Inbox, outbox: Outbox, readback: Readback) -> None:
        """Events from the devices, the bus and the read-back since the last tick."""
        if inbox.emergencies:
            for node, code, manufacturer in inbox.emergencies:
                self.notice(t_ns, Kind.EMERGENCY, node, code, manufacturer)
            inbox.emergencies.clear()
        if inbox.foreign_sdo:
            for node, where, words in inbox.foreign_sdo:
                self.notice(t_ns, Kind.FOREIGN_SDO, node, where, words.encode()[:80])
            inbox.foreign_sdo.clear()
        if (lost := readback.newest) is not None:
            readback.newest = None
            item, found = lost.item, math.nan if lost.found is None else float(lost.found)
            where = item.index << 8 | item.sub
            self.event(t_ns, Kind.SETTING_LOST, item.node, where, found, float(item.wanted), lost.words.encode()[:80])
        for kind, notices in (
            (Kind.NODE_STATE, inbox.node_states),
            (Kind.BUS_ERROR, inbox.bus_errors),
        ):
            if notices:
                for a, b in notices:
                    self.notice(t_ns, kind, a, b)
                notices.clear()
        if outbox.failures != self._failures:
            self._failures = outbox.failures
            self.notice(t_ns, Kind.SEND_FAILED, 0, 0, outbox.failure_text.encode()[:80])
        if inbox.receive_failures != self._receive_failures:
            self._receive_failures = inbox.receive_failures
            self.notice(t_ns, Kind.RECEIVE_FAILED, 0, 0, inbox.failure_text.encode()[:80])


def number(value: float) -> float:
    """A value for a slot: 0 where it is not finite."""
    return value if math.isfinite(value) else 0.0
