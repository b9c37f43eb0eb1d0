"""Other gains in COMPENSATING: checked first, recorded, and put in force without a bump."""

from __future__ import annotations

import pathlib
from collections.abc import Iterator

import pytest
import yaml

from rigctl.config import rig_file as config
from rigctl.ipc import ledger
from rigctl.ipc.runtime_folder import ACTIVE, Runtime
from tests.builders import daemons
from tests.builders.operators import KIM
from tests.builders.waiting import until
from tests.live.system.test_daemon import PATIENT, Running


@pytest.fixture
def running(tmp_path: pathlib.Path) -> Iterator[Running]:
    file = daemons.rig_file(tmp_path, PATIENT)
    log = tmp_path / "daemon.log"
    with daemons.simulated_rig(file, tmp_path / "rig.log") as rig, daemons.daemon(file, log) as daemon:
        yield Running(file, daemon, rig, log)


def tuned(file: pathlib.Path, name: str, **changes: dict[str, float]) -> str:
    """A gain file for the rig of ``file`` with ``changes`` by section."""
    data = yaml.safe_load(file.read_text())
    for section, values in changes.items():
        data[section].update(values)
    other = file.with_name(f"{name}.rig.yaml")
    other.write_text(yaml.safe_dump(data))
    found = file.with_name(f"{name}.gains.yaml")
    daemons.rigctl("tune", str(other), "--gains", str(found))
    return str(found)


def test_gains_change_while_it_compensates_and_outlive_the_control_process(running: Running) -> None:
    file = running.file
    softer = tuned(file, "softer", design={"command_weight": 3.0})
    running.compensate()
    assert "limit 1.6" in (said := running.do("gains", softer, "--operator", "kim"))
    written = ledger.read(config.load(file))[-1]
    wanted = yaml.safe_load(pathlib.Path(softer).read_text())["gains"]
    assert (written.what, written.operator, written.after) == ("gains", KIM, wanted)
    assert f"{written.before['k_tension']:.4g} -> {wanted['k_tension']:.4g}" in said
    until(lambda: "softer.gains.yaml" in daemons.state(file)["design"])  # the state is renewed at intervals
    assert daemons.mode(file) == "COMPENSATING"
    runtime = Runtime.of(daemons.name_of(file))
    assert runtime.read_json(ACTIVE)["design"]["gains"] == wanted
    assert "gains changed" in running.log.read_text()

    refusals = {
        "plant.spring_n_mm was 8": tuned(file, "other_plant", plant={"spring_n_mm": 8.0}),
        "design refused: Ms": tuned(file, "too_hard", design={"stretch_weight": 2000.0, "ms_max": 9.0}),
        "provenance: found nothing": str(file),
    }
    for why, refused in refusals.items():
        assert why in running.refused("gains", refused)
    assert runtime.read_json(ACTIVE)["design"]["gains"] == wanted
    assert ledger.read(config.load(file))[-1] == written
