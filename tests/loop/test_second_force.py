"""The second force path on the rig: its zero and scale, fusion, loss, and the fault when the two paths disagree."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator
from typing import Any, Literal

import pytest

from hil.faults import on_bus, stand
from hil.faults.stand import Stand
from hil.lockstep import Lockstep, lockstep
from hil.operated_rig import arm_and_tension
from rigctl.config.second_force_section import SecondForceSettings
from rigctl.config.settings import RigSettings
from rigctl.control.law.tension import Gains
from rigctl.ipc.ledger import Standing
from rigctl.model.checks import Check
from rigctl.model.events import Kind
from rigctl.model.faults import Fault
from rigctl.model.requests import Request
from rigctl.model.states import Mode
from rigctl.model.verbs import Refusal, Verb
from rigctl.operations import calibration_findings as findings
from rigctl.operations.calibration_findings import CalibrationFinding, Measured
from tests.builders.rig_bench import changed

WEIGHT_N = 294.2
U_N, CELL_U_N = 0.03, 0.04
WEIGHT = CELL_U_N**2 / (CELL_U_N**2 + U_N**2)
MEAN_N = 0.01  # of a mean over a second: noise, and the encoder's step of 1 um, of 6 mN
RATE_HZ = 500
Kind_ = Literal["cell", "stretch"]
KINDS = ["cell", pytest.param("stretch", marks=pytest.mark.study)]


def fitted(settings: RigSettings, kind: Kind_, errors: dict[str, Any] | None = None, **cell: float) -> RigSettings:
    """The rig with a second force path, and errors of it and of the cell."""
    plain = {"creep_pct": 0.0, "drift_n_h": 0.0, "bias_n": 0.0, "gain_pct": 0.0}
    simulation = {"cell": plain | cell, "second_force": {"noise_n": 0.01} | (errors or {})}
    made = changed(settings, simulation=simulation, loop={"rate_hz": RATE_HZ})
    spring = settings.plant.spring_n_mm if kind == "stretch" else None
    section = SecondForceSettings(
        kind=kind, spring_n_mm=spring, u_n=U_N, cell_u_n=CELL_U_N, disagree_n=0.5, fuse_s=1.0, rate_hz=50
    )
    return made.model_copy(update={"second_force": section})


def put(rig: Lockstep, found: CalibrationFinding) -> Standing:
    """Put a finding in force, as the gateway does."""
    assert found.order is not None
    assert rig.command(found.order.setting, *found.order.values) is Refusal.NONE
    return Standing(**found.entry.after)  # type: ignore[arg-type]


def tare(rig: Lockstep) -> Standing:
    assert rig.command(Verb.TARE) is Refusal.NONE
    measured = Measured.of(rig.reply, 0)
    return put(rig, findings.tare(rig.settings, Request(Verb.TARE, "kim"), Standing(), measured))


def calibrate(rig: Lockstep, now: Standing) -> Standing:
    """Hang the weight, calibrate both paths, take it off."""
    rig.rig.hang(WEIGHT_N)
    rig.run(1.0)
    assert rig.command(Verb.CALIBRATE, WEIGHT_N, math.nan) is Refusal.NONE
    request = Request(Verb.CALIBRATE, "kim", WEIGHT_N, adopt=True)
    standing = put(rig, findings.calibrate(rig.settings, request, now, Measured.of(rig.reply, 0)))
    rig.rig.hang(0.0)
    rig.run(1.0)
    return standing


@contextlib.contextmanager
def tared(settings: RigSettings, gains: Gains) -> Iterator[Lockstep]:
    """The rig in DISARMED, both paths tared."""
    with lockstep(settings, gains) as rig:
        rig.run(0.5)
        tare(rig)
        yield rig


def silence_second(rig: Lockstep) -> None:
    """No sample of the second cell comes any more."""
    on_bus.silent(on_bus.second)(Stand(rig, "silent"))


@pytest.mark.study
@pytest.mark.parametrize("kind", KINDS)
def test_zero_and_scale_come_with_the_cells_and_then_both_paths_agree(
    settings: RigSettings, gains: Gains, kind: Kind_
) -> None:
    wrong = {"bias_n": 3.0, "gain_pct": 1.5}
    with lockstep(fitted(settings, kind, wrong, bias_n=-1.0, gain_pct=-0.5), gains) as rig:
        rig.run(0.5)
        assert rig.command(Verb.ARM) is Refusal.PREFLIGHT
        assert rig.reply["checks"] == Check.SECOND_FORCE
        standing = calibrate(rig, tare(rig))
        assert standing.second_scale == pytest.approx(1.0 / 1.015, abs=1e-4)
        arm_and_tension(rig, limit_s=20.0)
        rig.run(4.0)
        last = rig.run(1.0)
        assert abs(float(last["force_gap_n"].mean())) < 2 * MEAN_N
        assert float(last["second_n"].mean()) == pytest.approx(rig.rig.truth.tension_n, abs=2 * MEAN_N)
        assert rig.loop.machine.mode is Mode.COMPENSATING


@pytest.mark.study
@pytest.mark.parametrize("kind", KINDS)
def test_an_error_of_the_cell_is_shared_by_the_weight_of_the_paths(
    settings: RigSettings, gains: Gains, kind: Kind_
) -> None:
    """The cell's zero moves after the tare: the article's load follows it by what the second path does not take off."""
    with tared(fitted(settings, kind), gains) as rig:
        rig.rig.cell._measurement.bias_n = 0.2
        arm_and_tension(rig, limit_s=20.0)
        rig.run(12.0)
        last = rig.run(1.0)
        left_n = rig.settings.tension.target_n - float(last["vertical_n"].mean())
        assert abs(left_n) < 2 * MEAN_N, "the law holds what it is told"
        assert rig.rig.truth.tension_n - rig.loop.law.setpoint_n == pytest.approx(-0.2 * (1 - WEIGHT), abs=2 * MEAN_N)
        assert float(last["fused_n"].mean()) == pytest.approx(-0.2 * WEIGHT, abs=MEAN_N)


@pytest.mark.parametrize("kind", KINDS)
def test_two_paths_that_disagree_hold_the_rig_until_they_agree(
    settings: RigSettings, gains: Gains, kind: Kind_
) -> None:
    with tared(fitted(settings, kind), gains) as rig:
        arm_and_tension(rig, limit_s=20.0)
        rig.run(1.0)
        second = rig.rig.second_force
        assert second is not None
        second.fault_n = 1.0
        records = rig.run(3.0)
        assert rig.loop.machine.mode is Mode.FAULT
        assert rig.loop.machine.fault is Fault.FORCES_DISAGREE
        held = records[records["mode"] == Mode.FAULT]
        assert abs(float(held["command_mm_s"][-1])) < 0.5
        assert float(abs(records["fused_n"]).max()) <= WEIGHT * 0.5 + 1e-9
        assert rig.command(Verb.RESET) is Refusal.NONE
        rig.run(0.2)
        assert rig.loop.machine.fault is Fault.FORCES_DISAGREE, "in HOLD they disagree still"
        second.fault_n = 0.0
        rig.run(4.0)
        assert rig.command(Verb.RESET) is Refusal.NONE
        rig.run(0.2)
        assert rig.loop.machine.fault is Fault.NONE


def test_a_tare_makes_two_paths_agree_after_a_disarm_and_a_reset(settings: RigSettings, gains: Gains) -> None:
    """Its remedy is a command of DISARMED, so that the fault must not keep the rig from there."""
    with tared(fitted(settings, "cell"), gains) as rig:
        assert rig.command(Verb.ARM) is Refusal.NONE
        assert rig.rig.second_force is not None
        rig.rig.second_force.fault_n = 1.0
        rig.run(2.0)
        assert rig.loop.machine.fault is Fault.FORCES_DISAGREE
        assert rig.command(Verb.TARE) is Refusal.WRONG_MODE
        assert rig.command(Verb.DISARM) is Refusal.NONE
        assert rig.command(Verb.RESET) is Refusal.NONE
        rig.run(1.0)
        assert rig.loop.machine.mode is Mode.DISARMED
        assert rig.command(Verb.ARM) is Refusal.PREFLIGHT
        assert rig.reply["checks"] == Check.FORCES_DISAGREE
        tare(rig)
        rig.run(3.0)
        assert rig.command(Verb.ARM) is Refusal.NONE


@pytest.mark.study
def test_a_second_path_that_is_lost_is_logged_and_the_cell_leads_alone(settings: RigSettings, gains: Gains) -> None:
    with tared(fitted(settings, "cell", {"bias_n": 0.0}), gains) as rig:
        second = rig.rig.second_force
        assert second is not None
        second.fault_n = 0.1
        arm_and_tension(rig, limit_s=20.0)
        before = rig.run(3.0)
        assert float(before["fused_n"][-1]) == pytest.approx(0.1 * WEIGHT, abs=0.02)
        silence_second(rig)
        after = rig.run(8.0)
        assert rig.loop.machine.mode is Mode.COMPENSATING
        assert float(after["fused_n"][-1]) == pytest.approx(0.0, abs=1e-3)
        steps = after["fused_n"][1:] - after["fused_n"][:-1]
        assert float(abs(steps).max()) < 1e-3
        logged = rig.runtime.events.reader(from_start=True).read()
        texts = [bytes(event["text"]) for event in logged if event["kind"] == Kind.LIMIT]
        assert any(b"second_force_age_ms" in text for text in texts)


@pytest.mark.parametrize("mode", [Mode.HOLD, Mode.FAULT])
def test_a_load_on_the_brake_can_be_lowered_without_the_second_path(
    settings: RigSettings, gains: Gains, mode: Mode
) -> None:
    """The lost path bars arming alone, as `second_force_silent` of the catalogue shows."""
    made = changed(fitted(settings, "cell"), hold={"park_s": 0.5}, second_force={"zero_n": 0.0})
    with lockstep(made, gains) as rig:
        stand.start(rig, mode, None)
        stand.enter(rig, mode)
        stand.park(rig)
        silence_second(rig)
        rig.run(1.0)
        assert (rig.loop.machine.mode, rig.view.braked) == (mode, True)
        before_mm = rig.rig.truth.stroke_mm
        assert rig.command(Verb.RELEASE if mode is Mode.HOLD else Verb.LOWER) is Refusal.NONE
        rig.run(1.0)
        assert abs(rig.rig.truth.stroke_mm - before_mm) > 1.0, "the motor has taken the load and lowers it"


def test_a_rig_without_the_section_has_none_of_it(settings: RigSettings, gains: Gains) -> None:
    with lockstep(settings, gains) as rig:
        last = rig.run(0.3)[-1]
        assert math.isnan(last["second_n"])
        assert last["fused_n"] == last["force_gap_n"] == 0.0
        assert rig.rig.second_force is None
