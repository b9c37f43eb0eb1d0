"""The examples of README and docs/telemetry.md, unchanged, each in a process of its own on a real gateway."""

from __future__ import annotations

import json
import os
import pathlib
import re
import subprocess
import sys
from typing import Any

import pytest

from rigctl.wire.schema import schema
from tests.builders.miniature import Daemon
from tests.builders.paths import ROOT
from tests.builders.waiting import patience_s


def blocks(file: str, language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```$", (ROOT / file).read_text(), re.DOTALL | re.MULTILINE)


EXAMPLES = [example for file in ("README.md", "docs/telemetry.md") for example in blocks(file, "python")]


def test_the_first_of_three_only_reads() -> None:
    reads, commands, plain = EXAMPLES
    assert len(reads.splitlines()) <= 15
    assert "rigctl.client" in reads
    assert "operator" not in reads
    assert "operator" in commands
    assert "import rigctl" not in plain
    assert "zenoh.open" in plain


def ran(example: str, daemon: Daemon, folder: pathlib.Path) -> list[str]:
    """Lines printed by the example, in a process of its own that must end without an error or a warning."""
    script = folder / "example.py"
    script.write_text(example)
    where = {"RIGCTL_CONNECT": daemon.endpoint, "RIGCTL_RIG": daemon.settings.rig, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, str(script)], cwd=folder, env={**os.environ, **where},
        capture_output=True, text=True, timeout=patience_s(), check=False,
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout.splitlines()


@pytest.mark.parametrize("example", [EXAMPLES[0], EXAMPLES[2]], ids=["with our client", "without it"])
def test_reading_runs_as_it_stands_and_changes_nothing(own: Daemon, tmp_path: pathlib.Path, example: str) -> None:
    with own.rig() as rig:
        assert rig.take_lease("anna")["accepted"]
        before = rig.state()["target_n"]
        lines = ran(example, own, tmp_path)
        assert rig.state()["target_n"] == before
    counts = [int(found[1]) for line in lines if (found := re.match(r"(\d+) samples, mean (\d+\.\d\d) N$", line))]
    assert sum(counts) >= 1000
    if "rigctl.client" in example:
        assert lines[0] == "paper_rig DISARMED Ms 1"
        assert lines[-1] == "lost 0"


def test_commanding_runs_as_it_stands(own: Daemon, tmp_path: pathlib.Path) -> None:
    own.rig().close()
    assert ran(EXAMPLES[1], own, tmp_path) == ["accepted: TARGET: 290 N, DISARMED"]
    with own.rig() as rig:
        assert rig.state()["target_n"] == 290.0


def test_commanding_says_who_holds_the_lease(own: Daemon, tmp_path: pathlib.Path) -> None:
    with own.rig() as rig:
        assert rig.take_lease("anna")["accepted"]
    (line,) = ran(EXAMPLES[1], own, tmp_path)
    assert line.startswith("refused: ")
    assert "TARGET refused: anna (" in line  # and this user's name
    assert ") holds the lease" in line


def test_the_schema_in_the_documentation_is_the_one_served(shared: Daemon) -> None:
    (example,) = blocks("docs/telemetry.md", "json")
    with shared.rig() as rig:
        served = rig.schema()
    assert served == json.loads(json.dumps(schema("paper_rig")))
    assert_within(json.loads(example), served, "schema")


def assert_within(part: Any, whole: Any, where: str) -> None:
    """Check that ``part`` is contained in ``whole``: some keys of objects, some elements of lists."""
    if isinstance(part, dict):
        for key, value in part.items():
            assert key in whole, f"{where}.{key}"
            assert_within(value, whole[key], f"{where}.{key}")
    elif isinstance(part, list) and part and isinstance(part[0], dict):
        for value in part:
            (same,) = [one for one in whole if one["name"] == value["name"]]
            assert_within(value, same, f"{where}.{value['name']}")
    else:
        assert part == whole, where
