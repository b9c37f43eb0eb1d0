"""The log's file after a crash, a full disk or a foreign change, and the messages about it."""

from __future__ import annotations

import contextlib
import hashlib
import json
import pathlib
import re
import subprocess
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rigctl.config import rig_file as config
from rigctl.recorder import audit_log, chain
from rigctl.recorder.audit_log import AuditError, AuditLog, Item
from tests.builders.durable import Disk
from tests.builders.full_disk import files_of_at_most

WALL_NS = 1_735_689_600_123_000_000


def write(log: AuditLog, *names: str) -> None:
    items = [Item(0, WALL_NS, name, f"text of {name}", "kim", source="events", seq=3) for name in names]
    log.append(items, [{"events": number} for number, _ in enumerate(names, 1)])


def entries(path: pathlib.Path) -> list[chain.AuditEntry]:
    lines = path.read_bytes().splitlines(keepends=True)
    report = chain.verify(lines)
    assert report.good, report
    return [chain.read_line(line)[0] for line in lines]


def names(path: pathlib.Path) -> list[str]:
    return [entry.what for entry in entries(path)]


@pytest.fixture
def path(tmp_path: pathlib.Path) -> pathlib.Path:
    return tmp_path / "audit" / "rig.jsonl"


def test_a_log_goes_on_where_it_ended(path: pathlib.Path) -> None:
    log = AuditLog(path, "rig")
    write(log, "a", "b")
    log.close()
    log = AuditLog(path, "rig")
    log.open()
    assert (log.entries, log.read) == (2, {"events": 2})
    write(log, "c")
    assert names(path) == ["a", "b", "c"]
    entry = entries(path)[2]
    assert (entry.n, entry.rig, entry.wall, entry.who) == (3, "rig", "2025-01-01T00:00:00.123Z", "kim")
    assert chain.verify(path.read_bytes().splitlines(keepends=True)).head == log.head


@given(st.data())
def test_half_a_line_at_the_end_is_cut_off_and_said(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    path = tmp_path_factory.mktemp("log") / "rig.jsonl"
    write(AuditLog(path, "rig"), "a", "b", "c")
    whole = path.read_bytes()
    start = whole[:-1].rfind(b"\n") + 1
    cut = data.draw(st.integers(start + 1, len(whole) - 1))
    path.write_bytes(whole[:cut])
    log = AuditLog(path, "rig")
    write(log, "again")
    assert names(path) == ["a", "b", "repaired", "again"]
    details = entries(path)[2].details
    torn = whole[start:cut]
    assert (details["bytes"], details["sha256"]) == (len(torn), hashlib.sha256(torn).hexdigest())
    assert torn.startswith(details["begins"].encode())
    assert [file.name for file in path.parent.iterdir()] == ["rig.jsonl"]


def test_half_a_line_is_said_also_if_the_one_who_cut_it_off_did_not_live_to_say_so(path: pathlib.Path) -> None:
    write(AuditLog(path, "rig"), "a")
    with path.open("ab") as file:
        file.write(b'{"half')
    AuditLog(path, "rig").open()
    assert path.read_bytes().endswith(b"\n")
    write(AuditLog(path, "rig"), "b")
    assert names(path) == ["a", "repaired", "b"]
    write(AuditLog(path, "rig"), "c")
    assert names(path) == ["a", "repaired", "b", "c"]  # said once
    assert len(entries(path)) == 4


def test_a_log_of_nothing_but_half_a_line_begins_anew(path: pathlib.Path) -> None:
    path.parent.mkdir()
    path.write_bytes(b"\0" * 4096)  # a file system leaves this after a power failure
    write(AuditLog(path, "rig"), "a")
    assert names(path) == ["repaired", "a"]


@pytest.mark.parametrize(
    ("change", "said", "how"),
    [
        (lambda path: path.unlink(), 0, "was renamed or deleted"),
        (
            lambda path: path.write_bytes(path.read_bytes().splitlines(keepends=True)[0]),
            1,
            r"was cut from \d+ to \d+ b",
        ),
        (lambda path: path.replace(path.with_name("away")), 0, "was renamed or deleted"),
        (lambda path: path.write_bytes(b""), 0, r"was cut from \d+ to 0 bytes"),
        (lambda path: (path.unlink(), path.touch()), 0, "was (replaced by another file|cut)"),
    ],
)
def test_a_log_that_is_taken_away_while_the_daemon_runs_is_said(
    path: pathlib.Path, change: Callable[[pathlib.Path], object], said: int, how: str
) -> None:
    log = AuditLog(path, "rig")
    write(log, "a", "b")
    head = log.head
    change(path)
    write(log, "c")
    assert names(path)[-2:] == ["tampered", "c"]
    details = entries(path)[-2].details
    assert (details["entries"], details["head"], details["found"]) == (2, head, said)
    (found,) = log.changes
    assert re.match(how, found)
    assert found in entries(path)[-2].text
    write(log, "d")
    assert names(path).count("tampered") == 1


def test_a_log_that_lost_its_end_between_two_recorders_is_said(path: pathlib.Path) -> None:
    write(AuditLog(path, "rig"), "a", "b")
    path.write_bytes(path.read_bytes().splitlines(keepends=True)[0])
    write(AuditLog(path, "rig", at_least=2), "c")
    assert names(path) == ["a", "tampered", "c"]
    write(AuditLog(path, "rig", at_least=2), "d")  # the log may be longer than the recorder knew
    assert names(path)[-1] == "d"
    assert len(entries(path)) == 4


@pytest.mark.parametrize(
    ("content", "why"),
    [
        (b"hello\n", "no audit log, or broken: its last line: edited: no entry"),
        (b"x" * 200_000, "no audit log: it does not end in lines"),
        (None, "found the audit log of 'other', expected that of 'rig'"),
    ],
)
def test_what_is_no_log_of_this_rig_is_refused_and_left_as_it_is(
    path: pathlib.Path, content: bytes | None, why: str
) -> None:
    if content is None:
        write(AuditLog(path, "other"), "a")
    else:
        path.parent.mkdir()
        path.write_bytes(content)
    before = path.read_bytes()
    with pytest.raises(AuditError) as checked:
        audit_log.check(path, "rig")
    with pytest.raises(AuditError) as opened:
        AuditLog(path, "rig").open()
    assert str(checked.value) == str(opened.value)
    assert str(opened.value).startswith(f"{path}: {why}")
    assert path.read_bytes() == before


def test_checking_changes_nothing(path: pathlib.Path) -> None:
    audit_log.check(path, "rig")
    assert not path.parent.exists()
    write(AuditLog(path, "rig"), "a")
    with path.open("ab") as file:
        file.write(b"half")
    before = path.read_bytes()
    audit_log.check(path, "rig")
    assert path.read_bytes() == before
    with pytest.raises(AuditError, match="not a file"):
        audit_log.check(path.parent, "rig")


def test_run_refuses_another_rigs_log_before_it_starts_anything(
    in_process: Callable[..., subprocess.CompletedProcess[str]], tmp_path: pathlib.Path
) -> None:
    log = tmp_path / "log.jsonl"
    write(AuditLog(log, "other"), "a")
    file = tmp_path / "rig.yaml"
    text = pathlib.Path("config/paper_rig.yaml").read_text()
    eds = pathlib.Path("config/eds").resolve()
    for section, name in (("tension_cell", "tension_amplifier"), ("inclinometer",) * 2, ("cylinder", "cylinder_drive")):
        text = text.replace(f"\n{section}:", f"\n{section}:\n  eds: {eds}/{name}.eds\n  #", 1)
    head, _, tail = text.partition("\naudit:")
    rest = tail[tail.index("\n\n") :] if tail else ""
    file.write_text(f"{head}{rest}\naudit: {{file: {log}}}\n")
    answer = in_process("rigctl", "run", file)
    assert (answer.returncode, answer.stderr.count("\n")) == (2, 1)
    assert answer.stderr == f"rigctl: {log}: found the audit log of 'other', expected that of 'paper_rig'\n"
    assert config.load(file).audit_log == log


def full_disk(bytes_left: int, path: pathlib.Path) -> contextlib.AbstractContextManager[None]:
    """Limit files to this file's length and a little more."""
    return files_of_at_most(path.stat().st_size + bytes_left)


@pytest.mark.parametrize("bytes_left", [0, 1, 100, 500])
def test_a_full_disk_leaves_the_log_whole_and_it_goes_on_later(path: pathlib.Path, bytes_left: int) -> None:
    log = AuditLog(path, "rig")
    write(log, "a")
    before = path.read_bytes()
    head = log.head
    with full_disk(bytes_left, path):
        for _ in range(2):
            with pytest.raises(OSError):
                write(log, "b", "c")
    assert path.read_bytes() == before
    assert (log.entries, log.head) == (1, head)
    write(log, "b", "c")
    assert names(path) == ["a", "b", "c"]


def test_lines_are_short_enough_to_be_found_again() -> None:
    worst = chr(0x10FFFF)
    item = Item(0, WALL_NS, "x" * 32, worst * 480, worst * 64, {"reason": "\x01" * 480, "begins": "\\x00" * 400})
    entry = chain.AuditEntry(1, "r" * 32, "", 0, item.what, item.who, item.text, item.details, "", 0, {}, chain.ORIGIN)
    assert len(chain.line_of(entry)[0]) < audit_log.TAIL_BYTES
    assert json.loads(chain.line_of(entry)[0])["text"] == item.text


def test_what_is_appended_is_on_the_disk_when_append_returns(
    path: pathlib.Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    disk, log = Disk(monkeypatch), AuditLog(path, "rig")
    for name in ("a", "b"):
        write(log, name)
        assert disk.holds(path)
