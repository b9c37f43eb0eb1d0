"""HOLD on the local socket while a peer floods the daemon, and while the gateway hangs or is gone: none is lost."""

from __future__ import annotations

import json
import os
import pathlib
import signal
from collections.abc import Iterator

import numpy as np
import pytest

from rigctl.client import local_hold
from rigctl.ipc.runtime_folder import Runtime
from rigctl.model.states import Mode
from tests.bench.flood import TLS_KINDS, flooding
from tests.bench.holds import Subject, hung
from tests.builders import daemons
from tests.builders.operators import KIM, USER
from tests.builders.waiting import until
from tests.live.system.test_daemon import PATIENT

HOLDS, FLOOD_S = 20, 60.0
LONG = {"idle_sessions": pytest.mark.long}  # a minute until all of them have been opened
pytestmark = pytest.mark.alone


@pytest.fixture(scope="module", params=[pytest.param("tcp", marks=pytest.mark.long), "tls"])
def file(tmp_path_factory: pytest.TempPathFactory, request: pytest.FixtureRequest) -> Iterator[pathlib.Path]:
    """A rig file whose daemon is armed; without certificates, and with them."""
    folder = tmp_path_factory.mktemp("flood")
    found = daemons.rig_file(folder, PATIENT)
    if request.param == "tls":
        daemons.with_certificates(found)
    with daemons.simulated_rig(found, folder / "rig.log"), daemons.daemon(found, folder / "daemon.log"):
        armed = daemons.rigctl("arm", file=found)
        assert armed.returncode == 0, armed.stderr
        yield found


@pytest.mark.parametrize("kind", [pytest.param(kind, marks=LONG.get(kind, ())) for kind in TLS_KINDS])
def test_every_hold_is_answered_and_in_the_record(file: pathlib.Path, kind: str) -> None:
    rig = Subject(file)
    records = Runtime.of(rig.rig).records.reader(from_start=True)
    with flooding(kind, rig.endpoint, rig.rig, FLOOD_S, rig.floods_key):
        last = records.read()[-1:]
        for _ in range(HOLDS):
            answer = local_hold.hold(rig.endpoint, rig.rig, "kim")
            assert answer is not None
            assert (answer["accepted"], answer["mode"], answer["via"]) == (True, "HOLD", "local socket")
            taken = np.concatenate([last, records.read()])
            last = taken[-1:]
            (at,) = np.flatnonzero(taken["t_ns"] == answer["t_ns"])
            assert taken["mode"][at] == Mode.HOLD
            assert taken["hold_seq"][at] == taken["hold_seq"][at - 1] + 1, "taken in this tick; others may hold too"


def test_rigctl_hold_needs_no_gateway_that_answers(file: pathlib.Path) -> None:
    rig = Subject(file)
    with hung(rig):
        held = daemons.rigctl("hold", "--json", file=file)
        assert json.loads(held.stdout)["via"] == "local socket", held.stderr
    os.kill(rig.gateway(), signal.SIGKILL)
    held = daemons.rigctl("hold", "--json", file=file)
    assert json.loads(held.stdout)["via"] == "local socket", held.stderr


def test_the_audit_log_names_who_held_and_how(file: pathlib.Path) -> None:
    shown = daemons.rigctl("hold", "--json", file=file)
    assert json.loads(shown.stdout)["accepted"]
    log = file.parent / "audit" / f"{daemons.name_of(file)}.jsonl"
    want = f"via the local socket, from process {{}} of {USER}".split("{}")

    def entered() -> bool:
        lines = [json.loads(line) for line in log.read_text().splitlines()]
        return any(
            line["what"] == "local_hold_given" and line["who"] == KIM and all(part in line["text"] for part in want)
            for line in lines
        )

    assert until(entered)
