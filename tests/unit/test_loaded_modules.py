"""What a command loads: a terminal answers only as fast as its imports (`python -m tests.bench terminal` measures)."""

from __future__ import annotations

import json
import os
import shutil
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator

import pytest

from rigctl.cli.verb_table import VERBS, VerbRow
from rigctl.config import layout
from rigctl.ipc.hold_socket import HoldAnswer, socket_name
from rigctl.ipc.runtime_folder import ACTIVE, Runtime
from tests.builders.daemons import free_port
from tests.builders.paths import ROOT
from tests.builders.waiting import patience_s

LOOK = """
import sys
from rigctl.cli.entry import main
sys.argv = ["rigctl", *{words!r}]
try:
    main()
except SystemExit as ended:
    import json
    sys.stderr.write("\\n" + json.dumps([ended.code or 0, sorted(sys.modules)]))
"""
SLOW = {"numpy", "zenoh", "pydantic", "pydantic_core", "scipy", "yaml", "rich", "asyncio", "cryptography", "can",
        "canopen", "cantools", "mcap", "google", "matplotlib", "numba", "control", "filterpy", "starlette",
        "hil"}  # fmt: skip
PARSERS = {"typer", "click", "argparse", "msgspec", "dataclasses", "inspect"}
STATUS_NEEDS = {"numpy", "zenoh", "asyncio", "pydantic", "pydantic_core", "rich"}  # typer loads pydantic
SHARED = {
    **dict.fromkeys(("arm", "tension", "release", "hold", "disarm", "reset", "carry", "lower", "brake-test", "move",
                     "target", "confirm-stroke", "tare",
                     "calibrate", "identify", "gains"), ("rigctl.cli.lease", "rigctl.cli.verbs")),
    **dict.fromkeys(("replay", "report"), ("rigctl.cli.recordings",)),
}  # fmt: skip
"""Other commands' modules that a command shares."""
OWN_OF_HOLD = {
    "rigctl", "rigctl.cli", "rigctl.cli.app", "rigctl.cli.descriptors", "rigctl.cli.entry", "rigctl.cli.operator_name",
    "rigctl.cli.quick_hold", "rigctl.ipc.standard_output",
    "rigctl.client", "rigctl.client.endpoint", "rigctl.client.local_daemons", "rigctl.client.local_hold",
    "rigctl.config", "rigctl.config.address", "rigctl.config.extras", "rigctl.config.input_file",
    "rigctl.config.layout", "rigctl.config.one_line", "rigctl.ipc", "rigctl.ipc.folder_places",
    "rigctl.ipc.hold_socket", "rigctl.ipc.termination", "rigctl.ipc.trusted_folders", "rigctl.ipc.writers",
    "rigctl.wire", "rigctl.wire.keys", "rigctl.wire.user_name",
}  # fmt: skip


def loaded(*words: str) -> tuple[int, str, set[str]]:
    """Exit code, what was printed, and every module that was loaded by a command in a fresh process."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("RIGCTL", "COV"))}
    done = subprocess.run(
        [sys.executable, "-c", LOOK.format(words=list(words))],
        cwd=ROOT, env=environment, capture_output=True, text=True, timeout=patience_s(), check=False,
    )  # fmt: skip
    code, modules = json.loads(done.stderr.splitlines()[-1])
    return code, done.stdout, set(modules)


def top(modules: set[str]) -> set[str]:
    return {name.partition(".")[0] for name in modules}


@pytest.fixture
def held() -> Iterator[str]:
    """The endpoint of a daemon of this computer whose loop is this test."""
    folder = layout.SHARED_MEMORY / f"rigctl-test_loaded_{os.getpid()}"
    folder.mkdir(mode=0o700)
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    files = Runtime(folder)
    files.write_json(ACTIVE, {"settings": {"rig": "test", "telemetry": {"listen": endpoint}}})
    (folder / "lock").write_text(f"{os.getpid()}\n")
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    listener.settimeout(patience_s())
    listener.bind(str(files.place(socket_name(os.geteuid()))))
    answering = threading.Thread(target=_answer, args=(listener,), daemon=True)
    answering.start()
    yield endpoint
    listener.close()
    answering.join(patience_s())
    shutil.rmtree(folder)


def _answer(listener: socket.socket) -> None:
    operator, address = listener.recvfrom(1024)
    assert operator == b"kim"
    listener.sendto(HoldAnswer(1, True, 0, 0, 0, 52.3, 300.0, "HOLD").packed(), address)


def test_help_loads_no_command_and_no_parser() -> None:
    code, shown, modules = loaded("--help")
    assert (code, shown.splitlines()[0]) == (0, "Usage: rigctl [OPTIONS] COMMAND [ARGS]...")
    assert not top(modules) & (SLOW | PARSERS)
    assert {name for name in modules if name.startswith("rigctl.")} == {
        "rigctl.cli", "rigctl.cli.app", "rigctl.cli.descriptors", "rigctl.cli.entry", "rigctl.ipc.standard_output",
        "rigctl.cli.top_help", "rigctl.cli.verb_table", "rigctl.config", "rigctl.config.extras",
        "rigctl.config.one_line", "rigctl.ipc", "rigctl.ipc.termination",
    }  # fmt: skip


def test_hold_loads_what_its_socket_needs(held: str) -> None:
    code, said, modules = loaded("hold", "--connect", held, "--operator", "kim")
    assert (code, said) == (0, "HOLD: stroke held at 52.30 mm, tension 300.0 N\n")
    assert not top(modules) & (SLOW | PARSERS)
    assert {name for name in modules if name.partition(".")[0] == "rigctl"} == OWN_OF_HOLD


def test_status_loads_the_client_and_nothing_of_the_daemon() -> None:
    code, _said, modules = loaded("status", "--connect", f"tcp/127.0.0.1:{free_port()}")
    assert code == 1
    assert not top(modules) & (SLOW - STATUS_NEEDS)
    folders = {name.split(".")[1] for name in modules if name.startswith("rigctl.")}
    assert folders <= {"cli", "client", "wire", "diagnosis", "identity", "ipc", "config", "control", "metrics", "model"}


@pytest.mark.parametrize("row", VERBS, ids=lambda row: row.name)
def test_a_command_loads_no_other_command(row: VerbRow) -> None:
    code, shown, modules = loaded(row.name, "--help")
    assert code == 0
    assert shown.startswith(f"Usage: rigctl {row.name} ")
    assert not top(modules) & {"zenoh", "scipy", "asyncio", "matplotlib", "numba", "control", "filterpy"}
    places = {f"rigctl.cli.{other.place.partition(':')[0]}" for other in VERBS} - {"rigctl.cli.run"}
    assert modules & places <= {f"rigctl.cli.{row.place.partition(':')[0]}", *SHARED.get(row.name, ())}


@pytest.mark.parametrize(
    "process", ["control.control_process", "gateway.gateway_process", "recorder.recorder_process", "supervisor.daemon"]
)
def test_a_process_of_the_daemon_begins_without_the_designs_libraries(process: str) -> None:
    """The control process never designs; the gateway has children that do, the supervisor what a start has kept."""
    look = f"import json, sys, rigctl.{process}; print(json.dumps(sorted(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", look], cwd=ROOT, capture_output=True, text=True, check=True)
    assert not top(set(json.loads(done.stdout))) & {"control", "filterpy", "matplotlib", "scipy", "PIL"}


WHEN_NUMPY_LOADS = """
import os, runpy, sys

class Look:
    def find_spec(self, name, path=None, target=None):
        if name == "numpy":
            sys.stderr.write("numpy with " + os.environ.get("OPENBLAS_NUM_THREADS", "no limit of") + " threads\\n")
        return None

sys.meta_path.insert(0, Look())
sys.argv = {words!r}
runpy.run_module(sys.argv[0], run_name="__main__")
"""


@pytest.mark.parametrize(
    "words", [("rigctl", "tune", "config/paper_rig.yaml"), ("hil", "compare", "--only", "nothing")], ids=" ".join
)
def test_a_program_limits_numpys_threads_before_it_loads_numpy(words: tuple[str, ...]) -> None:
    """On two cores the search of `hil compare --random` took four times as long with a thread for each core."""
    environment = {name: value for name, value in os.environ.items() if name != "OPENBLAS_NUM_THREADS"}
    done = subprocess.run(
        [sys.executable, "-c", WHEN_NUMPY_LOADS.format(words=list(words))],
        cwd=ROOT, env=environment, capture_output=True, text=True, timeout=patience_s(), check=False,
    )  # fmt: skip
    assert "numpy with 1 threads\n" in done.stderr


UNUSED = {"asammdf", "pandas", "pyarrow", "sympy", "lxml", "cryptography", "canmatrix", "matplotlib", "control",
          "filterpy", "zenoh", "cvxpy"}  # fmt: skip
"""What a process that locks its memory would keep resident without using it."""


@pytest.mark.parametrize(
    ("module", "more"),
    [("hil.serve", set()), ("hil.faults.served", set()), ("rigctl.control.control_process", {"numba", "scipy", "hil"})],
)
def test_a_process_with_locked_memory_loads_what_it_uses(module: str, more: set[str]) -> None:
    code = f"import json, sys, {module}; print(json.dumps([name for name in sys.modules if sys.modules[name]]))"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert not top(set(json.loads(done.stdout))) & (UNUSED | more)
