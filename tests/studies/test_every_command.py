"""Every command of ``python -m hil`` with every option runs to its end; what ``--json`` prints is JSON.

The cases are held to the program's own catalogue. What takes minutes is replaced by its result, with numbers of numpy
and figures that are none, or played by the test named for it; the rest is played small.
"""

from __future__ import annotations

import json
import math
import pathlib
from collections.abc import Callable
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from hil.__main__ import app
from hil.cli import faults_hash, faults_ways_out, files
from hil.faults import gateway_kills, kills, lockstep_rows
from hil.faults.drawn import draw_file
from hil.faults.drawn.draw import block_of, pair_of
from hil.faults.gateway_kills import Figures
from hil.faults.judging.judge import FaultResult
from hil.faults.kills import Kill
from hil.studies.compare import front, random_rigs
from hil.studies.compare.front import FrontPoint
from hil.studies.compare.random_rigs import RigRow
from hil.studies.compare.rivals import OURS
from hil.studies.moves import repeated_moves
from hil.studies.moves.repeated_moves import MoveFigures, RepeatedResult
from hil.studies.roll_back import study as roll_back
from hil.studies.roll_back.study import Moved
from rigctl.config import rig_file
from tests.builders.every_option import documents, ended_well, untried
from tests.builders.paths import ROOT
from tests.conftest import Command

RIG = rig_file.load(ROOT / "config/paper_rig.yaml")
RUN = random_rigs.scenario()
ELSEWHERE = {
    "tests/studies/test_paper_study.py": ("paper", "--json", "--plots"),
    "tests/studies/test_compare.py": (
        "compare",
        "--only",
        "--controllers",
        "--json",
        "--plots",
        "--bound",
        "--shares",
        "--rows",
    ),
    "tests/live/hil/test_serve.py": ("serve", "--truth"),
    "tests/live/hil/test_inject.py": ("inject", "--for", "--end"),
    "tests/unit/hil/test_texts.py": ("faults", "--texts", "--against"),
}
"""By the test that plays them: a command and options."""
PAPER = "config/paper_rig.yaml"
SMALL = (
    f"compare {PAPER} --quick --only paper_k6 --controllers passive --json",
    "--help",
    "faults --list",
    f"inject {PAPER} --list --for-this-rig",
    f"fmu {PAPER} --out FOLDER/plant.fmu",
    "scenario config/scenarios/jolt.yaml --plot FOLDER/jolt.svg --json",
    f"faults {PAPER} --only cell_silent --mode HOLD --diagnosis FOLDER/windows --json",
    "new rig mine --payload 20 --spring 6 --target 200 --speed 10 --stroke 100 --rate 1000 --bit-rate 1000000 "
    "--cell-node 2 --inclinometer-node 3 --drive-node 4 --out FOLDER/mine --defaults",
    f"faults {PAPER} --draw 1 --seed 3 --only 0 --rows FOLDER/rows.jsonl --json",
    f"faults {PAPER} --replay FOLDER/draw.yaml --json",
)
"""Played as they are."""


def fault_rows(_rig: Any, rows: Any, _advance: Any) -> list[FaultResult]:
    return [
        FaultResult(
            fault.id, mode.name, "held", "held", np.float64(1.0), None, np.float32(2.0), math.nan, 0.0, 0.0,  # type: ignore[arg-type]
            np.bool_(True), "", (),  # type: ignore[arg-type]
        ) for fault, mode in rows
    ]  # fmt: skip


MOVED = Moved(np.float64(0.1), 0.1, 0.2, "HOLD")
Patches = list[tuple[Any, str, Callable[..., Any]]]
PLAYED: dict[str, tuple[list[str], Patches]] = {
    "cell": (["--cells", "1"], []),
    "faults": (["--only", "cell_silent", "--mode", "HOLD"], [(lockstep_rows, "play", fault_rows)]),
    "faults --kills": (
        ["--kills", "1"],
        [(kills, "play", lambda *_: [Kill("control", "SIGKILL", "HOLD", np.float64(0.1), math.nan, ())])],
    ),
    "faults --gateway-kills": (
        ["--gateway-kills", "1"],
        [(gateway_kills, "play", lambda *_: Figures(1, np.float64(1.0), np.float64(1.1), 0, 9, 0, False))],
    ),
    "roll-back": (
        ["--draw", "1", "--seed", "2"],
        [(roll_back, "study", lambda *_: dict.fromkeys(roll_back.cases(1, 1), MOVED))],
    ),
    "compare --random": (
        ["--random", "1", "--seed", "2", "--designs", "1"],
        [(random_rigs, "study", lambda *_: [
            RigRow(0, OURS, 6.0, None, np.float64(1.5), 0.01, 30.0, 1.0, 1.5, 0.02, 0.002, 30.0, "COMPENSATING")])],
    ),
}  # fmt: skip


MOVES = ("moves", "--only", "--json", "--plots")
FRONT = ("compare", "--front")
WHOLE_CATALOGUE = {
    faults_hash: f"faults {PAPER} --hash FOLDER/digests.json --all",
    faults_ways_out: f"faults {PAPER} --ways-out FOLDER/rows.jsonl --only cell_silent --mode HOLD",
}
"""By the module that plays it: minutes each; `test_digests` and `test_ways_out` play their parts."""


@pytest.mark.gate
def test_every_command_and_option_has_a_case() -> None:
    played = [[name.split()[0], *words, "--json"] for name, (words, _) in PLAYED.items()]
    as_lines = map(str.split, (*SMALL, *WHOLE_CATALOGUE.values()))
    assert untried(app, [*played, *as_lines, *ELSEWHERE.values(), MOVES, FRONT]) == []
    for file, (_, *options) in ELSEWHERE.items():
        text = (ROOT / file).read_text()
        assert all(f'"{option}"' in text for option in options), file


@pytest.mark.parametrize("case", SMALL)
def test_a_command_played_small(in_process: Command, tmp_path: pathlib.Path, case: str) -> None:
    if "draw.yaml" in case:
        drawn, _, _, course = block_of(RIG, 3, 0)
        draw_file.write(tmp_path / "draw.yaml", pair_of(3, 0, drawn, course), ())
    done = in_process("hil", *case.replace("FOLDER", str(tmp_path)).split())
    ended_well(done)
    if "--json" in case:
        assert documents(done.stdout)


@pytest.mark.parametrize("name", PLAYED)
def test_json_is_printed_in_place_of_the_words_or_written_beside_them(
    in_process: Command, monkeypatch: pytest.MonkeyPatch, tmp_path: pathlib.Path, name: str
) -> None:
    words, patches = PLAYED[name]
    for where, what, instead in patches:
        monkeypatch.setattr(where, what, instead)
    printed = in_process("hil", name.split(maxsplit=1)[0], *words, "--json")
    assert printed.returncode in (0, 1), printed.stderr
    found = json.loads(printed.stdout)
    file = tmp_path / "figures.json"
    if patches:  # the others are not played a second time
        written = in_process("hil", name.split(maxsplit=1)[0], *words, "--json", file)
        assert written.returncode == printed.returncode
        assert written.stdout and not written.stdout.startswith("{")
        assert json.loads(file.read_text()) == found


def test_json_of_the_moves(in_process: Command, monkeypatch: pytest.MonkeyPatch, tmp_path: pathlib.Path) -> None:
    chosen = repeated_moves.variants()[0]
    figures, t_s = MoveFigures(np.float64(1.0), np.float64(0.5)), np.arange(3.0)
    result = RepeatedResult((figures,) * chosen.moves, "COMPENSATING", t_s, (t_s,) * chosen.moves)
    found = dict.fromkeys(repeated_moves.pieces(RIG, [chosen]), result)
    monkeypatch.setattr(repeated_moves, "study", lambda *_: found)
    printed = in_process("hil", "moves", "--only", chosen.name, "--json", "--plots", tmp_path / "plots")
    ended_well(printed, (0,))
    assert json.loads(printed.stdout)


def test_the_front_is_drawn(in_process: Command, monkeypatch: pytest.MonkeyPatch, tmp_path: pathlib.Path) -> None:
    ours = [FrontPoint(OURS, limit, np.float64(1.5), 0.01, 0.4) for limit in (1.4, 1.6, None)]
    monkeypatch.setattr(front, "points", lambda *_: ours)
    ended_well(in_process("hil", "compare", "--front", tmp_path / "front.svg"), (0,))
    assert (tmp_path / "front.svg").exists()


@pytest.mark.parametrize("module", WHOLE_CATALOGUE, ids=lambda module: module.__name__.rpartition(".")[2])
def test_what_plays_the_whole_catalogue_gets_its_options(
    in_process: Command, monkeypatch: pytest.MonkeyPatch, tmp_path: pathlib.Path, module: ModuleType
) -> None:
    got = list[object]()

    def run(*arguments: object, **named: object) -> int:
        got.extend((*arguments, *named.values()))
        return 0

    monkeypatch.setattr(module, "run", run)
    words = WHOLE_CATALOGUE[module].replace("FOLDER", str(tmp_path)).split()
    ended_well(in_process("hil", *words), (0,))
    file = pathlib.Path(words[words.index("--hash" if "--hash" in words else "--ways-out") + 1])
    assert got[1] == file
    assert got[2:] == ([None, True] if "--hash" in words else [["cell_silent"], ["HOLD"]])


def test_figures_are_plain_whatever_made_them() -> None:
    found: dict[Any, object] = {
        "a": np.bool_(True),
        "b": np.int64(2),
        "c": (np.float32(0.5), math.inf),
        3: np.arange(2),
        "d": math.nan,
    }
    assert json.loads(files.json_text(found)) == {"a": True, "b": 2, "c": [0.5, None], "3": [0, 1], "d": None}


def test_a_rig_file_behind_json_is_not_overwritten(in_process: Command, tmp_path: pathlib.Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text("rig: mine\n")
    for program, name in (("hil", "faults"), ("rigctl", "demo")):
        done = in_process(program, name, "--json", file)
        assert done.returncode == 2
        assert f"--json: found {file}, expected a file for the figures" in done.stderr
    assert file.read_text() == "rig: mine\n"
