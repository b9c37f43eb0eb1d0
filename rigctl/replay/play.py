"""Runs the loop over a recording: one span for every control process that the recording holds from its start."""

from __future__ import annotations

import pathlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np
from pydantic import ValidationError

from rigctl import __version__
from rigctl.config.settings import RigSettings
from rigctl.config.strict_yaml import Document
from rigctl.config.wording import Wording
from rigctl.control.bus.cell_correction import CellHistory
from rigctl.control.bus.hold_sockets import GivenHolds
from rigctl.control.law.tension import Gains
from rigctl.control.load.brake_flag import KeptBrake
from rigctl.control.load.homed import LastStroke
from rigctl.control.logbook import Rings
from rigctl.control.loop import Loop
from rigctl.devices.process_data import ProcessData
from rigctl.devices.sdo import Watched
from rigctl.ipc.correction import Correction
from rigctl.ipc.ledger import IN_FORCE, Standing
from rigctl.ipc.memory_folder import memory_folder
from rigctl.ipc.runtime_folder import ACTIVE, Runtime
from rigctl.model.checks import Check
from rigctl.model.events import Kind
from rigctl.recorder.recording import SLOTS, Recording
from rigctl.replay.feed import BATCH_TICKS, RecordedBus, RecordedClock, Slots, Tick, ticks


class ReplayError(ValueError):
    """The recording cannot be replayed; ``str()`` is one line."""


@dataclass(frozen=True)
class ProcessSpan:
    """One control process: its records without a gap, and its inputs at the start."""

    records: Slots
    started_ns: int
    taken: tuple[int, int]  # numbers of the last slots of commands and holds before it
    settings: RigSettings
    gains: Gains
    correction: Correction
    supervised: bool
    watched: tuple[Watched, ...]
    last_stroke: LastStroke
    kept_brake: KeptBrake
    cell_history: CellHistory | None
    host_checks: int
    process_data: ProcessData
    cut_short: str  # why it ends before the end of the process, "" if it does not


@dataclass(frozen=True)
class Batch:
    """Ticks as recorded and as replayed; ``sent``: frames recorded and replayed, by tick."""

    recorded: Slots
    replayed: Slots
    sent: list[tuple[list[tuple[int, bytes]], list[tuple[int, bytes]]]]


def made_by(recording: Recording) -> str:
    """Which release replays a recording that this one does not, in words; empty where it was made by this one."""
    if recording.release == __version__:
        return ""
    wrote = f"rigctl {recording.release}" if recording.release else "a release that it does not name"
    return f"it was made by {wrote}, which replays it; this is {__version__}"


def spans(recording: Recording) -> list[ProcessSpan]:
    """The control processes that the recording holds from their start.

    Raises:
        ReplayError: there is none, or the inputs at the start of one are missing.
    """
    records = recording.records
    if any(getattr(recording, name).dtype != slot.dtype for name, slot in SLOTS.items()):
        other = made_by(recording) or f"it was made by another build of {__version__}, which replays it"
        raise ReplayError(f"its records are not those of this version's loop: {other}")
    starts = np.flatnonzero(records["tick"] - records["skipped"] == 1).tolist()
    if not starts:
        where = f"tick {int(records['tick'][0])}" if len(records) else "nothing"
        raise ReplayError(f"no start of the loop is in it: it begins with {where} (give the run's first part)")
    return [
        _span(recording, records[start:end]) for start, end in zip(starts, [*starts[1:], len(records)], strict=True)
    ]


def _span(recording: Recording, records: Slots) -> ProcessSpan:
    first_ns = int(records["t_ns"][0])
    started = [event for event in recording.events if event.what == Kind.STARTED.name.lower()]
    started = [event for event in started if event.t_ns <= first_ns]
    if not started:
        raise ReplayError("the event of the loop's start is not in it")
    active = _document(recording, ACTIVE, first_ns)
    control = _document(recording, "control.json", first_ns)
    standing = recording.in_force(IN_FORCE, first_ns)
    other = f"; {named}" if (named := made_by(recording)) else ""
    try:
        settings = RigSettings.model_validate(active.get("settings"))
        gains = msgspec.convert(active.get("design", {}).get("gains"), Gains)
        process_data = ProcessData.of_json(control.get("process_data"))
        last = msgspec.convert(control.get("last_stroke", {}), LastStroke)
        brake = msgspec.convert(control.get("kept_brake", {}), KeptBrake)
        history = msgspec.convert(control.get("cell_history"), CellHistory | None)
        watched = msgspec.convert(control.get("watched", []), tuple[Watched, ...])
        correction = (msgspec.json.decode(standing, type=Standing) if standing else Standing()).correction
    except ValidationError as error:
        first, *_ = Wording(RigSettings, frozenset(), Document({}, {}), pathlib.Path(ACTIVE)).lines(error)
        raise ReplayError(f"the recorded settings are refused by this version: {first}{other}") from None
    except msgspec.MsgspecError as error:
        raise ReplayError(f"what the loop was started with cannot be read: {error}{other}") from None
    whole, cut_short = _without_gap(recording, records)
    supervised = all(bool(stop.get("ok")) for stop in control.get("supervision", []))
    taken = int(started[-1].details.get("a", 0)), int(started[-1].details.get("b", 0))
    host = int(control.get("host_checks", Check.HOST))
    return ProcessSpan(
        whole, started[-1].t_ns, taken, settings, gains, correction, supervised, watched, last, brake, history,
        host, process_data, cut_short,
    )  # fmt: skip


def _document(recording: Recording, name: str, t_ns: int) -> dict[str, Any]:
    if recording.in_force(name, t_ns) is None:
        raise ReplayError(f"{name} is not in it: not known what the loop was started with")
    if (found := recording.table(name, t_ns)) is None:
        raise ReplayError(f"{name} in it cannot be read")
    return found


def _without_gap(recording: Recording, records: Slots) -> tuple[Slots, str]:
    """Records up to the first gap in any input of the loop, and the reason for an early end."""
    holes = np.flatnonzero(np.diff(records["seq"].astype(np.int64)) != 1)
    end, why = (int(holes[0]) + 1, "records are missing") if len(holes) else (len(records), "")
    for gap in recording.gaps:
        if gap.ring in ("frames", "commands", "holds"):
            at = int(np.searchsorted(records["t_ns"], gap.t_ns))
            if 0 < at < end:
                end, why = at, f"{gap.ring} are missing"
    return records[:end], why


def play(
    recording: Recording, span: ProcessSpan, settings: RigSettings | None = None, gains: Gains | None = None
) -> Iterator[Batch]:
    """Run the loop over a span, ``BATCH_TICKS`` at a time.

    Args:
        recording: source of the span.
        span: the process to replay.
        settings: replace those recorded.
        gains: replace those recorded.

    Raises:
        RoomError: the memory of the loop's rings is not free.
    """
    settings, gains = settings or span.settings, gains or span.gains
    with memory_folder("rigctl-replay-") as folder:
        runtime = Runtime(folder)
        runtime.make_rings(settings, history_s=-(-2 * BATCH_TICKS // settings.loop.rate_hz))
        clock, bus, holds = RecordedClock(span.started_ns), RecordedBus(), GivenHolds()
        loop = Loop(
            settings, gains, bus, clock, Rings.of(runtime),
            supervised=span.supervised, host_checks=span.host_checks, correction=span.correction, watched=span.watched,
            last_stroke=span.last_stroke, kept_brake=span.kept_brake, process_data=span.process_data,
            cell_history=span.cell_history, holds=holds,
        )  # fmt: skip
        replayed, orders = runtime.records.reader(), runtime.commands.writer()
        batch: list[Tick] = []
        now: list[list[tuple[int, bytes]]] = []
        at = 0
        try:
            for tick in ticks(span.records, recording.frames, recording.commands, recording.holds, span.taken):
                for order in tick.commands:
                    orders.write(*order)
                holds.extend(tick.holds)
                loop.stop_requested |= tick.end_requests > 0
                loop.repeated_stops = max(0, tick.end_requests - 1)
                clock.begin(tick)
                bus.begin(tick)
                loop.tick()
                batch.append(tick)
                now.append(bus.sent)
                if len(batch) == BATCH_TICKS or at + len(batch) == len(span.records):
                    sent = [(tick.sent, frames) for tick, frames in zip(batch, now, strict=True)]
                    yield Batch(span.records[at : at + len(batch)], replayed.read(), sent)
                    at += len(batch)
                    batch, now = [], []
        finally:
            bus.shutdown()
