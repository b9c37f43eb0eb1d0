"""The gateway in this process, with a real session; the test plays the loop on the rings."""

from __future__ import annotations

import os
import pathlib
import socket
import time
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from queue import SimpleQueue
from typing import Any

import msgspec
import numpy as np
import pytest

from rigctl.client import connection
from rigctl.client.connection import Client
from rigctl.config import layout
from rigctl.config import rig_file as config
from rigctl.config.settings import RigSettings
from rigctl.control.excitation.frequency_trial import LONGEST_S
from rigctl.control.excitation.trials import AVERAGED_S
from rigctl.control.power.arming import AWAIT_NS, BRAKE_TEST_NS, LONG_TEST_NS
from rigctl.control.watch.safety import table
from rigctl.gateway.command_server import ANSWER_NS, WAIT_NS, Giver
from rigctl.gateway.command_socket import PER_USER, TOO_MANY
from rigctl.gateway.gateway_process import Gateway
from rigctl.ipc import ledger, runtime_folder
from rigctl.ipc.folder_places import COMMAND_SOCKET
from rigctl.ipc.notes import Note
from rigctl.ipc.record import RECORD, REPLY
from rigctl.ipc.runtime_folder import ACTIVE, RECORDED, Runtime
from rigctl.model.checks import HOST_CHECKS
from rigctl.model.events import Kind
from rigctl.model.faults import Fault
from rigctl.model.reactions import Action
from rigctl.model.states import Mode
from rigctl.model.verbs import Setting, Verb
from rigctl.operations.command_rate import ALL_BURST
from rigctl.wire.user_name import PAGE
from tests.builders.operators import KIM, USER
from tests.builders.paths import ROOT
from tests.builders.waiting import patience_s, until

S = 1_000_000_000


class Rig:
    """A gateway and the rings of its loop."""

    def __init__(self, folder: pathlib.Path, lease_s: int = 300) -> None:
        paper = config.load(ROOT / "config/paper_rig.yaml")
        telemetry = paper.telemetry.model_copy(
            update={"listen": f"unixsock-stream/{folder}/listen.sock", "lease_s": lease_s}
        )
        kept = paper.audit.model_copy(update={"file": str(folder / "audit.jsonl"), "trips": str(folder / "trips")})
        self.settings: RigSettings = paper.model_copy(
            update={"telemetry": telemetry, "audit": kept, "directory": str(folder)}
        )
        self.runtime = Runtime.of(paper.rig)
        self.runtime.directory.mkdir(mode=0o700)
        self.runtime.make_rings(self.settings)
        self.runtime.write_json(ACTIVE, {"settings": self.settings.model_dump(mode="json"), "run_id": "this"})
        names = [field.name for field in RECORD.fields]
        self._blank = dict(zip(names, np.zeros(1, RECORD.dtype)[0].item()[1:], strict=True))
        self._records, self._replies = self.runtime.records.writer(), self.runtime.replies.writer()
        self._given = self.runtime.commands.reader(from_start=True)
        self.gateway = Gateway(self.runtime, self.settings)
        self.client = Client(f"unixsock-stream/{self.runtime.gateway_socket}", self.settings.rig)
        self._asking = ThreadPoolExecutor(8)

    def close(self) -> None:
        self.client.close()
        self.gateway.close()
        self._asking.shutdown()

    def record(self, **values: float) -> None:
        """The loop writes a record."""
        self._records.write(*{**self._blank, "t_ns": time.monotonic_ns(), **values}.values())

    def state(self) -> dict[str, Any]:
        """The state as a client gets it after one period."""
        self.gateway.publish()
        return self.client.state()

    def ask(self, verb: str, operator: str = "kim", value: float | None = None) -> Future[dict[str, Any]]:
        """An operator's command, whose answer is to come."""
        return self._asking.submit(self.client.command, verb, operator, value)

    def order(self, code: Verb | Setting) -> np.void:
        """The next command of this kind that reaches the loop."""
        found: list[np.void] = []

        def came() -> bool:
            found.extend(slot for slot in self._given.read() if slot["verb"] == code)
            return bool(found)

        until(came)
        return found[0]

    def logged(self, count: int) -> list[np.void]:
        """Requests and answers as logged; an answer is sent before it is logged."""
        found: list[np.void] = []
        log = self.runtime.requests.reader(from_start=True)

        def came() -> bool:
            found.extend(log.read())
            return len(found) >= count

        until(came)
        return found

    def answer(self, slot: np.void, **figures: float) -> None:
        """The loop carries a command out."""
        values = {"t_ns": time.monotonic_ns(), "id": int(slot["id"]), "accepted": 1, "reason": 0, "checks": 0,
                  "mode": int(Mode.DISARMED), **figures}  # fmt: skip
        self._replies.write(*REPLY.values(**values))


@pytest.fixture(autouse=True)
def _shared_memory(tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The client finds the keys of this run in a folder of shared memory, which is this test's own."""
    monkeypatch.setattr(runtime_folder, "BASE", tmp_path)
    monkeypatch.setattr(layout, "SHARED_MEMORY", tmp_path)


@pytest.fixture
def rig(tmp_path: pathlib.Path) -> Iterator[Rig]:
    made = Rig(tmp_path)
    yield made
    made.close()


def notes(runtime: Runtime) -> list[tuple[int, str]]:
    return [(int(note["kind"]), note["operator"].decode()) for note in runtime.notes.reader(from_start=True).read()]


def test_a_tare_is_measured_recorded_and_in_force_before_it_is_answered(rig: Rig) -> None:
    answer = rig.ask("tare")
    rig.answer(rig.order(Verb.TARE), reading_n=1.5, rms_n=0.03)
    setting = rig.order(Setting.ZERO)
    assert setting["zero_n"] == 1.5
    (entry,) = ledger.read(rig.settings)
    assert not answer.done()
    rig.answer(setting)
    found = answer.result(patience_s())
    assert found["accepted"]
    assert found["entry"] == msgspec.to_builtins(entry)
    log = rig.logged(2)  # the command as given, and its answer
    assert [slot["entry"].decode() for slot in log if slot["answered"]] == [ledger.entry_digest(entry)]


def test_a_command_without_an_entry_is_logged_without_one(rig: Rig) -> None:
    answer = rig.ask("disarm")
    rig.answer(rig.order(Verb.DISARM))
    assert answer.result(patience_s())["accepted"]
    given, answered = rig.logged(2)
    assert (given["answered"], given["id"]) == (0, answered["id"])
    assert (answered["answered"], answered["entry"]) == (1, b"")


def test_commands_lease_and_refusals_come_by_the_command_socket_with_their_user_on_record(rig: Rig) -> None:
    answer = rig.ask("disarm")
    rig.answer(rig.order(Verb.DISARM))
    assert answer.result(patience_s())["accepted"]
    assert rig.client.return_lease("kim")["accepted"]
    assert rig.client.ask(rig.client.keys.command("disarm"), b"{}")[0] is False
    slots = rig.logged(4)
    assert [bytes(slot["verb"]).decode() for slot in slots] == ["disarm", "disarm", "lease_return", "disarm"]
    assert {bytes(slot["giver"]).decode() for slot in slots} == {f"process {os.getpid()} of {USER}"}
    assert {bytes(slot["operator"]).decode() for slot in slots} == {KIM, USER}  # what has no operator is the user's


@pytest.mark.parametrize(
    ("giver", "given", "operator"),
    [
        (Giver("", "lab", 7), "anna", "anna (lab)"), (Giver("", "lab", 7), "anna (lab)", "anna (lab)"),
        (Giver("", "anna", 7), "anna", "anna"), (Giver("", "lab", 7), "anna (root)", "anna (root) (lab)"),
        (Giver("", PAGE, 7), "anna", "anna"), (Giver("anna"), "kim", "anna"),
    ],
)  # fmt: skip
def test_the_operator_is_who_the_transport_says_with_the_name_given_before_it(
    rig: Rig, giver: Giver, given: str, operator: str
) -> None:
    answers: SimpleQueue[dict[str, Any]] = SimpleQueue()
    rig.gateway._take("lease_take", msgspec.json.encode({"operator": given}), giver, answers.put)
    answer = answers.get(timeout=patience_s())
    assert (answer["operator"], answer["lease"]["holder"]) == (operator, operator)
    body = {"operator": given, "value": 290.0, "lease": answer["lease"]["id"]}
    rig.gateway._take("target", msgspec.json.encode(body), giver, answers.put)
    rig.answer(rig.order(Verb.TARGET))
    assert answers.get(timeout=patience_s())["operator"] == operator
    (slot,) = [slot for slot in rig.logged(3) if not slot["answered"]]
    assert (slot["operator"].decode(), slot["giver"].decode()) == (operator, giver.recorded)


def test_a_viewers_command_is_refused_and_his_hold_is_not(rig: Rig) -> None:
    answers: SimpleQueue[dict[str, Any]] = SimpleQueue()
    viewer, body = Giver("", "vera", 7, commands=False), msgspec.json.encode({"operator": "kim"})
    for name, verb in (("arm", "ARM"), ("lease_take", "LEASE")):
        rig.gateway._take(name, body, viewer, answers.put)
        answer = answers.get(timeout=patience_s())
        assert (answer["accepted"], answer["reason"], answer["operator"]) == (False, "not_allowed", "kim (vera)")
        assert answer["text"] == f"{verb} refused: vera reads the rig; its commands are for the group rigctl-operator"
    assert {slot["giver"].decode() for slot in rig.logged(2)} == {"process 7 of vera"}
    rig.gateway._take("hold", body, viewer, answers.put)
    rig.answer(rig.order(Verb.HOLD))
    assert answers.get(timeout=patience_s())["accepted"]


def test_states_come_by_the_command_socket(rig: Rig) -> None:
    states = rig.client.follow(rig.client.keys.state)
    until(lambda: rig.gateway._socket._followed)
    rig.record(mode=Mode.HOLD)
    rig.gateway.publish()
    assert until(states.take)["mode"] == "HOLD"
    states.close()


def test_commands_and_states_of_this_computer_open_no_zenoh_session(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    """A router that is busy with hundreds of sessions lets no command wait."""

    def opened(*_: object) -> None:
        raise AssertionError("a Zenoh session was opened")

    monkeypatch.setattr(connection, "_open", opened)
    with Client(rig.settings.telemetry.listen) as client:
        assert client.rig == rig.settings.rig
        assert client.state()["loop_alive"] is False
        states = client.follow(client.keys.state)
        command = rig._asking.submit(client.command, "disarm", "kim")
        rig.answer(rig.order(Verb.DISARM))
        assert command.result(patience_s())["accepted"]
        rig.gateway.publish()
        assert until(states.take)
        with pytest.raises(AssertionError, match="opened"):
            client.events()


def test_a_gateway_of_the_version_before_is_read_by_zenoh_and_not_commanded(rig: Rig) -> None:
    """It has no command socket."""
    rig.runtime.place(COMMAND_SOCKET).unlink()
    with Client(f"unixsock-stream/{rig.runtime.gateway_socket}", rig.settings.rig) as client:
        states = client.follow(client.keys.state)
        assert client.state()["rig"] == rig.settings.rig

        def came() -> object:
            rig.gateway.publish()
            return states.take()

        until(came)
        for answer in (client.command("disarm", "kim"), client.take_lease("kim")):
            assert (answer["accepted"], answer["reason"]) == (False, "not_allowed")
            assert answer["text"].endswith(
                " refused: the daemon is of an earlier version: restart the daemon to command it"
            )


def test_who_lost_connections_is_on_record_once(rig: Rig) -> None:
    place = str(rig.runtime.place(COMMAND_SOCKET))
    idle = [socket.socket(socket.AF_UNIX) for _ in range(PER_USER + 5)]
    for one in idle:
        one.connect(place)
    until(lambda: rig.gateway._socket.closed)

    def noted() -> list[tuple[int, str]]:
        rig.gateway.publish()
        return [one for one in notes(rig.runtime) if one[0] == Note.CONNECTION_CLOSED]

    until(noted)
    assert len(noted()) == 1
    (note,) = [one for one in rig.runtime.notes.reader(from_start=True).read() if one["kind"] == Note.CONNECTION_CLOSED]
    assert (note["other"].decode(), note["reason"].decode().partition(" (")[0]) == (f"local user {USER}", TOO_MANY)
    assert rig.client.state()["rig"] == rig.settings.rig
    for one in idle:
        one.close()


def test_a_reply_to_a_command_of_an_earlier_gateway_is_nobodys(rig: Rig) -> None:
    answer = rig.ask("disarm")
    slot = rig.order(Verb.DISARM)
    stranger = slot.copy()
    stranger["id"] = 7
    rig.answer(stranger)
    rig.answer(slot)
    assert answer.result(patience_s())["accepted"]


def test_the_holder_gets_a_command_through_a_flood_of_others(rig: Rig) -> None:
    first = rig.ask("disarm")
    rig.answer(rig.order(Verb.DISARM))
    assert first.result(patience_s())["accepted"]
    later_ns = time.monotonic_ns() + 3600 * S  # the bucket fills with the time since the newest command: not at all
    why = [rig.gateway._commands._rate.admit(f"user{number}", later_ns) for number in range(ALL_BURST + 1)]
    assert "too many commands" in why[-1]
    answer = rig.ask("disarm")
    rig.answer(rig.order(Verb.DISARM))
    assert answer.result(patience_s())["accepted"]


def test_the_gateway_waits_longer_than_the_loop_may_take() -> None:
    assert WAIT_NS[Verb.TARE] > ANSWER_NS + AVERAGED_S * S
    assert WAIT_NS[Verb.CALIBRATE] > ANSWER_NS + AVERAGED_S * S
    assert WAIT_NS[Verb.RESPONSE] > ANSWER_NS + LONGEST_S * S
    assert WAIT_NS[Verb.BRAKE_TEST] > ANSWER_NS + AWAIT_NS + LONG_TEST_NS
    assert WAIT_NS[Verb.ARM] > AWAIT_NS + BRAKE_TEST_NS + AWAIT_NS


def test_a_loop_that_shows_other_host_checks_is_sent_them(rig: Rig) -> None:
    rig.record(checks=0)
    rig.gateway.publish()
    found = int(rig.order(Setting.HOST_CHECKS)["host_checks"])
    assert found
    assert found & ~int(HOST_CHECKS) == 0


def test_a_state_without_a_loop_has_no_causes_and_one_with_it_says_since_when(rig: Rig) -> None:
    assert rig.state()["causes"] == []
    row = next(row for row in table(rig.settings) if row.action is not Action.LOG and row.words is None)
    began_ns = time.monotonic_ns()
    rig.runtime.events.writer().write(began_ns, Kind.CAUSE, row.fault, row.action, 3.0, row.sign * row.limit, b"")
    rig.record(mode=next(iter(row.modes)), cause_bits=row.fault.bit)
    before = time.time_ns() - time.monotonic_ns()
    (cause,) = rig.state()["causes"]
    assert (cause["fault"], cause["value"], cause["since_ns"]) == (row.fault.name, 3.0, began_ns)
    assert cause["since_wall_ns"] - began_ns == pytest.approx(before, abs=60 * S)


def test_the_state_names_the_culprit_of_the_latched_fault_until_its_reset(rig: Rig) -> None:
    assert rig.state()["culprit"] is None
    events = rig.runtime.events.writer()
    events.write(time.monotonic_ns(), Kind.TRIP, Fault.E_STOP, Action.QUICK_STOP, 1.0, 0.0, b"")
    rig.record(mode=Mode.FAULT, fault=Fault.E_STOP)
    found = rig.state()["culprit"]
    assert (found["parts"], found["follows"]) == (["emergency stop"], ["E_STOP"])
    events.write(time.monotonic_ns(), Kind.RESET, Fault.E_STOP, 0, 0.0, 0.0, b"")
    rig.record(mode=Mode.HOLD)
    assert rig.state()["culprit"] is None


def test_a_lease_that_lapses_is_noted_also_while_no_command_comes(tmp_path: pathlib.Path) -> None:
    rig = Rig(tmp_path, lease_s=0)
    try:
        assert rig.ask("lease_take").result(patience_s())["accepted"]
        rig.gateway.publish()
        until(lambda: (int(Note.LEASE_LAPSED), KIM) in notes(rig.runtime))
    finally:
        rig.close()


def test_a_change_of_the_audit_log_is_noted_once_also_by_the_next_gateway(rig: Rig) -> None:
    def noted() -> list[str]:
        ring = rig.runtime.notes.reader(from_start=True).read()
        return [note["reason"].decode() for note in ring if note["kind"] == Note.AUDIT_LOG_CHANGED]

    def published() -> list[str]:
        rig.gateway.publish()
        return noted()

    changed = {"changes": 1, "changed": "was renamed or deleted"}
    rig.runtime.write_json(RECORDED, {**changed, "run": 1})  # of an earlier run
    rig.gateway._read_ns = 0
    rig.gateway.publish()
    rig.runtime.write_json(RECORDED, {**changed, "run": 0})
    assert until(published) == ["was renamed or deleted"]
    for _ in range(3):
        rig.runtime.write_json(RECORDED, {**changed, "run": 0, "entries": 7})
        rig.gateway.publish()
    assert len(noted()) == 1
    (row,) = [one for one in rig.client.past_events() if one["kind"] == "AUDIT_LOG_CHANGED"]
    assert row["severity"] == "warning"
