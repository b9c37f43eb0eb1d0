"""What each computer has to carry: the control process little, the rig's computer no compiler and no plots."""

from __future__ import annotations

import json
import pathlib
import re
import subprocess
import sys
import tomllib
from importlib.metadata import packages_distributions

import pytest

from rigctl.config.extras import EXTRAS, extra_of
from tests.builders.paths import ROOT
from tests.builders.waiting import patience_s

BLOCK = """
import sys
class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {absent!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)
sys.meta_path.insert(0, Absent())
"""
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
RUN = "import runpy; sys.argv = {argv!r}; runpy.run_module({module!r}, run_name='__main__', alter_sys=True)"
CONTROL_DISTRIBUTIONS = {
    "rigctl", "numpy", "pydantic", "pydantic_core", "annotated-types", "typing-inspection", "typing_extensions",
    "msgspec", "python-can", "wrapt", "canopen", "packaging",
}  # fmt: skip


def without(*extras: str, run: str) -> subprocess.CompletedProcess[str]:
    """A Python program on a computer that lacks these extras."""
    absent = set().union(*(EXTRAS[extra] for extra in extras))
    return subprocess.run(
        [sys.executable, "-c", BLOCK.format(absent=absent) + run],
        cwd=ROOT, capture_output=True, text=True, timeout=patience_s(), check=False,
    )  # fmt: skip


def named(requirements: list[str]) -> set[str]:
    return {re.split(r"[><=\[]", requirement)[0].lower() for requirement in requirements}


def test_every_extra_names_the_modules_it_brings() -> None:
    brings = packages_distributions()
    for extra, modules in EXTRAS.items():
        distributions = {brings[module][0].lower() for module in modules}
        assert named(PROJECT["optional-dependencies"][extra]) - {"rigctl"} == distributions
        assert all(extra_of(f"{module}.sub") == extra for module in modules)


def test_the_control_process_needs_no_extra_and_few_modules() -> None:
    run = (
        "import json, rigctl.control.control_process\n"
        "print(json.dumps(sorted(name for name, module in sys.modules.items() if module is not None)))"
    )  # fmt: skip
    answer = without("rt", "ops", "sim", run=run)
    assert answer.returncode == 0, answer.stderr
    modules = json.loads(answer.stdout)
    brings = packages_distributions()
    found = {brings[top][0] for top in {name.partition(".")[0] for name in modules} if top in brings}
    assert {name for name in found if not name.startswith("_")} <= CONTROL_DISTRIBUTIONS | {"setuptools"}
    # 449 when this was written, of the standard library, numpy and pydantic.
    assert len([name for name in modules if not name.startswith("rigctl")]) < 460


def test_the_client_needs_zenoh_msgspec_and_numpy_only() -> None:
    """A colleague reads live data without the daemon's libraries: each is out of reach here."""
    names = "connect, connect_async, rigs, Rig, AsyncRig, Samples, Stream, AsyncStream, AsyncSamples, Count"
    absent = set().union(*(EXTRAS[extra] for extra in EXTRAS if extra != "client")) | {"can", "canopen", "pydantic"}
    run = (
        f"from rigctl.client import {names}\n"
        "import rigctl.client\n"
        "try:\n    connect('tcp/127.0.0.1:1')\nexcept rigctl.client.NoDaemonError as error:\n    print(error)\n"
        "print(*sorted({name.partition('.')[0] for name, module in sys.modules.items() if module is not None}))"
    )
    answer = subprocess.run(
        [sys.executable, "-c", BLOCK.format(absent=absent) + run],
        cwd=ROOT, capture_output=True, text=True, timeout=patience_s(), check=False,
    )  # fmt: skip
    assert answer.returncode == 0, answer.stderr
    said, loaded = answer.stdout.splitlines()
    assert said.startswith("no daemon answers at tcp/127.0.0.1:1")
    brings = packages_distributions()
    found = {brings[top][0] for top in loaded.split() if top in brings}
    needed = {"rigctl", "numpy", "msgspec", "eclipse-zenoh"}
    assert needed <= found <= needed | {"cffi", "typing_extensions", "setuptools", "_distutils_hack", "coverage"}


@pytest.mark.parametrize("module", ["numba", "simple_pid", "pandas", "pytest", "jinja2", "pyarrow"])
def test_the_rigs_computer_carries_nothing_of_simulation_and_reports(module: str) -> None:
    assert extra_of(module) not in (None, "client", "rt")


@pytest.mark.parametrize(
    "module", ["supervisor.daemon", "control.control_process", "gateway.gateway_process",
               "recorder.recorder_process", "page.serve", "cli.app", "design.in_use", "operations.preflight"],
)  # fmt: skip
def test_the_rigs_computer_runs_without_reports_and_simulation(module: str) -> None:
    answer = without("ops", "sim", run=f"import rigctl.{module}")
    assert answer.returncode == 0, answer.stderr


def test_gains_are_designed_without_reports_and_simulation() -> None:
    run = (
        "from rigctl.config import rig_file\n"
        "from rigctl.design.in_use import design_in_use\n"
        "print(design_in_use(rig_file.load('config/rig.yaml')).accepted)"
    )
    answer = without("ops", "sim", run=run)
    assert (answer.returncode, answer.stdout) == (0, "True\n"), answer.stderr


def test_a_report_without_its_extra_is_one_line() -> None:
    run = "from rigctl.config.extras import refused\nwith refused('rigctl'):\n    import rigctl.report.page"
    answer = without("ops", "sim", run=run)
    said = "rigctl: needs the extra ops: found no jinja2 (pip install 'rigctl[ops]')\n"
    assert (answer.returncode, answer.stderr) == (2, said)


@pytest.mark.parametrize(
    ("extras", "module", "argv", "said"),
    [
        (("rt", "ops", "sim"), "rigctl", ["rigctl", "status"], "rigctl: needs the extra rt: found no typer"),
        (("rt", "ops", "sim"), "hil", ["hil", "serve", "x"], "python -m hil: needs the extra rt: found no typer"),
        (("sim",), "hil", ["hil", "serve", "x"], "python -m hil: needs the extra sim: found no numba"),
        (("sim",), "rigctl", ["rigctl", "demo", "--lockstep"], "rigctl: needs the extra sim: found no numba"),
        (
            ("studies",),
            "hil",
            ["hil", "compare", "--quick"],
            "python -m hil: needs the extra studies: found no simple_pid",
        ),
    ],
    ids=str,
)
def test_a_missing_extra_is_one_line(
    extras: tuple[str, ...], module: str, argv: list[str], said: str, tmp_path: pathlib.Path
) -> None:
    arguments = [part.format(tmp=tmp_path) for part in argv]
    answer = without(*extras, run=RUN.format(argv=arguments, module=module))
    assert answer.returncode == 2, answer.stderr
    lines = answer.stderr.splitlines()
    assert lines[-1].startswith(said)
    assert "Traceback" not in answer.stderr
