"""The deaths of recorder and gateway of a real daemon are alarms that stay until somebody has seen them."""

from __future__ import annotations

import json
import os
import pathlib
import signal
from typing import Any

import pytest

from rigctl.model.event_row import Priority
from tests.builders import daemons
from tests.builders.waiting import until


@pytest.mark.parametrize("process", ["recorder", "gateway"])
def test_a_death_is_an_alarm_that_is_acknowledged(tmp_path: pathlib.Path, process: str) -> None:
    file, log = daemons.slow_rig_file(tmp_path), tmp_path / "daemon.log"
    cause, module = f"{process.upper()}_ENDED", {"recorder": "rigctl.recorder"}.get(process, "gateway_process")

    def row() -> dict[str, Any] | None:
        """The row of the death; None while there is none, or no gateway that answers."""
        found = daemons.rigctl("alarms", "--json", file=file).stdout
        return next((row for row in json.loads(found or "[]") if row["cause"] == cause), None)

    with daemons.simulated_rig(file, tmp_path / "rig.log"), daemons.daemon(file, log):
        assert row() is None
        os.kill(daemons.process_with(module, daemons.name_of(file)), signal.SIGKILL)
        shown = until(lambda: (found := row()) and not found["stands"] and found, log=log)
        assert (shown["priority"], shown["count"]) == (Priority.LOW.name.lower(), 1)
        assert shown["text"].startswith(f"{process} process killed by signal 9; comes back in ")
        assert shown["remedy"]
        done = daemons.rigctl("alarms", "acknowledge", "--all", file=file)
        assert (done.returncode, cause in done.stdout) == (0, True)
        until(lambda: row() is None, log=log)
