"""``python -m hil new rig`` as its user has it: from options, from questions on a terminal, and refused."""

from __future__ import annotations

import os
import pathlib
import pty
import re
import select
import subprocess
import sys
import time

import jsonschema
import msgspec
import pytest

from rigctl.config import rig_file, strict_yaml
from tests.builders import daemons
from tests.builders.paths import ROOT
from tests.builders.waiting import patience_s

ANSWERS = ("20", "-4", "a lot", "13", "", "", "")
"""Payload; two that are refused; spring; target, speed and stroke as they come."""
SCENARIO = """# yaml-language-server: $schema=schema/scenario.schema.json
scenario: bump
rig: {name}.yaml
duration_s: 2.0
disturbances:
  impacts:
    - {{kind: step, height_mm: 0.5, rise_s: 0.2, at_s: 0.5}}
"""


def hil(folder: pathlib.Path, *words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "hil", *words],
        cwd=folder, env={**os.environ, "PYTHONPATH": str(ROOT)}, stdin=subprocess.DEVNULL,
        capture_output=True, text=True, timeout=patience_s(), check=False,
    )  # fmt: skip


def new(folder: pathlib.Path, *words: str) -> subprocess.CompletedProcess[str]:
    return hil(folder, "new", "rig", *words)


def everything(folder: pathlib.Path) -> dict[str, bytes]:
    return {str(file.relative_to(folder)): file.read_bytes() for file in folder.rglob("*") if file.is_file()}


def fits_the_schema_it_names(file: pathlib.Path) -> bool:
    named = re.match(r"# yaml-language-server: \$schema=(\S+)\n", file.read_text())
    assert named is not None
    schema = msgspec.json.decode((file.parent / named[1]).read_bytes())
    jsonschema.validate(strict_yaml.read(file).data, schema)
    return True


def test_without_options_it_is_the_papers_rig_by_another_name(tmp_path: pathlib.Path) -> None:
    done = new(tmp_path, "bench_two")
    assert (done.returncode, done.stderr) == (0, "")
    made, paper = rig_file.load(tmp_path / "bench_two/bench_two.yaml"), rig_file.load(ROOT / "config/paper_rig.yaml")
    own = {"rig": "bench_two", "directory": str(tmp_path / "bench_two")}
    channel = paper.can.model_copy(update={"channel": "/tmp/rigctl-bench_two.sock"})
    assert made == paper.model_copy(update={**own, "can": channel})
    assert str(pathlib.Path("bench_two/bench_two.yaml")) in done.stdout


def test_a_rig_from_options_is_checked_and_plays_demo_and_scenario(tmp_path: pathlib.Path) -> None:
    words = ("--payload", "60", "--spring", "13", "--target", "550", "--speed", "15", "--out", "rigs/heavy")
    assert new(tmp_path, "heavy", *words).returncode == 0
    file = tmp_path / "rigs/heavy/heavy.yaml"
    settings = rig_file.load(file)
    assert (settings.plant.payload_kg, settings.plant.spring_n_mm) == (60.0, 13.0)
    assert (settings.tension.target_n, settings.tension.speed_max_mm_s) == (550.0, 15.0)
    assert settings.cylinder.stroke_max_mm >= 550.0 / settings.plant.stiffness_n_mm
    assert settings.safety.waiver is None
    assert settings.design.waiver is None
    assert {path.name for path in (file.parent / "eds").iterdir()} == {
        "tension_amplifier.eds", "inclinometer.eds", "cylinder_drive.eds", "simulator.eds",
    }  # fmt: skip
    assert fits_the_schema_it_names(file)
    checked = daemons.rigctl("check", str(file), "--json")
    assert checked.returncode == 0, checked.stderr
    assert msgspec.json.decode(checked.stdout)["waived_bounds"] == []
    played = daemons.rigctl("demo", str(file), "--lockstep", "--recordings", str(tmp_path / "recordings"))
    assert played.returncode == 0, played.stdout + played.stderr
    scenario = file.with_name("bump.yaml")
    scenario.write_text(SCENARIO.format(name="heavy"))
    assert fits_the_schema_it_names(scenario)
    assert hil(tmp_path, "scenario", str(scenario)).returncode == 0


@pytest.mark.parametrize(
    "words",
    [
        ("--payload", "2.7", "--spring", "0.85", "--speed", "8"),
        ("--payload", "8.2", "--spring", "0.81", "--speed", "16.4"),
        ("--spring", "3", "--speed", "40"),
        ("--target", "50"),
        ("--spring", "34"),
        ("--rate", "100"),
        ("--rate", "100", "--payload", "2.7", "--spring", "0.85", "--speed", "8"),
    ],
    ids=" ".join,
)
@pytest.mark.long
def test_rigs_far_from_the_papers_meet_the_demos_limits(tmp_path: pathlib.Path, words: tuple[str, ...]) -> None:
    done = new(tmp_path, "far", *words)
    assert done.returncode == 0, done.stderr
    file = str(tmp_path / "far/far.yaml")
    assert daemons.rigctl("check", file).returncode == 0
    played = daemons.rigctl("demo", file, "--lockstep", "--recordings", str(tmp_path / "recordings"))
    assert played.returncode == 0, played.stdout + played.stderr


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("Big Rig",), "NAME: found 'Big Rig', expected a to z, 0 to 9 and _, a letter first, 32 at most"),
        (("r", "--spring", "-6"), "--spring: found -6, expected a number in N/mm, above 0 to 10000"),
        (("r", "--spring", "0.5"), "--speed: found 10, expected at least 15 mm/s"),
        (("r", "--payload", "500", "--spring", "300"), "r: no gains for these decisions: the best found is Ms "),
        (("r", "--out", "taken"), "taken"),
        *(
            pytest.param(*row, marks=pytest.mark.long)
            for row in (
                (("../up",), "NAME: found '../up', expected"),
                (("r", "--payload", "nan"), "'--payload': found 'nan', expected a number of kg such as 290.5"),
                (("r", "--stroke", "inf"), "'--stroke': found 'inf', expected a number of mm such as 290.5"),
                (("r", "--stroke", "2001"), "--stroke: found 2001, expected a number in mm, -2000 to 2000"),
                (("r", "--spring", "six"), "hil: Invalid value for '--spring': "),
                (
                    ("r", "--target", "2000"),
                    "--target: found 2000, expected at most 324 N: 1.1 times the weight of 30 kg",
                ),
                (("r", "--stroke", "50"), "--stroke: found 50, expected at least 76 mm: a spring of 6 N/mm takes it"),
                (("r", "--speed", "200"), "r: these decisions ask for "),
                (("r", "--bit-rate", "250000"), "r: bus load 181."),
                (("r", "--bit-rate", "500000"), "above 80%: loop.rate_hz 500 makes it "),
                (("r", "--cell-node", "3"), "these decisions ask for inclinometer.node: found 3"),
                (("r", "--rate", "3"), "these decisions ask for loop.rate_hz: found 3"),
            )
        ),
    ],
)  # fmt: skip
def test_what_cannot_be_is_said_and_nothing_is_written(
    tmp_path: pathlib.Path, words: tuple[str, ...], says: str
) -> None:
    (tmp_path / "taken").write_text("a file, not a folder")
    done = new(tmp_path, *words)
    assert done.returncode == (1 if "taken" in words else 2), done.stderr
    assert says in done.stderr
    assert "Traceback" not in done.stderr
    assert everything(tmp_path) == {"taken": b"a file, not a folder"}


def test_the_bus_has_the_nodes_and_rates_that_were_chosen(tmp_path: pathlib.Path) -> None:
    words = [
        "--bit-rate",
        "500000",
        "--rate",
        "500",
        "--cell-node",
        "12",
        "--inclinometer-node",
        "13",
        "--drive-node",
        "14",
    ]
    done = new(tmp_path, "slow", *words)
    assert done.returncode == 0, done.stderr
    made = rig_file.load(tmp_path / "slow/slow.yaml")
    assert (made.loop.rate_hz, made.can.bitrate_bit_s) == (500, 500_000)
    assert (made.tension_cell.node, made.inclinometer.node, made.cylinder.node) == (12, 13, 14)
    checked = daemons.rigctl("check", str(tmp_path / "slow/slow.yaml"))
    assert checked.returncode == 0, checked.stderr


@pytest.mark.parametrize("rate_hz", [100, 200])
def test_limits_in_time_are_as_many_periods_of_a_slow_loop(tmp_path: pathlib.Path, rate_hz: int) -> None:
    done = new(tmp_path, "slow", "--rate", str(rate_hz))
    assert done.returncode == 0, done.stderr
    made = rig_file.load(tmp_path / "slow/slow.yaml")
    assert (made.loop.rate_hz, made.safety.waiver, made.can.interface) == (rate_hz, None, "rigsim")
    limits_ms = (made.safety.stale_ms, made.safety.bus_silent_ms, made.cylinder.command_deadline_ms)
    assert min(limits_ms) >= 5 * 1000 / rate_hz
    checked = daemons.rigctl("check", str(tmp_path / "slow/slow.yaml"))
    assert checked.returncode == 0, checked.stderr


def test_another_thing_than_a_rig_and_a_missing_name_are_wrong_usage(tmp_path: pathlib.Path) -> None:
    for words in (("new", "plant", "x"), ("new", "rig"), ("new",)):
        done = hil(tmp_path, *words)
        assert (done.returncode, len(done.stderr.splitlines())) == (2, 1)


def test_weights_that_the_paper_does_not_have_are_said(tmp_path: pathlib.Path) -> None:
    """A heavier payload on the assumed mechanisms needs weaker feedback."""
    done = new(tmp_path, "heavy", "--payload", "60")
    assert done.returncode == 0, done.stderr
    weights = re.findall(r"(design|estimator)\.(\w+) (\S+) instead of", done.stdout)
    assert weights
    settings = rig_file.load(tmp_path / "heavy/heavy.yaml")
    for section, key, value in weights:
        assert getattr(getattr(settings, section), key) == float(value)


def test_nothing_is_overwritten(tmp_path: pathlib.Path) -> None:
    assert new(tmp_path, "one", "--out", "rigs").returncode == 0
    before = everything(tmp_path)
    done = new(tmp_path, "one", "--out", "rigs", "--spring", "13")
    assert done.returncode == 2
    assert done.stderr == f"{pathlib.Path('rigs/one.yaml')}: found a file, expected none: nothing is overwritten\n"
    assert everything(tmp_path) == before
    assert new(tmp_path, "two", "--out", "rigs").returncode == 0  # beside it: the EDS files are the same
    changed = tmp_path / "rigs/eds/inclinometer.eds"
    changed.write_text(changed.read_text() + "\n; ours\n")
    before = everything(tmp_path)
    done = new(tmp_path, "three", "--out", "rigs")
    assert done.returncode == 2
    assert "eds/inclinometer.eds: found another file than the one shipped" in done.stderr
    assert everything(tmp_path) == before


def test_a_folder_that_cannot_be_written_leaves_nothing_behind(tmp_path: pathlib.Path) -> None:
    """The folder for the schemas is a link to nowhere: the EDS files, written before, go again with their folder."""
    (tmp_path / "rigs").mkdir()
    (tmp_path / "rigs/schema").symlink_to(tmp_path / "nowhere/at/all")
    done = new(tmp_path, "one", "--out", "rigs")
    assert done.returncode == 1
    assert len(done.stderr.splitlines()) == 1
    assert list((tmp_path / "rigs").iterdir()) == [tmp_path / "rigs/schema"]


# -- questions ------------------------------------------------------------------------------------------------------
class Terminal:
    """A command on a pseudo-terminal of its own."""

    def __init__(self, folder: pathlib.Path, *words: str) -> None:
        self.said = ""
        self._ours, theirs = pty.openpty()
        self._process = subprocess.Popen(
            [sys.executable, "-m", "hil", "new", "rig", *words],
            cwd=folder, env={**os.environ, "PYTHONPATH": str(ROOT)},
            preexec_fn=lambda: os.login_tty(theirs),  # noqa: PLW1509 - Ctrl-C is a signal on it only as a controlling terminal
        )  # fmt: skip
        os.close(theirs)

    def wait_for(self, text: str, *, times: int = 1) -> None:
        until = time.monotonic() + patience_s()
        while self.said.count(text) < times:
            assert time.monotonic() < until, self.said
            self._read()

    def answer(self, text: str) -> None:
        os.write(self._ours, text.encode())

    def end(self) -> int:
        until = time.monotonic() + patience_s()
        while self._read():
            assert time.monotonic() < until, self.said
        os.close(self._ours)
        return self._process.wait(patience_s())

    def _read(self) -> bool:
        if not select.select([self._ours], [], [], 1.0)[0]:
            return True
        try:
            data = os.read(self._ours, 4096)
        except OSError:  # the other end is closed
            return False
        self.said += data.decode().replace("\r\n", "\n")
        return bool(data)


def test_on_a_terminal_it_asks_for_each_number_and_again_after_a_wrong_answer(tmp_path: pathlib.Path) -> None:
    terminal = Terminal(tmp_path, "asked")
    for count, answer in enumerate(ANSWERS, 1):
        terminal.wait_for("]: ", times=count)
        terminal.answer(f"{answer}\n")
    assert terminal.end() == 0, terminal.said
    assert "suspended mass (a number in kg, 0.1 to 1000) [30]: 20\n" in terminal.said
    assert "--spring: found -4, expected a number in N/mm, above 0 to 10000\n" in terminal.said
    assert "--spring: found 'a lot', expected a number of N/mm such as 290.5\n" in terminal.said
    assert "vertical tension to hold (a number in N, 1 to 10000) [200]: \n" in terminal.said
    settings = rig_file.load(tmp_path / "asked/asked.yaml")
    assert (settings.plant.payload_kg, settings.plant.spring_n_mm, settings.tension.target_n) == (20.0, 13.0, 200.0)


def test_what_an_option_says_is_not_asked(tmp_path: pathlib.Path) -> None:
    terminal = Terminal(tmp_path, "few", "--payload", "25", "--spring", "7", "--speed", "8", "--stroke", "130")
    terminal.wait_for("]: ")
    terminal.answer("\n")
    assert terminal.end() == 0, terminal.said
    assert terminal.said.count("]: ") == 1
    assert rig_file.load(tmp_path / "few/few.yaml").tension.target_n == 250.0
    assert Terminal(tmp_path, "none", "--defaults").end() == 0
    assert (tmp_path / "none/none.yaml").is_file()


@pytest.mark.parametrize("key", ["\x03", "\x04"], ids=["Ctrl-C", "Ctrl-D"])
def test_questions_that_are_not_answered_leave_nothing_behind(tmp_path: pathlib.Path, key: str) -> None:
    terminal = Terminal(tmp_path, "asked")
    terminal.wait_for("]: ")
    terminal.answer(key)
    assert terminal.end() == 1
    assert terminal.said.endswith("hil: interrupted\n")
    assert "Traceback" not in terminal.said
    assert everything(tmp_path) == {}
