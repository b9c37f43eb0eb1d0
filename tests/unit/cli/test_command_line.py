"""Common options of every command line: its version, help by -h as by --help, and completion."""

from __future__ import annotations

import inspect
import os
import re
import subprocess
import sys

import pytest
import typer

import rigctl
from rigctl.cli import run, typer_app
from rigctl.cli.app import first_word
from rigctl.cli.quick_hold import HoldWords, read_words
from rigctl.cli.top_help import top_help
from rigctl.cli.typer_app import program
from rigctl.cli.verb_table import GROUPS, VERBS
from rigctl.config import extras
from rigctl.model.verbs import Verb
from tests.builders.waiting import patience_s
from tests.conftest import Command


def test_it_says_its_version(in_process: Command) -> None:
    shown = in_process("rigctl", "--version")
    assert (shown.returncode, shown.stdout, shown.stderr) == (0, f"rigctl {rigctl.__version__}\n", "")


def test_ctrl_c_ends_a_command_with_one_line(in_process: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(run, "load_rig_file", interrupt)
    done = in_process("rigctl", "check", "config/paper_rig.yaml")
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr == "rigctl: interrupted; the rig goes on by itself\n"


def test_ctrl_c_while_modules_are_loaded_is_one_line_too(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended, extras.refused("hil"):
        raise KeyboardInterrupt
    assert (ended.value.code, capsys.readouterr().err) == (1, "hil: interrupted\n")


@pytest.mark.parametrize("verb", ["", *(row.name for row in VERBS)])
def test_help_has_a_short_name_everywhere(in_process: Command, verb: str) -> None:
    words = [verb] if verb else []
    short, long = in_process("rigctl", *words, "-h"), in_process("rigctl", *words, "--help")
    assert short.returncode == 0
    assert short.stdout == long.stdout
    assert "Usage: " in short.stdout


def test_a_shell_completes_the_verbs() -> None:
    asked = {"_RIGCTL_COMPLETE": "complete_bash", "COMP_WORDS": "rigctl ta", "COMP_CWORD": "1"}
    command = [sys.executable, "-c", "import sys; sys.argv[0] = 'rigctl'; from rigctl.cli.app import main; main()"]
    done = subprocess.run(
        command, env={**os.environ, **asked}, capture_output=True, text=True, timeout=patience_s(), check=False
    )
    assert sorted(done.stdout.split()) == ["tare", "target"]


def test_the_table_of_commands_has_the_first_sentence_of_each() -> None:
    commands = typer.main.get_group(program()).commands
    assert [row.name for row in VERBS] == [*commands]
    for row in VERBS:
        words = " ".join((inspect.getdoc(commands[row.name].callback) or "").partition("\n\n")[0].split())
        assert row.line == re.split(r"(?<=\.) ", words)[0], row.name


def test_the_help_of_the_program_has_every_option_in_its_own_words(
    in_process: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    group = typer.main.get_command(program())
    monkeypatch.setenv("COLUMNS", "80")
    own = group.get_help(group.make_context("rigctl", ["hold"])).partition("Commands:")[0]
    shown = in_process("rigctl", "--help").stdout
    assert shown.partition(f"{next(iter(GROUPS))}:")[0] == own
    for row in VERBS:
        assert f"\n  {row.name} " in shown
        assert row.line in " ".join(shown.split())


@pytest.mark.parametrize("columns", ["20", "60", "300"])
def test_the_help_fits_the_terminal(monkeypatch: pytest.MonkeyPatch, columns: str) -> None:
    monkeypatch.setenv("COLUMNS", columns)
    commands = top_help().partition(f"{next(iter(GROUPS))}:")[2]
    assert max(len(line) for line in commands.splitlines()) <= min(max(int(columns) - 2, 40), 100)


@pytest.mark.parametrize(
    ("words", "first"),
    [
        (["hold", "--help"], "hold"),
        (["--key", "--help", "hold"], "hold"),
        (["--key=a", "-h", "hold"], "-h"),
        (["--version"], "--version"),
        (["--key"], ""),
        ([], ""),
    ],
)
def test_the_command_is_the_first_word_that_is_no_option_nor_its_value(words: list[str], first: str) -> None:
    assert first_word(words) == first


@pytest.mark.parametrize(
    "words",
    [
        ["hold"],
        ["hold", "--json"],
        ["hold", "--connect", "tcp/a:1", "--rig=one", "--operator", "kim", "--json", "--"],
        ["--key", "hold", "hold", "--connect=tls/a:1", "--operator=a=b"],
        ["hold", "--rig", "--json"],
        ["hold", "--help"],
        ["hold", "--rig", ""],
        ["hold", "--rig"],
        ["hold", "now"],
        ["hold", "--", "--json"],
        ["hold", "--key", "a"],
        ["hold", "--oper", "kim"],
        ["--json", "hold"],
    ],
)
def test_the_short_way_reads_a_hold_as_every_command_is_read(words: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """What typer accepts it reads to the same values, and what typer refuses or explains it leaves to typer."""
    monkeypatch.setenv("RIGCTL_KEY", "")
    found: list[HoldWords] = []

    def give(_verb: Verb, json: bool, connect: str | None, rig: str | None, operator: str | None) -> None:
        found.append(HoldWords(json, connect, rig, operator, os.environ["RIGCTL_KEY"] or None))

    monkeypatch.setattr("rigctl.cli.hold.give_and_end", give)
    typer_app.run("hold", words)
    assert read_words(words) == (found[0] if found else None)


LONG = ["check WORD", "keys list --dir WORD", "status --connect WORD", "WORD", "status --WORD", "tune WORD"]
LONG_OF_HIL = ["faults --only WORD", "serve WORD", "new rig WORD", "paper --json WORD", "WORD", "scenario WORD"]


@pytest.mark.parametrize("word", ["a" * 40_000, "a b " * 10_000], ids=["a word", "words"])
@pytest.mark.parametrize(
    ("program_", "line"), [*(("rigctl", line) for line in LONG), *(("hil", line) for line in LONG_OF_HIL)]
)
def test_a_long_name_is_cut_in_what_is_said_of_it(in_process: Command, program_: str, line: str, word: str) -> None:
    done = in_process(program_, *(part.replace("WORD", word) for part in line.split()))
    assert done.returncode in (1, 2)
    assert done.stdout == "" and 20 < len(done.stderr) < 3000
    assert done.stderr.count("\n") == 1


def test_a_folder_as_a_key_is_wrong_usage(in_process: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RIGCTL_KEY", "")
    done = in_process("rigctl", "--key", "tests", "status", "--connect", "tls/127.0.0.1:1")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == "rigctl: tests: found no plain file, expected a key file from rigctl keys add\n"
