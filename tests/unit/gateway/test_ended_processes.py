"""Deaths of recorder and gateway are on record once, whichever gateway sees them; alarms fold from those notes."""

from __future__ import annotations

import pathlib

import pytest

from rigctl.config import rig_file
from rigctl.gateway.ended_processes import EndedProcesses, ProcessNote
from rigctl.gateway.lease_service import IN_FORCE, LeaseService
from rigctl.ipc.notes import Note, note_message
from rigctl.ipc.runtime_folder import Runtime
from rigctl.ipc.supervision import Doing, Supervision
from rigctl.model.event_row import Priority
from rigctl.wire.alarms import Alarms
from tests.builders.paths import ROOT

S = 1_000_000_000
KILLED = "killed by signal 9; comes back in 0.2 s; the loop is unaffected"


@pytest.fixture
def runtime(tmp_path: pathlib.Path) -> Runtime:
    found = Runtime(tmp_path)
    found.make_rings(rig_file.load(ROOT / "config/paper_rig.yaml"))
    found.write_json(IN_FORCE, {})
    return found


@pytest.fixture
def supervision(runtime: Runtime) -> Supervision:
    """The supervisor's notes of a run that has just started."""
    found = Supervision(runtime.supervision.writer())
    for at, process in enumerate(("recorder", "control", "gateway")):
        found.note(at, Doing.PROCESS_STARTED, process=process, reason=str(at))
    return found


class Gateway:
    """What a gateway has of the deaths, and puts on record."""

    def __init__(self, runtime: Runtime) -> None:
        self._leases, self._ended = LeaseService(runtime, 300, 0), EndedProcesses(runtime)

    def look(self) -> list[tuple[Note, str]]:
        found = self._ended.look()
        for note in found:
            self._leases.note_process(note)
        return [(note.kind, note.process) for note in found]

    def announces(self, at_ns: int) -> None:
        self._leases.note_process(ProcessNote(at_ns, Note.PROCESS_BACK, "gateway", "the access list has changed"))


def alarms(runtime: Runtime) -> dict[str, tuple[bool, int, int]]:
    """Of every row by its cause: whether it is active, how often it came, and when last."""
    found = Alarms(note_message(note, 0)[1] for note in runtime.notes.reader(from_start=True).read())
    return {row.cause: (row.stands, row.count, row.last_ns) for row in found.rows(None, 100 * S)}


def test_a_recorder_that_dies_is_an_alarm_until_it_is_started_again(runtime: Runtime, supervision: Supervision) -> None:
    gateway = Gateway(runtime)
    assert gateway.look() == []
    supervision.note(3 * S, Doing.PROCESS_ENDED, process="recorder", reason=KILLED)
    assert gateway.look() == [(Note.PROCESS_LOST, "recorder")]
    assert alarms(runtime) == {"RECORDER_ENDED": (True, 1, 3 * S)}
    (row,) = Alarms(note_message(note, 0)[1] for note in runtime.notes.reader(from_start=True).read()).rows(None, 4 * S)
    assert (row.priority, row.text) == (Priority.LOW, f"recorder process {KILLED}")
    supervision.note(4 * S, Doing.PROCESS_STARTED, process="recorder", reason="99")
    assert gateway.look() == [(Note.PROCESS_BACK, "recorder")]
    assert alarms(runtime) == {"RECORDER_ENDED": (False, 1, 3 * S)}


def test_the_next_gateway_puts_the_death_of_the_one_before_on_record_once(
    runtime: Runtime, supervision: Supervision
) -> None:
    Gateway(runtime).look()
    for deaths in (1, 2):
        supervision.note(deaths * 10 * S, Doing.PROCESS_ENDED, process="gateway", reason=KILLED)
        supervision.note(deaths * 10 * S + 1, Doing.PROCESS_STARTED, process="gateway", reason="99")
        gateway = Gateway(runtime)
        assert gateway.look() == [(Note.PROCESS_LOST, "gateway"), (Note.PROCESS_BACK, "gateway")]
        assert alarms(runtime) == {"GATEWAY_ENDED": (False, deaths, deaths * 10 * S)}
        assert gateway.look() == Gateway(runtime).look() == []


def test_a_gateway_that_starts_anew_in_order_is_no_alarm_and_the_death_after_it_is_one(
    runtime: Runtime, supervision: Supervision
) -> None:
    gateway = Gateway(runtime)
    gateway.look()
    gateway.announces(5 * S)
    supervision.note(6 * S, Doing.PROCESS_ENDED, process="gateway", reason="ended with code 0; comes back in 0.2 s")
    supervision.note(7 * S, Doing.PROCESS_STARTED, process="gateway", reason="99")
    Gateway(runtime).look()
    assert alarms(runtime) == {}
    supervision.note(8 * S, Doing.PROCESS_ENDED, process="gateway", reason=KILLED)
    Gateway(runtime).look()
    assert alarms(runtime) == {"GATEWAY_ENDED": (True, 1, 8 * S)}


def test_the_loop_and_the_page_have_no_such_alarm(runtime: Runtime, supervision: Supervision) -> None:
    """A silent loop is LOOP_SILENT, and a page that ends is seen by who looks at it."""
    for process in ("control", "page"):
        supervision.note(S, Doing.PROCESS_ENDED, process=process, reason=KILLED)
    assert Gateway(runtime).look() == []
