"""An empty option is refused: a script's variable that was never set must not choose the default rig."""

from __future__ import annotations

import subprocess
from collections.abc import Callable

import pytest

Command = Callable[..., "subprocess.CompletedProcess[str]"]


@pytest.mark.parametrize("option", ["--connect", "--rig", "--operator"])
@pytest.mark.parametrize("value", ["", " "])
def test_an_empty_option_is_refused_in_one_line(option: str, value: str, in_process: Command) -> None:
    answer = in_process("rigctl", "hold", option, value)
    assert (answer.returncode, answer.stdout) == (2, "")
    assert option in answer.stderr
    assert "found nothing, expected a value" in answer.stderr
    assert answer.stderr.count("\n") == 1


def test_so_is_one_of_a_command_that_only_looks(in_process: Command) -> None:
    for verb in ("status", "watch"):
        for option in ("--connect", "--rig"):
            assert in_process("rigctl", verb, option, "").returncode == 2
