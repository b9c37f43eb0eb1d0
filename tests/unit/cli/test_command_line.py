"""Common options of every command line: its version, help by -h as by --help, and completion."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest
import typer

import rigctl
from rigctl.cli.app import app
from tests.conftest import Command

VERBS = sorted(typer.main.get_group(app).commands)


def test_it_says_its_version(in_process: Command) -> None:
    shown = in_process("rigctl", "--version")
    assert (shown.returncode, shown.stdout, shown.stderr) == (0, f"rigctl {rigctl.__version__}\n", "")


@pytest.mark.parametrize("verb", ["", *VERBS])
def test_help_has_a_short_name_everywhere(in_process: Command, verb: str) -> None:
    words = [verb] if verb else []
    short, long = in_process("rigctl", *words, "-h"), in_process("rigctl", *words, "--help")
    assert short.returncode == 0
    assert short.stdout == long.stdout
    assert "Usage: " in short.stdout


def test_a_shell_completes_the_verbs() -> None:
    asked = {"_RIGCTL_COMPLETE": "complete_bash", "COMP_WORDS": "rigctl ta", "COMP_CWORD": "1"}
    command = [sys.executable, "-c", "import sys; sys.argv[0] = 'rigctl'; from rigctl.cli.app import main; main()"]
    done = subprocess.run(command, env={**os.environ, **asked}, capture_output=True, text=True, timeout=60, check=False)
    assert done.stdout.split() == ["tare", "target"]
