"""`python -m hil faults --texts`: every text is there, the same each time, and a changed one is found."""

from __future__ import annotations

import json
import os
import pathlib
import re
import subprocess
import sys
from enum import IntEnum
from typing import Any

import pytest

from hil.__main__ import PROGRAM
from hil.__main__ import app as hil_app
from hil.cli import faults_texts as command
from hil.faults.digests.streams import _EVENT
from hil.scenario.errors import ScenarioError
from hil.texts import pages, words
from hil.texts.event_samples import samples
from hil.texts.helps import helps
from rigctl.cli.verb_table import VERBS
from rigctl.model import emergency, events, fault_words, reactions, refusal_words, states
from rigctl.model.checks import Check
from rigctl.model.events import Kind
from rigctl.model.faults import Fault
from rigctl.model.states import Witness
from rigctl.model.verbs import Refusal, Verb
from tests.builders.paths import ROOT
from tests.builders.waiting import patience_s

RIG = ROOT / "config/paper_rig.yaml"
SAMPLES = list(samples())
WITHOUT_ACTION = (Kind.LIMIT, Kind.LIMIT_OVER, Kind.CAUSE, Kind.CAUSE_OVER)
"""Kinds whose words do not have the action, their ``b``."""
IMPORTED = ("TRIED_IN", "WATCHED")
"""Tables of other modules, which are no words."""


class Watched(dict[Any, Any]):
    """A table that notes which of its rows are looked up."""

    def __init__(self, table: dict[Any, Any]) -> None:
        super().__init__(table)
        self.seen: set[Any] = set()

    def __getitem__(self, key: Any) -> Any:
        self.seen.add(key)
        return super().__getitem__(key)

    def get(self, key: Any, default: Any = None) -> Any:
        self.seen.add(key)
        return super().get(key, default)


def run(file: pathlib.Path, against: pathlib.Path | None = None) -> int:
    return command.run(RIG, file, against, hil_app, PROGRAM)


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> pathlib.Path:
    """The file of this commit."""
    file = tmp_path_factory.mktemp("texts") / "here.json"
    assert run(file) == 0
    return file


# -- what is there --------------------------------------------------------------------------------------------------
def test_every_kind_of_event_has_samples() -> None:
    assert {sample.kind for sample in SAMPLES} == set(Kind)


@pytest.mark.parametrize(
    ("kind", "field", "members"),
    [
        (kind, field, members)
        for kind, fields in _EVENT.items()
        for field, members in fields.items()
        if kind not in WITHOUT_ACTION or field != "b"
    ]
    + [(Kind.WITNESS, "a", Witness), (Kind.BRAKE_FLAG, "a", (0, 1))],
)
def test_every_member_of_an_enumeration_is_in_an_event(kind: Kind, field: str, members: type[IntEnum]) -> None:
    assert {getattr(sample, field) for sample in SAMPLES if sample.kind is kind} >= set(members)


@pytest.mark.parametrize(
    ("module", "name"),
    [
        (module, name)
        for module in (emergency, events, fault_words, reactions, refusal_words, states)
        for name, table in vars(module).items()
        if isinstance(table, dict) and not name.startswith("__") and name not in IMPORTED
    ],
)
def test_every_row_of_a_table_of_words_is_used(module: Any, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    table = Watched(getattr(module, name))
    monkeypatch.setattr(module, name, table)
    words.words()
    assert table.keys() <= table.seen


def test_every_refusal_check_and_fault_has_its_words() -> None:
    found = words.words()
    for refusal in Refusal:
        assert any(name.startswith(f"refusal {refusal.name} ") for name in found), refusal
    for check in Check:
        assert check.words in found[f"refusal PREFLIGHT {check.name}"]
    for fault in Fault:
        assert fault.remedy in found[f"fault {fault.name}"]
    assert {name.split()[2] for name in found if name.startswith("refusal WRONG_MODE")} == {verb.name for verb in Verb}


CANNOT_BE = (
    r"\bsince (?:\d|as long)",  # a time that has passed, for its beginning
    r"\bload (?:the (?:drive|motor)|not known)",  # two sentences run together
    r"(?<![\d.])1 (?:ticks|slots|moves|samples|settings|frames|more are)\b",
    r"bytes $",  # bytes that there are none of
    r"\b(?:drive|position) says\b|\bas the plant says\b",  # a device reports
    r"\bnode \d+: \d+$",  # a number in place of a state
    r" by nobody| from nobody|kim other than",
    r"\bsensor's (?:manual|emergency)",  # of any device
)


@pytest.mark.parametrize("pattern", CANNOT_BE)
def test_no_event_refusal_fault_or_note_says_what_cannot_be(pattern: str) -> None:
    assert [text for text in words.words().values() if re.search(pattern, text)] == []


def test_a_hint_leads_on_from_the_mode_it_is_given_in() -> None:
    refused = [text for name, text in words.words().items() if name.startswith("refusal WRONG_MODE")]
    for there in ("in HOLD: hold", "in DISARMED: disarm", "in COMPENSATING: tension"):
        assert not [text for text in refused if there in text]


def test_every_command_has_its_help_of_80_columns_without_colour(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    found = helps(hil_app, PROGRAM)
    assert os.environ["COLUMNS"] == "200"
    assert {f"help rigctl {row.name}" for row in VERBS} | {f"help {PROGRAM} faults", "help rigctl"} <= found.keys()
    for name, text in found.items():
        assert "Usage: " in text, name
        assert "\x1b" not in text
        assert max(map(len, text.splitlines())) <= 80, name


def test_the_help_of_a_command_is_that_of_its_process() -> None:
    found = helps(hil_app, PROGRAM)
    as_typed = ["-c", "import sys; sys.argv[0] = 'rigctl'; from rigctl.cli.entry import main; main()"]
    for typed, *command_words in (("rigctl",), ("rigctl", "target"), (PROGRAM, "inject")):
        process = ["-m", "hil"] if typed == PROGRAM else as_typed
        done = subprocess.run(
            [sys.executable, *process, *command_words, "--help"], env={**os.environ, "COLUMNS": "80"},
            capture_output=True, text=True, timeout=patience_s(), check=True,
        )  # fmt: skip
        assert done.stdout == found[" ".join(("help", typed, *command_words))]


def test_the_pages_are_there_as_they_are_in_the_tree(written: pathlib.Path) -> None:
    found = json.loads(written.read_text())
    for name in ("docs/modes.md", "docs/rig-file.md", "config/schema/rig.schema.json"):
        assert "\n".join(found[f"page {name}"]) == (ROOT / name).read_text()
    page = (ROOT / "docs/faults.md").read_text()
    assert all(row in page for row in found["page docs/faults.md, its table"])
    assert {"page index.html", "page commands.js", "schema meta/schema"} <= found.keys()
    assert "page uplot.js" not in found


def test_a_sentence_of_the_source_is_there_and_a_docstring_is_not(
    tmp_path: pathlib.Path, written: pathlib.Path
) -> None:
    (tmp_path / "__init__.py").write_text(
        '"""Of a module."""\nfound = 1\nname = "one"\ntext = f"found {found:.1f} and " "more"\n'
        'def f():\n    """Of a function."""\n    return f"{\'a b\'}: {found}", "two words"\n'
    )

    class Package:
        __file__ = str(tmp_path / "__init__.py")

    assert pages._sentences(Package).splitlines() == ['"a b"', '"found {:.1f} and more"', '"two words"']
    assert '"the rope is slack"' in json.loads(written.read_text())["sentences rigctl"]


# -- the command ----------------------------------------------------------------------------------------------------
def test_two_processes_write_the_same_bytes(tmp_path: pathlib.Path, written: pathlib.Path) -> None:
    there = tmp_path / "there.json"
    environment = {**os.environ, "PYTHONHASHSEED": "7", "COLUMNS": "200", "HOME": str(tmp_path), "LANG": "C"}
    done = subprocess.run(
        [sys.executable, "-m", "hil", "faults", "--texts", str(there), "--against", str(written)], env=environment,
        cwd=tmp_path, capture_output=True, text=True, timeout=patience_s(), check=False,
    )  # fmt: skip
    assert (done.returncode, done.stdout.splitlines()[-1]) == (0, "equal"), done.stdout + done.stderr
    assert written.read_bytes() == there.read_bytes()


def test_a_changed_text_is_found_and_shown(
    tmp_path: pathlib.Path,
    written: pathlib.Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(refusal_words._PLAIN_TEXT, Refusal.SLACK, "the rope hangs")
    assert run(tmp_path / "after.json", written) == 1
    shown = capsys.readouterr().out.splitlines()
    first = shown.index("refusal SLACK 12.345:")
    assert shown[first + 1 : first + 3] == ["  - the rope is slack", "  + the rope hangs"]
    assert re.fullmatch(r"2 of \d+ texts differ; the first: refusal SLACK -0.001", shown[-1])


def test_a_text_of_one_side_alone_is_named(
    tmp_path: pathlib.Path, written: pathlib.Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = tmp_path / "before.json"
    found = json.loads(written.read_text())
    found["help rigctl dance"] = found.pop("help rigctl arm")
    before.write_text(json.dumps(found))
    assert run(tmp_path / "after.json", before) == 1
    assert capsys.readouterr().out.splitlines()[-3:-1] == [
        "only this file has 1 text: help rigctl arm", "only the other file has 1 text: help rigctl dance"
    ]  # fmt: skip


@pytest.mark.parametrize("content", ["no JSON", "[1]", '{"a": 1}', None])
def test_a_file_without_texts_is_refused_in_one_line(tmp_path: pathlib.Path, content: str | None) -> None:
    if content is not None:
        (tmp_path / "other").write_text(content)
    with pytest.raises(ScenarioError, match="holds no texts") as refused:
        run(tmp_path / "file", tmp_path / "other")
    assert len(refused.value.findings) == 1
    assert not (tmp_path / "file").exists()
