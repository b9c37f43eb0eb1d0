"""Tare and calibration in the loop: where they are possible, what ends them, and what they can never do."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest

from hil.lockstep import Lockstep, lockstep
from rigctl.config.settings import RigSettings
from rigctl.control.law.tension import Gains
from rigctl.control.modes import command_slot
from rigctl.devices.objects import AiStatus
from rigctl.ipc.correction import Correction
from rigctl.model.checks import Check
from rigctl.model.events import Kind
from rigctl.model.faults import Fault
from rigctl.model.states import Mode
from rigctl.model.verbs import Refusal, Setting, Verb

Enter = Callable[[Mode], None]
OFFSET_N = 3.0
NOISE_N = 0.03
GOOD = AiStatus(0)


def cell_reads(rig: Lockstep, change: Callable[[float], float], status: AiStatus = GOOD) -> None:
    """From now on the cell reads ``change`` of the right value."""
    measurement = rig.rig.cell._measurement
    plain = type(measurement).sample

    def sample() -> tuple[AiStatus, float]:
        found, tension_n = plain(measurement)
        return found | status, change(tension_n)

    measurement.sample = sample  # type: ignore[method-assign]


def give(rig: Lockstep, verb: Verb, value: float = 0.0) -> None:
    """Give a command without waiting for its reply."""
    rig._id += 1
    rig._commands.write(*command_slot(rig.clock.now(), rig._id, verb, value))


@pytest.mark.parametrize("rig", [Mode.DISARMED, Mode.HOLD], indirect=["rig"])
def test_a_tare_measures_first_and_changes_nothing_until_it_is_on_record(rig: Lockstep) -> None:
    cell_reads(rig, lambda n: n + OFFSET_N)
    rig.run(0.1)
    assert rig.command(Verb.TARE) is Refusal.NONE
    assert rig.reply["reading_n"] == pytest.approx(OFFSET_N, abs=5 * NOISE_N / math.sqrt(1000))
    assert rig.reply["rms_n"] == pytest.approx(NOISE_N, rel=0.15)
    assert rig.run(0.1)["tension_n"].mean() == pytest.approx(OFFSET_N, abs=0.02)
    rig.events.read()
    assert rig.command(Setting.ZERO, float(rig.reply["reading_n"])) is Refusal.NONE  # as the calibration service does
    told = rig.events.read()
    assert list(told["kind"]) == [Kind.CORRECTION]
    assert rig.run(0.1)["tension_n"].mean() == pytest.approx(0.0, abs=0.02)
    assert rig.loop.inbox.cell.reading_n == pytest.approx(OFFSET_N, abs=0.2)


@pytest.mark.gate("2", "5")
@pytest.mark.parametrize("mode", [Mode.TENSIONING, Mode.COMPENSATING, Mode.RELEASING, Mode.FAULT])
def test_elsewhere_neither_is_possible_and_no_zero_is_taken(rig: Lockstep, enter: Enter, mode: Mode) -> None:
    enter(Mode.HOLD if mode is Mode.FAULT else mode)
    if mode is Mode.FAULT:
        rig.rig.receive(b"\0\0\0\0\2\0\0\0\2" + bytes([rig.settings.tension_cell.node]) + bytes(6))
        rig.run(0.1)
    assert rig.loop.machine.mode is mode
    fault = rig.loop.machine.fault
    assert [rig.command(verb) for verb in (Verb.TARE, Verb.CALIBRATE)] == [Refusal.WRONG_MODE] * 2
    assert rig.command(Setting.ZERO, 1.0) is Refusal.WRONG_MODE
    assert rig.loop.machine.fault is fault


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_loaded_rope_is_not_tared(rig: Lockstep, sign: float) -> None:
    cell_reads(rig, lambda n: n + sign * 10.5)
    rig.run(0.1)
    assert rig.command(Verb.TARE) is Refusal.LOADED
    assert rig.reply["reading_n"] == pytest.approx(sign * 10.5, abs=0.2)
    assert rig.command(Setting.ZERO, 5.0) is Refusal.LOADED


def test_a_tare_of_a_load_that_comes_meanwhile_is_refused(rig: Lockstep) -> None:
    give(rig, Verb.TARE)
    rig.run(0.5)
    cell_reads(rig, lambda n: n + 50.0)
    rig.run(0.01)
    replies = rig._replies.read()
    assert [int(reply["reason"]) for reply in replies] == [Refusal.LOADED]


def test_a_swinging_weight_is_no_reference(rig: Lockstep) -> None:
    cell_reads(rig, lambda n: n + 2.0 * math.sin(rig.clock.now() * 1e-9 * 2.3))
    assert rig.command(Verb.CALIBRATE) is Refusal.UNSTEADY


@pytest.mark.parametrize("value", [10.1, -10.1, math.nan, math.inf])
def test_no_zero_and_no_scale_beyond_its_bound_is_taken(rig: Lockstep, value: float) -> None:
    assert rig.command(Setting.ZERO, value) is Refusal.OUT_OF_RANGE
    assert rig.command(Setting.SCALE, 1.021) is Refusal.OUT_OF_RANGE
    assert rig.command(Setting.SCALE, 0.979) is Refusal.OUT_OF_RANGE
    assert rig.loop.inbox.cell_correction.correction == Correction()


@pytest.mark.parametrize("what", ["hold", "arm", "target", "bad sample", "silence", "stop"])
def test_anything_that_comes_in_between_ends_a_tare(rig: Lockstep, what: str) -> None:
    give(rig, Verb.TARE)
    rig.run(0.3)
    assert rig.view.trial is Verb.TARE
    verbs = {"hold": Verb.HOLD, "arm": Verb.ARM, "target": Verb.TARGET}
    if what in verbs:
        give(rig, verbs[what], 300.0)
    elif what == "bad sample":
        cell_reads(rig, lambda n: n, AiStatus.NOT_VALID)
    elif what == "silence":
        rig.rig.receive(b"\0\0\0\0\2\0\0\0\2" + bytes([rig.settings.tension_cell.node]) + bytes(6))
    else:
        rig.loop.stop_requested = True
    rig.run(0.05)
    assert rig.view.trial is None
    reply = rig._replies.read()[0]
    assert reply["id"] == 1
    lost = what in ("bad sample", "silence")
    assert reply["reason"] == (Refusal.NO_SAMPLES if lost else Refusal.ABORTED)
    assert rig.loop.inbox.cell_correction.correction == Correction()


def test_a_known_weight_reads_as_it_is_and_a_scale_corrects_it(rig: Lockstep, enter: Enter) -> None:
    cell_reads(rig, lambda n: 0.99 * n)
    enter(Mode.COMPENSATING)
    assert rig.command(Verb.HOLD) is Refusal.NONE
    rig.run(3.0)
    assert rig.command(Verb.CALIBRATE) is Refusal.NONE
    weight_n = rig.rig.truth.tension_n
    assert rig.reply["reading_n"] == pytest.approx(0.99 * weight_n, abs=0.05)
    assert rig.command(Setting.SCALE, weight_n / float(rig.reply["reading_n"])) is Refusal.NONE
    assert rig.run(0.2)["tension_n"].mean() == pytest.approx(weight_n, abs=0.05)
    assert rig.loop.machine.fault is Fault.NONE  # the step in the reading is no innovation
    assert rig.command(Verb.TENSION) is Refusal.NONE
    rig.run_until(Mode.COMPENSATING, 5.0)
    rig.run(1.0)
    assert rig.rig.truth.vertical_n == pytest.approx(300.0, abs=0.2)


def test_an_overdue_calibration_blocks_arming_and_nothing_else(settings: RigSettings, gains: Gains) -> None:
    with lockstep(settings, gains, correction=Correction(1.0, 1.01, overdue=True)) as rig:
        rig.run(0.2)
        assert rig.loop.inbox.cell_correction.correction == Correction(1.0, 1.01, overdue=True)
        assert rig.command(Verb.ARM) is Refusal.PREFLIGHT
        assert rig.reply["checks"] == Check.CALIBRATION
        assert rig.command(Verb.CALIBRATE) is Refusal.NONE
        assert rig.command(Setting.OVERDUE, 0.0) is Refusal.NONE
        assert rig.command(Verb.ARM) is Refusal.NONE
        assert rig.command(Setting.OVERDUE, 1.0) is Refusal.NONE  # during the trial: the next arming is refused
        rig.run(0.1)
        assert rig.loop.machine.mode is Mode.HOLD


@pytest.mark.starts_in(Mode.HOLD)
def test_a_tare_cannot_hide_an_overload(rig: Lockstep) -> None:
    assert rig.command(Setting.ZERO, 9.5) is Refusal.NONE
    cell_reads(rig, lambda n: n + 401.0)
    rig.run(0.1)
    assert rig.loop.inbox.cell.tension_n < rig.settings.safety.tension_high_n
    assert rig.loop.machine.fault in (Fault.LIMIT, Fault.TENSION_HIGH)  # the tension's rate is a limit of the rig file
