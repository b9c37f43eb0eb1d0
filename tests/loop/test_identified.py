"""From the ledger to the loop: identified, tuned for, adopted at the start, and run on the rig as built."""

from __future__ import annotations

import pathlib
import subprocess
from collections.abc import Callable
from datetime import UTC, datetime

import numpy as np
import pytest
import yaml

from hil.lockstep import lockstep
from hil.operated_rig import arm_and_tension
from hil.studies.compare.measured_ms import measured
from rigctl.config.rig_file import load
from rigctl.config.settings import RigSettings
from rigctl.control.law.gain_table import ScheduledGains
from rigctl.design.in_use import adopted, design_in_use
from rigctl.ipc import ledger
from rigctl.ipc.ledger import Entry
from rigctl.model.events import Kind
from rigctl.model.states import Mode
from rigctl.model.verbs import Refusal, Verb
from tests.builders import daemons
from tests.builders.identifications import NOON_NS, response

Command = Callable[..., "subprocess.CompletedProcess[str]"]
NOW = datetime.fromtimestamp(NOON_NS / 1e9, UTC)
STIFFER, QUICKER, LATER = 1.15, 0.85, 1.5
"""The rig as built, over what its file says."""


def rig_as_built(folder: pathlib.Path) -> pathlib.Path:
    file = daemons.rig_file(folder, {"design": {"gains_file": "gains.yaml", "identify_days": 3650}}, rig="built")
    data = yaml.safe_load(file.read_text())
    data["simulation"] |= {"stiffness_scale": STIFFER, "lag_scale": QUICKER, "delay_scale": LATER}
    file.write_text(yaml.safe_dump(data))
    return file


def found(settings: RigSettings, tension_n: float, share: float = 1.0) -> Entry:
    """What `rigctl identify --response` finds at a tension: the truth, the rope ``share`` as stiff there."""
    plant = settings.plant
    return response(
        settings,
        2.0,
        tension_n,
        plant={
            "stiffness_n_mm": {"value": share * STIFFER * plant.stiffness_n_mm, "error": 0.02},
            "lag_s": {"value": QUICKER * plant.cylinder_lag_s, "error": 0.0002},
            "delay_s": {"value": LATER * plant.command_delay_s, "error": 0.0001},
            "sensor_delay_s": {"value": 0.0003, "error": 0.0001},
        },
    )


def test_an_identified_rig_starts_with_the_design_for_its_plant_and_holds_the_tension(
    tmp_path: pathlib.Path, in_process: Command
) -> None:
    file = rig_as_built(tmp_path)
    settings = load(file)
    ledger.append(settings, found(settings, 300.0))
    gains = file.with_name("gains.yaml")
    answer = in_process("rigctl", "tune", file, "--from", settings.ledger, "--gains", gains)
    assert answer.returncode == 0, answer.stderr
    used, design = adopted(settings, NOW), design_in_use(settings, NOW)
    assert used.plant.cylinder_lag_s == QUICKER * settings.plant.cylinder_lag_s
    assert design.family == "identified 2026-10-30"
    with lockstep(used, design.gains, built=settings) as rig:
        rig.run(0.2)
        arm_and_tension(rig, limit_s=20.0, settle_s=2.0)
        records = rig.run(3.0)
        assert rig.loop.machine.mode is Mode.COMPENSATING
        # The filter believes the plant as built: its innovations are the cell's noise and no more.
        assert 0.65 < rig.record["tension_nis"] < 1.3  # the walk of the tension is a weight, larger than what is there
        assert abs(float(np.mean(records["tension_n"])) - 300.0) < 0.05


@pytest.mark.study
def test_ms_of_the_design_for_an_identified_plant_is_within_the_limit_on_the_rig_as_built(
    tmp_path: pathlib.Path, in_process: Command
) -> None:
    settings = load(rig_as_built(tmp_path))
    ledger.append(settings, found(settings, 300.0))
    words = "tune", tmp_path / "rig.yaml", "--from", settings.ledger, "--gains", tmp_path / "gains.yaml"
    assert in_process("rigctl", *words).returncode == 0
    peak = measured(settings, adopted(settings, NOW), design_in_use(settings, NOW).gains)
    assert peak.error < 0.05
    assert peak.ms + peak.error <= settings.design.ms_max


def test_a_gain_table_follows_the_tension_without_a_bump(tmp_path: pathlib.Path, in_process: Command) -> None:
    file = rig_as_built(tmp_path)
    settings = load(file)
    for entry in (found(settings, 300.0), found(settings, 240.0, 0.9)):
        ledger.append(settings, entry)
    gains = file.with_name("gains.yaml")
    answer = in_process("rigctl", "tune", file, "--from", settings.ledger, "--gains", gains, "--table")
    assert answer.returncode == 0, answer.stderr
    assert "gain table, by operating point:" in answer.stdout
    assert "s apart are stable with every plant of both families" in answer.stdout
    design = design_in_use(settings, NOW)
    assert isinstance(design.gains, ScheduledGains)
    assert [entry.tension_n for entry in design.gains.table] == [300.0, 240.0]
    assert design.warnings() == []
    with lockstep(adopted(settings, NOW), design.gains, built=settings) as rig:
        rig.run(0.2)
        arm_and_tension(rig, limit_s=20.0, settle_s=2.0)
        rig.events.read()
        at_rest = rig.run(1.0)["command_mm_s"]
        steps, changes = [], []
        for target in (240.0, 300.0):
            assert rig.command(Verb.TARGET, target) is Refusal.NONE
            records = rig.run(4.0 + design.gains.dwell_s)
            changes += [event for event in rig.events.read() if event["kind"] == Kind.GAINS]
            command = records["command_mm_s"]
            moments = np.searchsorted(records["t_ns"], [event["t_ns"] for event in changes[-1:]])
            steps += [float(np.abs(np.diff(command[at - 1 : at + 3])).max()) for at in moments]
            assert abs(float(np.mean(records["tension_n"][-500:])) - target) < 0.1
        assert rig.loop.machine.mode is Mode.COMPENSATING
    assert len(changes) == 2
    noise = float(np.abs(np.diff(at_rest)).max())
    ramp = settings.tension.ramp_n_s / 0.25 / settings.plant.stiffness_n_mm / settings.loop.rate_hz
    assert max(steps) <= 1.5 * noise + ramp  # no more than from tick to tick at rest
