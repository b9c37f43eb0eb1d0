"""Every change of the log breaks its chain."""

from __future__ import annotations

import hashlib
import json
import math
import pathlib
import subprocess
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rigctl.recorder.chain import ORIGIN, AuditEntry, canonical, line_of, read_line, verify

TEXTS = st.text(max_size=30)
VALUES = (
    st.none() | st.booleans() | st.integers(0, 2**64 - 1) | st.floats(allow_nan=False, allow_infinity=False) | TEXTS
)
ITEMS = st.lists(st.tuples(TEXTS, TEXTS, st.dictionaries(TEXTS, VALUES, max_size=3)), min_size=2, max_size=8)
WALL = "2025-01-01T00:00:00.000Z"


def log(items: list[tuple[str, str, dict[str, Any]]], previous: str = ORIGIN, n: int = 0) -> tuple[list[bytes], str]:
    """Lines and head of a log."""
    lines, head = [], previous
    for number, (what, who, details) in enumerate(items, n + 1):
        line, head = line_of(
            AuditEntry(number, "rig", WALL, number, what, who, "", details, "events", number, {}, head)
        )
        lines.append(line)
    return lines, head


@given(ITEMS)
def test_a_log_that_nobody_touched_holds(items: list[tuple[str, str, dict[str, Any]]]) -> None:
    lines, head = log(items)
    report = verify(lines, head)
    assert (report.good, report.entries, report.head, report.head_line) == (True, len(items), head, len(items))
    assert [read_line(line)[0].details for line in lines] == [details for _, _, details in items]
    for line in lines:  # anyone with SHA-256 and a JSON reader can check this
        assert b"\n" not in line[:-1]
        plain = json.loads(line)
        own = plain.pop("hash")
        assert own == hashlib.sha256(line.rsplit(b',"hash":', 1)[0] + b"}").hexdigest()
        assert canonical(plain) == line.rsplit(b',"hash":', 1)[0] + b"}"


@given(ITEMS, st.data())
def test_a_changed_byte_is_found_where_it_is(items: list[tuple[str, str, dict[str, Any]]], data: st.DataObject) -> None:
    lines, _ = log(items)
    number = data.draw(st.integers(0, len(lines) - 1))
    place = data.draw(st.integers(0, len(lines[number]) - 2))
    other = data.draw(st.integers(0, 255).filter(lambda value: value not in (lines[number][place], ord("\n"))))
    changed = bytearray(lines[number])
    changed[place] = other
    report = verify([*lines[:number], bytes(changed), *lines[number + 1 :]])
    assert (report.line, report.entries) == (number + 1, number)
    assert report.why.startswith("edited")


@given(ITEMS, st.data())
def test_removed_lines_are_found(items: list[tuple[str, str, dict[str, Any]]], data: st.DataObject) -> None:
    lines, head = log(items)
    first = data.draw(st.integers(0, len(lines) - 1))
    last = data.draw(st.integers(first + 1, len(lines)))
    left = lines[:first] + lines[last:]
    report = verify(left)
    if last < len(lines):
        assert (report.line, report.entries) == (first + 1, first)
        assert report.why.startswith("removed")
    else:  # at the end: only a head recorded elsewhere shows it
        assert report.good
        report = verify(left, head)
        assert (report.line, report.why.split(":")[0]) == (len(left) + 1, "truncated")


@given(ITEMS, st.data())
def test_lines_in_another_order_or_twice_are_found(
    items: list[tuple[str, str, dict[str, Any]]], data: st.DataObject
) -> None:
    lines, _ = log(items)
    order = data.draw(st.permutations(range(len(lines))).filter(lambda found: found != list(range(len(lines)))))
    first = next(i for i, place in enumerate(order) if i != place)
    assert verify([lines[i] for i in order]).line == first + 1
    again = data.draw(st.integers(0, len(lines) - 1))
    place = data.draw(st.integers(again + 1, len(lines)))
    report = verify([*lines[:place], lines[again], *lines[place:]])
    assert report.line == place + 1
    assert report.why.startswith("reordered or repeated")


@given(ITEMS, ITEMS, st.data())
def test_forged_entries_are_found_by_the_next_true_one_or_by_the_head(
    items: list[tuple[str, str, dict[str, Any]]], forged: list[tuple[str, str, dict[str, Any]]], data: st.DataObject
) -> None:
    lines, head = log(items)
    place = data.draw(st.integers(1, len(lines) - 1))
    before = read_line(lines[place])[0].previous
    instead, _ = log([("forged", who, details) for _, who, details in forged], before, place)
    one = verify([*lines[:place], instead[0], *lines[place + 1 :]])
    if place + 1 < len(lines):
        assert one.line == place + 2
        assert one.why.startswith("edited")
    report = verify(lines[:place] + instead, head)
    assert report.why.startswith("truncated")
    assert verify(lines[:place] + instead).good


@pytest.mark.parametrize(
    ("line", "why"),
    [
        (b"", "truncated"),
        (b"{}", "truncated"),
        (b"{}\n", "edited: no entry"),
        (b"\n", "edited: no entry"),
        (b"\x00\xff\n", "edited: no entry"),
    ],
)
def test_what_is_no_line_is_told(line: bytes, why: str) -> None:
    assert verify([line]).why.startswith(why)
    assert verify([line]).line == 1


def _hashed(body: bytes) -> bytes:
    return body[:-1] + b',"hash":"' + hashlib.sha256(body).hexdigest().encode() + b'"}\n'


@pytest.mark.parametrize(
    "change",
    [
        lambda body: body.replace(b'"n":1', b'"n":1.0'),
        lambda body: body.replace(b'"n":1', b'"n": 1'),
        lambda body: body.replace(b'"n":1', b'"n":1,"n":1'),
        lambda body: body.replace(b'"n":1,', b""),
        lambda _body: b"[1]",
        lambda body: b"{" + body,
    ],
)
def test_a_line_with_a_true_hash_of_something_else_is_no_entry(change: Callable[[bytes], bytes]) -> None:
    line, _ = line_of(AuditEntry(1, "rig", WALL, 1, "what", "", "", {}, "events", 1, {}, ORIGIN))
    body = line.rsplit(b',"hash":', 1)[0] + b"}"
    assert verify([_hashed(body)]).good
    assert verify([_hashed(change(body))]).why.startswith("edited")


def test_a_log_of_two_rigs_does_not_hold() -> None:
    first, head = line_of(AuditEntry(1, "one", WALL, 1, "", "", "", {}, "", 0, {}, ORIGIN))
    second, _ = line_of(AuditEntry(2, "two", WALL, 1, "", "", "", {}, "", 0, {}, head))
    assert "an entry of 'two' in the log of 'one'" in verify([first, second]).why


def test_numbers_that_json_does_not_know_are_null() -> None:
    line, _ = line_of(AuditEntry(1, "rig", WALL, 1, "", "", "", {"value": math.nan}, "", 0, {}, ORIGIN))
    assert read_line(line)[0].details == {"value": None}


Command = Callable[..., "subprocess.CompletedProcess[str]"]


def test_the_command_says_whether_it_holds_and_where_it_does_not(in_process: Command, tmp_path: pathlib.Path) -> None:
    lines, head = log([("started", "", {}), ("command_accepted", "kim", {"value": 60.0}), ("trip", "", {})])
    file = tmp_path / "log.jsonl"
    file.write_bytes(b"".join(lines))
    good = in_process("rigctl", "audit", "verify", file)
    assert (good.returncode, good.stderr) == (0, "")
    assert good.stdout == f"{file}: intact: 3 entries, {WALL} to {WALL}, head {head}\n"
    earlier = read_line(lines[1])[0].previous
    assert "; 2 entries since the head given" in in_process("rigctl", "audit", "verify", file, "--head", earlier).stdout
    for part, options, said in (
        (lines[:2], ("--head", head), ":3: truncated: the head"),
        ([lines[0], lines[2]], (), ":2: removed or reordered: entry 2 is missing"),
        ([lines[1], lines[0], lines[2]], (), ":1: removed or reordered"),
        ([*lines[:2], lines[2][:-5]], (), ":3: truncated"),
        ([lines[0], lines[1].replace(b"kim", b"tom"), lines[2]], (), ":2: edited"),
    ):
        file.write_bytes(b"".join(part))
        bad = in_process("rigctl", "audit", "verify", file, *options)
        assert (bad.returncode, bad.stdout) == (1, "")
        assert bad.stderr.startswith(f"rigctl: {file}{said}")
        assert bad.stderr.count("\n") == 1
        told = json.loads(in_process("rigctl", "audit", "verify", file, "--json", *options).stdout)
        assert (told["ok"], f"{told['line']}: {told['why']}"[:9]) == (False, said[1:10])


def test_the_command_shows_what_was_done(in_process: Command, tmp_path: pathlib.Path) -> None:
    lines, _ = log([("started", "", {}), ("command_accepted", "kim\x1b[2J", {"value": 60.0}), ("trip", "", {})])
    file = tmp_path / "log.jsonl"
    file.write_bytes(b"".join(lines))
    shown = in_process("rigctl", "audit", "show", file)
    assert shown.returncode == 0
    assert [line.split()[1] for line in shown.stdout.splitlines()] == ["started", "command_accepted", "trip"]
    assert "\x1b" not in shown.stdout
    assert in_process("rigctl", "audit", "show", file, "--last", "1").stdout.split()[1] == "trip"
    assert in_process("rigctl", "audit", "show", file, "--what", "command").stdout.count("\n") == 1
    assert in_process("rigctl", "audit", "show", file, "--who", "kim").stdout == ""
    assert in_process("rigctl", "audit", "show", file, "--since", "2025-01-01T00:00:00Z").stdout.count("\n") == 3
    assert in_process("rigctl", "audit", "show", file, "--since", "2025-01-01T00:00:00.001Z").stdout == ""
    assert json.loads(in_process("rigctl", "audit", "show", file, "--json", "--last", "1").stdout)["n"] == 3
    file.write_bytes(b"".join([lines[0], b"junk\n", lines[2]]))
    bad = in_process("rigctl", "audit", "show", file)
    assert (bad.returncode, bad.stdout.count("\n")) == (1, 2)
    assert f"{file}:2: edited" in bad.stderr


def test_without_a_name_it_is_the_running_daemons_and_of_a_rig_file_its_own(
    in_process: Command, tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from rigctl.ipc import runtime_folder as runtime

    monkeypatch.setattr(runtime, "BASE", tmp_path)
    none = in_process("rigctl", "audit", "verify")
    assert (none.returncode, none.stderr.startswith("rigctl: found no daemon on this machine")) == (2, True)
    lines, _ = log([("started", "", {})] * 2)
    (tmp_path / "log.jsonl").write_bytes(b"".join(lines))
    for name, process in (("one", 1), ("gone", 1 << 30)):
        daemon = runtime.Runtime.of(name)
        daemon.directory.mkdir()
        daemon.write_json(runtime.ACTIVE, {"pid": process})
        daemon.write_json(runtime.RECORDED, {"audit_log": str(tmp_path / "log.jsonl")})
    assert "intact: 2 entries" in in_process("rigctl", "audit", "verify").stdout
    of_rig = in_process("rigctl", "audit", "verify", "config/rig.yaml")
    assert of_rig.returncode == 2
    assert "config/audit/rig.jsonl cannot be read" in of_rig.stderr
