"""The units of ``deploy/`` as systemd judges them: no fault in them, and how little each service may do."""

from __future__ import annotations

import json
import pathlib
import re
import shutil
import subprocess
import sys
from collections.abc import Callable

import pytest

from rigctl.cli.install_files import STOP_SPARE_S, Host, of_rig, rig_drop_in
from rigctl.config import rig_file
from rigctl.control.power.ending import LIMIT_S, limit_s
from tests.builders.paths import ROOT

Command = Callable[..., "subprocess.CompletedProcess[str]"]
pytestmark = pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="needs systemd-analyze")
EXPOSURE = {
    "rigctl@": 2.0, "rigctl-gateway@": 2.0, "rigctl-recorder@": 1.0, "rigctl-page@": 1.5, "rigctl-sim@": 1.5,
}  # fmt: skip


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> pathlib.Path:
    """A root in which both rigs are installed, and what systemd-analyze looks for."""
    made = tmp_path_factory.mktemp("root")
    for name in ("paper_rig", "rig"):
        words = ["install", str(ROOT / f"config/{name}.yaml"), "--root", str(made)]
        subprocess.run([sys.executable, "-m", "rigctl", *words], check=True, capture_output=True, cwd=ROOT)
    return made


def analyze(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(["systemd-analyze", *words], capture_output=True, text=True, check=False)


def test_systemd_finds_no_fault_in_the_units(root: pathlib.Path) -> None:
    units = root / "etc/systemd/system"
    shutil.copytree("/lib/systemd/system", root / "lib/systemd/system", symlinks=True)
    for program in ("usr/lib/rigctl/bin/python3", "lib/systemd/systemd-networkd-wait-online"):
        (root / program).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy("/bin/true", root / program)
    names = [
        f"rigctl{kind}@{rig}.service"
        for kind in ("", "-page", "-sim", "-gateway", "-recorder")
        for rig in ("paper_rig", "rig")
    ]
    assert (units / "rigctl@rig.service.d/rig.conf").exists()
    result = analyze("verify", f"--root={root}", "--man=no", "--recursive-errors=yes", *names, "rigctl.slice")
    said = [line for line in result.stderr.splitlines() if "rigctl" in line]
    assert (result.returncode, said) == (0, []), result.stderr


@pytest.mark.parametrize("unit", EXPOSURE)
def test_what_a_service_is_exposed_to_is_limited(unit: str) -> None:
    file = str(ROOT / f"deploy/systemd/{unit}.service")
    allowed = f"--threshold={EXPOSURE[unit] * 10:.0f}"
    result = analyze("security", "--offline=true", "--no-pager", allowed, file)
    assert result.returncode == 0, result.stdout + result.stderr
    rows = json.loads(analyze("security", "--offline=true", "--json=short", file).stdout)
    assert rows


def test_users_and_folders_are_ones_that_systemd_can_make(root: pathlib.Path) -> None:
    made = subprocess.run(["systemd-sysusers", f"--root={root}"], capture_output=True, text=True, check=False)
    assert made.returncode == 0, made.stderr
    users = {line.split(":")[0] for line in (root / "etc/passwd").read_text().splitlines()}
    assert {"rigctl", "rigctl-gateway", "rigctl-recorder", "rigctl-page", "rigctl-sim"} <= users


def test_the_unit_gives_a_load_the_time_to_be_lowered() -> None:
    """``rigctl install`` adds a longer one for a rig that needs it."""
    lines = (ROOT / "deploy/systemd/rigctl@.service").read_text().splitlines()
    for name in ("TimeoutStopSec", "TimeoutAbortSec"):
        assert f"{name}={LIMIT_S + STOP_SPARE_S:.0f}" in lines
    paper = rig_file.load(ROOT / "config/paper_rig.yaml")
    soft = paper.model_copy(update={"plant": paper.plant.model_copy(update={"spring_n_mm": 2.0})})
    one, other = (
        of_rig(settings, Host(frozenset(range(4))), None)[rig_drop_in(settings.rig)].decode()
        for settings in (paper, soft)
    )
    assert "TimeoutStopSec" not in one
    longer = re.search(r"^TimeoutStopSec=(\d+)$", other, re.MULTILINE)
    assert longer is not None
    assert int(longer[1]) >= limit_s(soft) + STOP_SPARE_S > LIMIT_S + STOP_SPARE_S
