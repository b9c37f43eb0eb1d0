"""The lease service: what it writes down for the next gateway, and what it notes."""

from __future__ import annotations

import pathlib
from typing import Any

import msgspec
import pytest

from rigctl.config import rig_file as config
from rigctl.gateway.lease_service import IN_FORCE, NAMES_REPORTED, LeaseService, valid_lease
from rigctl.ipc.notes import Note
from rigctl.ipc.runtime_folder import Runtime
from rigctl.model.requests import Request
from rigctl.model.verbs import Verb
from rigctl.operations.command_rate import RefusedCommands
from rigctl.operations.lease import Lease
from tests.builders.paths import ROOT

S = 1_000_000_000
TERM = 300 * S
ID = "0" * 31 + "1"


@pytest.fixture
def runtime(tmp_path: pathlib.Path) -> Runtime:
    found = Runtime(tmp_path)
    found.make_rings(config.load(ROOT / "config/paper_rig.yaml"))
    found.write_json(IN_FORCE, {})
    return found


def notes(runtime: Runtime) -> list[tuple[Note, str, str, str]]:
    found = runtime.notes.reader(from_start=True).read()
    return [(Note(note["kind"]), *(note[name].decode() for name in ("operator", "other", "reason"))) for note in found]


def lease_of(service: LeaseService, operator: str, now_ns: int) -> str:
    given = service.admit(Request(Verb.DISARM, operator), now_ns)
    assert isinstance(given, Request)
    assert given.lease is not None
    service.with_lease(given, {"accepted": True}, now_ns)
    return given.lease


def test_a_refused_command_leaves_no_lease_behind(runtime: Runtime) -> None:
    service = LeaseService(runtime, 300, 1 * S)
    given = service.admit(Request(Verb.TARGET, "anna", 9999.0), 2 * S)
    assert isinstance(given, Request)
    assert service.shown(2 * S) is not None
    assert service.with_lease(given, {"accepted": False}, 3 * S)["lease"] is None
    assert notes(runtime) == []
    lease = lease_of(service, "anna", 4 * S)
    again = service.admit(Request(Verb.TARGET, "anna", 9999.0, lease=lease), 100 * S)
    assert isinstance(again, Request)
    shown = service.with_lease(again, {"accepted": False}, 100 * S)["lease"]
    assert (shown["until_ns"], shown["id"]) == (304 * S, lease)


def test_the_next_gateway_goes_on_with_the_lease(runtime: Runtime) -> None:
    lease = lease_of(LeaseService(runtime, 300, 1 * S), "anna", 2 * S)
    after = LeaseService(runtime, 300, 3 * S)
    assert after.is_holder("anna", lease, 4 * S)
    assert not after.is_holder("kim", lease, 4 * S)
    assert notes(runtime) == [(Note.LEASE_TAKEN, "anna", "", "")]
    after.expire(400 * S)
    assert LeaseService(runtime, 300, 401 * S).shown(401 * S) is None
    assert notes(runtime)[1:] == [(Note.LEASE_LAPSED, "anna", "", "")]  # by the one that saw it lapse, once


def test_a_hold_without_the_lease_is_noted_with_whom_it_overruled(runtime: Runtime) -> None:
    service = LeaseService(runtime, 300, 1 * S)
    service.note_hold(Request(Verb.HOLD, "kim"), 1 * S)
    lease = lease_of(service, "anna", 2 * S)
    service.note_hold(Request(Verb.HOLD, "kim"), 3 * S)
    service.note_hold(Request(Verb.HOLD, "anna", lease=lease), 4 * S)
    held = [(operator, other) for kind, operator, other, _ in notes(runtime) if kind is Note.HOLD_WITHOUT_LEASE]
    assert held == [("kim", ""), ("kim", "anna")]


@pytest.mark.parametrize("names", [1, NAMES_REPORTED, NAMES_REPORTED + 1, NAMES_REPORTED + 3])
def test_refused_commands_are_noted_by_name_and_the_rest_together(runtime: Runtime, names: int) -> None:
    refused = [RefusedCommands(f"user{number}", 100 - number, 2 * S) for number in range(names)]
    LeaseService(runtime, 300, 1 * S).note_refused(refused, 12 * S)
    found = notes(runtime)
    assert {kind for kind, *_ in found} == {Note.TOO_MANY_COMMANDS}
    each = [(f"user{number}", f"{100 - number} commands in 10 s") for number in range(min(names, NAMES_REPORTED))]
    rest = names - NAMES_REPORTED
    if rest > 0:
        total = sum(one.count for one in refused[NAMES_REPORTED:])
        each.append((f"{rest} other{'s' if rest > 1 else ''}", f"{total} commands in 10 s"))
    assert [(operator, reason) for _, operator, _, reason in found] == each


def test_only_what_a_gateway_would_have_written_is_believed() -> None:
    good = Lease(ID, "anna", 5 * S, 10 * S)
    written = msgspec.to_builtins(good)
    now = 6 * S
    assert valid_lease(written, TERM, now) == good
    assert valid_lease(written, TERM, 10 * S) == good  # lapsed meanwhile: the register reports it
    bad: list[Any] = [
        None, [], "x", {}, {**written, "id": "x"}, {**written, "id": ID.upper() + "A"}, {**written, "holder": ""},
        {**written, "holder": "a\nb"}, {**written, "holder": 7}, {**written, "since_ns": 7 * S},
        {**written, "since_ns": -1}, {**written, "until_ns": now + TERM + 1}, {**written, "until_ns": 5 * S},
        {**written, "until_ns": "soon"}, {**written, "until_ns": 1e30},
    ]  # fmt: skip
    for forged in bad:
        assert valid_lease(forged, TERM, now) is None, forged


@pytest.mark.parametrize("written", [b"\xff{", b'{"id": "0"}', None], ids=["garbage", "no lease", "folder"])
def test_a_gateway_that_finds_no_lease_to_go_on_with_notes_it_and_keeps_no_operator_out(
    runtime: Runtime, written: bytes | None
) -> None:
    file = runtime.directory / IN_FORCE
    file.unlink()
    file.mkdir() if written is None else file.write_bytes(written)
    service = LeaseService(runtime, 300, 1 * S)
    assert service.shown(1 * S) is None
    assert lease_of(service, "kim", 2 * S)
    assert [kind for kind, *_ in notes(runtime)] == [Note.LEASE_NOT_BELIEVED, Note.LEASE_TAKEN]
