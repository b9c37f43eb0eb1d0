"""Every command of ``rigctl`` with every option of its own runs to its end; what ``--json`` prints is JSON.

The cases are held to the program's own catalogue: an option without a case fails the test.
"""

from __future__ import annotations

import json
import pathlib
import signal
import subprocess
import sys
from collections.abc import Iterator
from datetime import UTC, datetime

import pytest

from rigctl.cli.typer_app import program
from rigctl.config.rig_file import load
from rigctl.identity.issuing import KeyIssuer
from rigctl.identity.key_folder import KeyFolder
from rigctl.identity.roles import Role
from rigctl.ipc import ledger
from rigctl.model.states import Mode
from rigctl.recorder.chain import ORIGIN, AuditEntry, line_of
from tests.builders import daemons
from tests.builders.every_option import documents, ended_well, spellings, untried
from tests.builders.identifications import response
from tests.builders.miniature import Daemon, running
from tests.builders.paths import ROOT
from tests.builders.synthetic import compensating, no_error, write
from tests.builders.waiting import patience_s, until

KNOWN = {"PAPER": "config/paper_rig.yaml", "IDLE": "127.0.0.1:0"}
# FOLDER: of the test; RIG, LEDGER, KEYS, KEY, LOG, HEAD, PART, RUN, INSTALLED: what the fixture `made` has prepared.
OFFLINE = (
    "--version", "--help", "check PAPER", "check RIG --json",
    "tune RIG --json", "tune RIG --auto",
    "tune RIG --plot FOLDER/m.svg --gains FOLDER/gains.yaml --json FOLDER/tune.json",
    "tune RIG --optimize --seed 2 --evaluations 50 --json -",
    "tune RIG --from LEDGER --table --json",
    "tune RIG --from LEDGER --every-spring --gains FOLDER/gains.yaml",
    "keys init --dir FOLDER/new --host gate.example --days 30 --json",
    "keys add lee --dir KEYS --role operator --json",
    "keys renew kim --dir KEYS --json", "keys list --dir KEYS --json",
    "keys revoke kim --dir KEYS --json",
    "info PART", "info PART --run --json", "runs RIG --json",
    "report PART -o FOLDER/report.html --picture FOLDER/run.svg --part --article twelve --test cold --json",
    "export PART --to csv -o FOLDER/csv --run",
    "replay RUN --json", "replay RUN --against RIG --plot FOLDER/replay.svg --json",
    "audit verify LOG --head HEAD --json",
    "audit show LOG --last 2 --since 2025-01-01T00:00:00Z --what trip --who kim --json",
    "install config/rig.yaml --dry-run --root FOLDER/root --adapter A1 --operator root --viewer root --start",
    "install config/rig.yaml --root FOLDER/root --no-start",
    "uninstall rig --root INSTALLED --dry-run", "uninstall rig --root INSTALLED --dry-run --leave-load",
    "bridge plotjuggler --layout -", "bridge foxglove --layout FOLDER/layout.json",
    "page --link --listen 127.0.0.1:9",
    "bench PAPER --seconds 1 --rate 500 --json",
)  # fmt: skip
DEMO = "demo RIG --lockstep --recordings FOLDER --json -"
COMMANDED = (
    "status --all", "alarms", "alarms acknowledge --all", "doctor PAPER", "lease take --reason mine", "lease show",
    "arm --near-end", "note words",
    "tension --wait", "calibrate --weight-n 294.2 --adopt", "target 290", "move 1", "release --wait", "hold",
    "disarm", "reset", "carry 5 --by encoder", "lower --by cell", "brake-test --supported", "confirm-stroke 0", "tare",
    "calibrate --shunt", "identify --in tension",
    "gains PAPER", "--key FOLDER/none.pem status",
)  # fmt: skip
"""In this order, so that no weight is adopted. With every option that they have in common, see `full`."""
FIRST = (
    "identify --response --in compensating --plot FOLDER/response.svg --file FOLDER/found.json", "calibrate --creep 5",
)  # fmt: skip
SHELVED = "alarms shelve CAUSE --reason seen --for 1"
UNTIL_CTRL_C = (
    "watch", "watch --json", "bridge foxglove --listen IDLE --rate 10 --origin http://a.example",
    "bridge prometheus --listen IDLE", "page --listen IDLE --operator kim --sign-in",
    "page --listen IDLE --operator kim --remote-operator --tls-cert KEY --tls-key KEY",
)  # fmt: skip
RUN = ("run RIG --page --page-listen IDLE", "run RIG --no-page --separate-users")
SHARED = {"--connect": "ENDPOINT", "--rig": "paper_rig", "--operator": "kim", "--json": ""}


def full(case: str) -> list[str]:
    """The words of a case, with the options that commands to a daemon share."""
    words = case.split()
    has = {spelling[0] for spelling in spellings(program()).get(words[0], [])}
    more = [f"{option} {value}" for option, value in SHARED.items() if option in has and option not in words]
    return [*words, *" ".join(more).split()]


def test_every_command_and_option_has_a_case() -> None:
    alone = [case.split() for case in (*OFFLINE, DEMO, *RUN)]
    assert untried(program(), [*alone, *map(full, (*COMMANDED, *FIRST, SHELVED, *UNTIL_CTRL_C))]) == []


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """What the cases read: a rig file with its ledger, keys, an audit log, a part, a run and an installed rig."""
    folder = tmp_path_factory.mktemp("made")
    rig = daemons.rig_file(folder, {"demo": {"angle_deg": 2.0}, "design": {"identify_days": 3650}})
    settings = load(rig)
    ledger.append(settings, response(settings, 2.0, 300.0))
    issuer = KeyIssuer(folder / "keys", datetime.now(UTC))
    issuer.init(["gate.example"])
    issuer.add("kim", Role.OPERATOR)
    wall, head, lines = "2025-01-01T00:00:00.000Z", ORIGIN, []
    for n, what in enumerate(("started", "trip"), 1):
        line, head = line_of(AuditEntry(n, "rig", wall, n, what, "kim", "", {}, "events", n, {}, head))
        lines.append(line)
    (folder / "log.jsonl").write_bytes(b"".join(lines))
    write(folder / "part.mcap", compensating(no_error))
    found = {
        "RIG": rig, "LEDGER": settings.ledger, "KEYS": folder / "keys", "LOG": folder / "log.jsonl", "HEAD": head,
        "KEY": KeyFolder(folder / "keys").gateway, "PART": folder / "part.mcap",
        "RUN": folder / "runs" / "*", "INSTALLED": folder / "root",
    }  # fmt: skip
    known = {name: str(value) for name, value in found.items()}
    (folder / "runs").mkdir()
    demo = rigctl(DEMO.split(), known, folder / "runs")
    assert documents(demo.stdout)
    ended_well(demo, (0,), words=True)
    ended_well(rigctl(["install", "config/rig.yaml", "--root", "INSTALLED", "--no-start"], known, folder), (0,))
    return known | {"RUN": str(next((folder / "runs").glob("*.mcap")))}


def filled(words: list[str], known: dict[str, str], folder: pathlib.Path) -> list[str]:
    return [(KNOWN | known).get(word, word).replace("FOLDER", str(folder)) for word in words]


def rigctl(
    words: list[str], known: dict[str, str], folder: pathlib.Path, env: dict[str, str] | None = None
) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "rigctl", *filled(words, known, folder)], cwd=ROOT, env=env, capture_output=True,
        text=True, stdin=subprocess.DEVNULL, timeout=patience_s(), check=False,
    )  # fmt: skip


@pytest.mark.parametrize("case", OFFLINE)
def test_a_command_without_a_daemon(case: str, made: dict[str, str], tmp_path: pathlib.Path) -> None:
    done = rigctl(case.split(), made, tmp_path)
    ended_well(done)
    if "--json" in case:
        written = tmp_path / "tune.json"
        shown = documents(written.read_text() if written.exists() else done.stdout)
        # A bench gives way to a daemon, such as another test's, and says so.
        assert shown or (case.startswith("bench") and done.returncode == 1 and "bench: a daemon runs" in done.stderr)


@pytest.fixture(scope="module")
def rig() -> Iterator[Daemon]:
    for found in running():
        found.client().close()
        yield found


@pytest.mark.parametrize("case", COMMANDED)
def test_a_command_to_a_daemon(rig: Daemon, case: str, tmp_path: pathlib.Path) -> None:
    words = full(case)
    done = rigctl(words, {"ENDPOINT": rig.endpoint}, tmp_path, rig.environment())
    ended_well(done)
    if "--json" in words:
        (found,) = documents(done.stdout)
        if words[0] not in ("status", "alarms", "doctor") and case != "lease show":
            assert found["accepted"] is (done.returncode == 0)
            assert found["text"]


def test_an_alarm_is_shelved(rig: Daemon, tmp_path: pathlib.Path) -> None:
    known, env = {"ENDPOINT": rig.endpoint}, rig.environment()
    for case in ("lease take", "arm", "tension --wait", "target 222"):
        rigctl(full(case), known, tmp_path, env)
    rows = until(lambda: json.loads(rigctl(full("alarms"), known, tmp_path, env).stdout), "an alarm")
    ended_well(rigctl(full(SHELVED), known | {"CAUSE": rows[0]["cause"]}, tmp_path, env), (0,))


@pytest.mark.parametrize("case", UNTIL_CTRL_C)
def test_a_command_until_ctrl_c(rig: Daemon, made: dict[str, str], case: str, tmp_path: pathlib.Path) -> None:
    words = filled(full(case), made | {"ENDPOINT": rig.endpoint}, tmp_path)
    process = begun(rig, words)
    assert process.stdout is not None
    first = process.stdout.readline()
    done = interrupted(process)
    ended_well(done)
    assert first, done.stderr
    if "--json" in words:
        assert json.loads(first)["mode"] in Mode.__members__


@pytest.mark.parametrize("case", FIRST)
def test_a_command_to_a_daemon_that_has_just_started(own: Daemon, case: str, tmp_path: pathlib.Path) -> None:
    own.client().close()
    done = rigctl(full(case), {"ENDPOINT": own.endpoint}, tmp_path, own.environment())
    ended_well(done)
    assert documents(done.stdout)[0]["text"]


def begun(rig: Daemon, words: list[str]) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "rigctl", *words], cwd=ROOT, env=rig.environment(), stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


def interrupted(process: subprocess.Popen[str]) -> subprocess.CompletedProcess[str]:
    process.send_signal(signal.SIGINT)
    output, complaints = process.communicate(timeout=patience_s())
    return subprocess.CompletedProcess(process.args, process.returncode, output, complaints)


@pytest.mark.parametrize("case", RUN)
def test_the_daemon_until_ctrl_c(case: str, tmp_path: pathlib.Path) -> None:
    rig, out, err = daemons.slow_rig_file(tmp_path), tmp_path / "out", tmp_path / "err"
    words = filled(case.split(), {"RIG": str(rig)}, tmp_path)
    with daemons.simulated_rig(rig, tmp_path / "served.log"), out.open("wb") as stdout, err.open("wb") as stderr:
        process = subprocess.Popen([sys.executable, "-m", "rigctl", *words], cwd=ROOT, stdout=stdout, stderr=stderr)
        until(lambda: process.poll() is not None or b"DISARMED" in out.read_bytes(), "the loop")
        process.send_signal(signal.SIGINT)
        code = process.wait(patience_s())
    ended_well(subprocess.CompletedProcess(words, code, out.read_text(), err.read_text()), (0,))
