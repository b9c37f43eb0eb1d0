"""The examples of the README, as they stand there, each a process of its own against a real gateway."""

from __future__ import annotations

import json
import os
import pathlib
import re
import subprocess
import sys
from typing import Any

import pytest

from rigctl.telemetry.schema import schema
from tests.telemetry.miniature import PATIENCE_S, ROOT, Daemon


def blocks(file: str, language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```$", (ROOT / file).read_text(), re.DOTALL | re.MULTILINE)


EXAMPLES = blocks("README.md", "python")


def test_there_are_two_and_the_first_has_fifteen_lines() -> None:
    ours, plain = EXAMPLES
    assert len(ours.splitlines()) <= 15
    assert "rigctl.client" in ours
    assert "import rigctl" not in plain
    assert "zenoh.open" in plain


@pytest.mark.parametrize("example", EXAMPLES, ids=["with our client", "without it"])
def test_it_runs_as_it_stands(own: Daemon, tmp_path: pathlib.Path, example: str) -> None:
    own.rig().close()
    script = tmp_path / "example.py"
    script.write_text(example)
    where = {"RIGCTL_CONNECT": own.endpoint, "RIGCTL_RIG": own.settings.rig, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, str(script)], cwd=tmp_path, env={**os.environ, **where},
        capture_output=True, text=True, timeout=PATIENCE_S, check=False,
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")
    counts = [int(words[0]) for words in re.findall(r"^(\d+) samples, mean (\d+\.\d\d) N$", done.stdout, re.MULTILINE)]
    assert sum(counts) >= 1000
    if "rigctl.client" in example:
        lines = done.stdout.splitlines()
        assert lines[:3] == ["paper_rig DISARMED Ms 1", "TARGET: 290 N, DISARMED", "kim takes the lease"]
        assert lines[-1] == "lost 0"
        with own.rig() as rig:
            assert rig.state()["target_n"] == 290.0


def test_the_schema_in_the_documentation_is_the_one_served(shared: Daemon) -> None:
    (example,) = blocks("docs/telemetry.md", "json")
    with shared.rig() as rig:
        served = rig.schema()
    assert served == json.loads(json.dumps(schema("paper_rig")))
    assert_within(json.loads(example), served, "schema")


def assert_within(part: Any, whole: Any, where: str) -> None:
    """Whether all that ``part`` says is in ``whole``: of objects some keys, of lists some elements."""
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
