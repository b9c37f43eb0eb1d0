"""A daemon with a gain file or a waived design: what it accepts, and what it shows an operator."""

from __future__ import annotations

import pathlib
import re
import subprocess
import sys
from typing import Any

import pytest

from hil.scenario.errors import ScenarioError
from hil.scenario.play import design
from rigctl.client.connection import Client
from rigctl.config.rig_file import load
from tests.builders import daemons
from tests.builders.paths import ROOT
from tests.builders.waiting import until
from tests.live.system.test_daemon import PATIENT

WAIVER = "demanding limit, for a test"


def tuned(folder: pathlib.Path, **changes: Any) -> tuple[pathlib.Path, pathlib.Path]:
    """A rig file that names its gain file, and the gain file."""
    file = daemons.rig_file(folder, {**PATIENT, "design": {"gains_file": "gains.yaml"}, **changes})
    answer = daemons.rigctl("tune", str(file), "--gains", str(folder / "gains.yaml"))
    assert answer.returncode in (0, 1), answer.stderr
    return file, folder / "gains.yaml"


def _active(file: pathlib.Path) -> dict[str, Any]:
    with Client(daemons.endpoint(file), daemons.name_of(file)) as client:
        return dict(client.active())


def test_a_daemon_runs_on_its_gain_file_and_shows_where_the_gains_come_from(tmp_path: pathlib.Path) -> None:
    file, gains = tuned(tmp_path)
    log = tmp_path / "daemon.log"
    with daemons.simulated_rig(file, tmp_path / "rig.log"), daemons.daemon(file, log):
        until(lambda: daemons.state(file).get("design"), log=log)
        shown = daemons.rigctl("status", "--all", file=file).stdout
        active = _active(file)["design"]
    assert "gains of gains.yaml, 20" in " ".join(shown.split())
    assert (active["waiver"], active["warnings"]) == (None, [])
    made = active["source"]["provenance"]
    assert made["inputs_sha256"] in gains.read_text()
    assert made["rig"] == daemons.name_of(file)


def _designing(pid: int) -> bool:
    """Whether a process has loaded libraries of the design."""
    return any(name in pathlib.Path(f"/proc/{pid}/maps").read_text() for name in ("/scipy/", "/matplotlib/"))


def test_a_second_start_reads_what_the_first_one_computed(tmp_path: pathlib.Path) -> None:
    file = daemons.rig_file(tmp_path, PATIENT)
    found = []
    for name in ("first", "second"):
        log = tmp_path / f"{name}.log"
        with daemons.simulated_rig(file, tmp_path / f"{name}_rig.log"), daemons.daemon(file, log) as child:
            until(lambda: daemons.state(file).get("design"), log=log)
            found.append((_designing(child.pid), _active(file)["design"]))
    assert load(file).kept_results.is_file()
    assert [designing for designing, _ in found] == [True, False]
    assert found[0][1] == found[1][1]


def test_status_shows_the_words_of_a_waiver(tmp_path: pathlib.Path) -> None:
    file = daemons.rig_file(tmp_path, {**PATIENT, "design": {"ms_max": 1.3, "waiver": WAIVER}})
    log = tmp_path / "daemon.log"
    with daemons.simulated_rig(file, tmp_path / "rig.log"), daemons.daemon(file, log):
        until(lambda: daemons.state(file).get("design"), log=log)
        shown = " ".join(daemons.rigctl("status", "--all", file=file).stdout.split())
        said = daemons.state(file)
    assert WAIVER in shown
    assert any(WAIVER in warning for warning in said["warnings"])
    assert re.fullmatch(r"Ms 1\.\d{3} over the assumed family of plants \(limit 1\.3, waived\)", said["design"])
    assert f"waived: {WAIVER}" in log.read_text()


def refused(file: pathlib.Path, code: int) -> str:
    answer = daemons.rigctl("run", str(file))
    assert answer.returncode == code, answer.stderr
    assert answer.stderr.count("\n") == 1
    return answer.stderr


def test_a_stale_gain_file_is_refused_before_anything_is_started(tmp_path: pathlib.Path) -> None:
    file, gains = tuned(tmp_path)
    file.write_text(file.read_text().replace("spring_n_mm: 6.0", "spring_n_mm: 13.0"))
    said = refused(file, 2)
    assert str(gains) in said
    assert "made for other settings (plant.spring_n_mm was 6, is 13): run `rigctl tune` again" in said
    with pytest.raises(ScenarioError, match="made for other settings"):
        design(load(file))
    # `rigctl tune` makes the file valid again.
    assert daemons.rigctl("tune", str(file), "--gains", str(gains)).returncode == 0
    assert design(load(file)).k_tension > 0.0


def test_a_gain_file_that_is_missing_or_corrupt_is_one_line(tmp_path: pathlib.Path) -> None:
    file, gains = tuned(tmp_path)
    gains.write_text("gains: [")
    assert f"{gains}:1: not YAML" in refused(file, 2)
    gains.unlink()
    assert f"{gains}: cannot be read: No such file" in refused(file, 2)


def test_edited_gains_that_are_not_robust_do_not_run(tmp_path: pathlib.Path) -> None:
    file, gains = tuned(tmp_path)
    lines = [line for line in gains.read_text().splitlines() if not line.startswith("seal: ")]
    gains.write_text("\n".join("  k_tension: 4.0" if "  k_tension" in line else line for line in lines))
    with daemons.simulated_rig(file, tmp_path / "rig.log"):
        said = refused(file, 1)
    assert "design refused" in said
    assert "edited by hand" in said
    with pytest.raises(ScenarioError, match="design refused"):
        design(load(file))


def test_the_control_process_imports_neither_design_nor_drawing() -> None:
    unwanted = "{'control', 'matplotlib', 'rigctl.design'}"
    look = f"import sys, rigctl.control.control_process; print(sorted({unwanted} & {{*sys.modules}}))"
    answer = subprocess.run([sys.executable, "-c", look], capture_output=True, text=True, check=True, cwd=ROOT)
    assert answer.stdout == "[]\n"
