"""The joint bound over a family: python-control finds Ms within the limit on every plant, and a stable loop."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import control
import numpy as np
import pytest

from hil.runs.rows_file import RowsFile
from hil.studies.compare.bound import group_bounds, joint_groups, program
from hil.studies.compare.bound.joint_groups import LAWS, MS_SPARE, OWN, JointPlant, answer, family_gap, family_peak
from hil.studies.compare.bound.linear_law import Disturbance, StrokeAnswer, at
from hil.studies.compare.bound.nominal import JOLT, TONES, Nominal
from hil.studies.compare.bound.program import Law, Task
from hil.studies.compare.compared_runs import compared_runs
from hil.studies.compare.equal_limits import Known
from rigctl.config.changed_settings import changed
from rigctl.design.plant_family import Array, Family, Member
from tests.builders.rig_bench import SETTINGS

DT = 1e-3
HZ = np.geomspace(0.02, 499.0, 3000)


def rig(spring_n_mm: float) -> tuple[Nominal, Family]:
    known = Known.of(changed(SETTINGS, {"plant.spring_n_mm": spring_n_mm}))
    return Nominal(known.settings), known.family


def law_of_family(here: Nominal, family: Family) -> tuple[Task, Law]:
    """The law with the least largest share of the bounds of the sines."""
    task = here.task(0.1)
    limits = replace(task.limits, ms=task.limits.ms - MS_SPARE)
    robust = replace(task, limits=limits, family=family_gap(task, here.plant, family))
    tones = [here.tone(name) for name in TONES]
    own = [program.least(task, tone).value for tone in tones]
    return task, program.least_share(robust, tones, own)


def plant(member: Member) -> control.StateSpace:
    """Measured tension per command, with the delay."""
    n = len(member.a)
    own = control.ss(member.a, member.b_command[:, None], np.eye(1, n), [[0.0]], DT)
    return own * delay(member.delay_ticks)


def delay(ticks: int) -> control.StateSpace:
    if not ticks:
        return control.ss([], [], [], [[1.0]], DT)
    return control.ss(np.eye(ticks, k=-1), np.eye(ticks, 1), np.eye(1, ticks, k=ticks - 1), [[0.0]], DT)


def sent(x: Array) -> control.StateSpace:
    """Command per disturbance of the tension: a sum over the last samples, each a tick old at least."""
    taps = np.diff(np.concatenate([[0.0], x, [0.0]]))
    count = len(taps)
    return control.ss(np.eye(count, k=-1), np.eye(count, 1), taps[None, :], [[0.0]], DT)


@pytest.mark.parametrize("spring_n_mm", [6.0, 34.0])
def test_the_law_of_the_family_keeps_ms_on_every_plant_of_it(spring_n_mm: float) -> None:
    here, family = rig(spring_n_mm)
    task, law = law_of_family(here, family)
    limit = SETTINGS.design.ms_max
    near = [hz * np.linspace(0.9, 1.1, 81) for hz in {hz for one in family.members for hz in one.resonances_hz}]
    z = np.exp(2j * np.pi * np.unique(np.concatenate([HZ, *near])) * DT)
    q, own = sent(law.x)(z), plant(here.plant)(z)
    controller = q / (1.0 + own * q)
    peaks = [float(np.abs(1.0 / (1.0 - plant(member)(z) * controller)).max()) for member in family.members]
    assert max(peaks) <= limit
    assert max(peaks) == pytest.approx(family_peak(task, law.x, here.plant, family), abs=0.01)
    assert max(peaks) > 1.2, "the limit counts"


def test_its_loop_is_stable_on_every_plant() -> None:
    """Tick by tick, from 1 N: ``u = x y / s`` with s the sum of S's sequence, which is zero at rest on both sides."""
    here, family = rig(6.0)
    _, law = law_of_family(here, family)
    x, steps = law.x, np.convolve(StrokeAnswer.of(here.plant).sensed, law.x)
    steps[0] += 1.0
    s = np.cumsum(steps)
    assert abs(s[-1]) < 1e-3, "it has ended"
    for member in family.members[::8]:
        state, ticks = np.zeros(len(member.a)), 6000
        state[0] = 1.0
        read, command = np.zeros(ticks + len(x) + 1), np.zeros(ticks + len(s))
        for tick in range(ticks):  # the newest is the last
            now, sent_by = tick + len(x) + 1, tick + len(s)
            read[now - 1] = state[0]
            heard = read[now - 1 - len(x) : now - 1][::-1]
            command[sent_by - 1] = x @ heard - s[1:] @ command[sent_by - len(s) : sent_by - 1][::-1]
            late = sent_by - 1 - member.delay_ticks
            state = member.a @ state + member.b_command * command[late]
        assert np.abs(read[-500:]).max() < 0.01


def test_the_condition_costs_error_and_the_nominal_law_breaks_the_limit_on_the_family() -> None:
    here, family = rig(34.0)
    task, robust = law_of_family(here, family)
    tones = [here.tone(name) for name in TONES]
    own = [program.least(task, tone).value for tone in tones]
    nominal = program.least_share(task, tones, own)
    assert nominal.value < robust.value
    assert family_peak(task, nominal.x, here.plant, family) > SETTINGS.design.ms_max


def test_an_answer_is_the_transform_of_the_stroke_answer() -> None:
    here, _ = rig(6.0)
    z = np.exp(2j * np.pi * np.array([0.5, 3.0, 20.0, 200.0]) * DT)
    assert answer(here.plant, z) == pytest.approx(at(StrokeAnswer.of(here.plant).sensed, z), rel=1e-3)
    assert answer(here.plant, z) == pytest.approx((1.0 - 1.0 / z) / z * plant(here.plant)(z), rel=1e-9)


def test_a_joint_bound_has_a_price_for_each_group(monkeypatch: pytest.MonkeyPatch) -> None:
    here, _ = rig(6.0)
    t = np.arange(3000) * DT
    swing = Disturbance.of(here.plant, 0.08 * np.cos(2.0 * math.pi * 0.58 * t), 1000)
    monkeypatch.setattr(joint_groups, "locked", lambda *_: swing)
    there = JointPlant(SETTINGS, compared_runs(SETTINGS)[0])
    found = there.joint("6 N/mm", 0.1, OWN, there.own(0.1), ["shake_8hz", JOLT])
    assert found.family is not None
    for reach in (found.nominal, found.family):
        assert max(reach.over.values()) == pytest.approx(reach.most, rel=1e-3)
        assert reach.without["shake_8hz"] < 0.9 * reach.most, "heave and 8 Hz cost each other"
        assert reach.without[JOLT] == pytest.approx(reach.most, rel=1e-3), "the jolt does not decide"
    assert 1.0 < found.nominal.most < found.family.most
    assert found.family.ms <= SETTINGS.design.ms_max
    kept = json.loads(json.dumps(joint_groups.as_json(found), allow_nan=False))
    assert joint_groups.of_json(kept) == found


def test_the_laws_that_were_played_are_a_reference_on_the_plant_of_the_file(monkeypatch: pytest.MonkeyPatch) -> None:
    here, _ = rig(6.0)
    swing = Disturbance.of(here.plant, np.full(2000, 0.08), 1000)
    monkeypatch.setattr(joint_groups, "locked", lambda *_: swing)
    monkeypatch.setattr(joint_groups, "PLANTS", {"6 N/mm": "paper_k6"})
    monkeypatch.setattr(joint_groups, "MEMORIES_S", ())
    monkeypatch.setattr(joint_groups, "LAWS_MEMORIES_S", (0.1,))
    least_n = {"move": 0.006, "vertical": 0.1, "shake_3hz": 0.06, "shake_8hz": 0.18, "jolt": 0.7}
    said = list[str]()
    runs, rows = compared_runs(SETTINGS), RowsFile(None, {})
    (found,) = joint_groups.study(SETTINGS, runs, least_n, rows, said.append)
    assert (found.reference, found.reference_n) == (LAWS, least_n)
    assert found.nominal.most == pytest.approx(max(found.nominal.over.values()), rel=1e-3)
    assert said[0].startswith("one law for all groups at 6 N/mm, 0.1 s of memory: ")
    assert joint_groups.study(SETTINGS, runs, None, rows, said.append) == []


@pytest.mark.parametrize(("name", "expected"), [("vertical", 0.00325), ("jolt", 0.2201), ("mass", None)])
def test_the_bound_of_a_run_is_kept(name: str, expected: float | None) -> None:
    rows = RowsFile(None, {})
    run = next(run for run in compared_runs(SETTINGS) if run.name == name)
    found = group_bounds.bound_pct(SETTINGS, run, rows)
    assert found == (None if expected is None else pytest.approx(expected, rel=0.01))
    assert rows.get(f"least {name}")["bound_pct"] == found
