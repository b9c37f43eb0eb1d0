"""The zero on a slack rope: seen at each release and each tensioning, and corrected within its limit."""

from __future__ import annotations

import math
from typing import Any, Literal

import numpy as np
import pytest

from hil.faults import stand
from hil.lockstep import Lockstep, lockstep
from rigctl.config.compensation_section import CompensationSettings
from rigctl.config.settings import RigSettings
from rigctl.control.checks import Check
from rigctl.control.events import Kind
from rigctl.control.faults import Fault
from rigctl.control.modes import Mode, Refusal, Setting, Verb
from rigctl.control.tension import Gains
from tests.builders.rig_bench import changed

LIMIT_N = 0.3
NOISE_N = 4 * 0.03 / math.sqrt(1000)  # of the mean of a second


def fitted(
    settings: RigSettings, how: Literal["off", "check", "correct"] = "correct", bias_n: float = 0.12, **sections: Any
) -> RigSettings:
    made = changed(settings, simulation={"cell": {"bias_n": bias_n, "creep_pct": 0.0, "drift_n_h": 0.0}}, **sections)
    return made.model_copy(update={"compensation": CompensationSettings(slack_zero=how, slack_zero_limit_n=LIMIT_N)})


def seen(rig: Lockstep) -> list[tuple[int, float]]:
    """In force, and zero in N, of each event since the last call."""
    events = rig.events.read()
    return [(int(event["a"]), float(event["value"])) for event in events[events["kind"] == Kind.SLACK_ZERO]]


def tensioned(rig: Lockstep) -> None:
    assert rig.command(Verb.TENSION) is Refusal.NONE
    rig.run_until(Mode.COMPENSATING, 15.0)
    rig.run(1.0)


@pytest.mark.study
def test_the_rest_before_a_tensioning_counts_once_the_slack_is_taken_up_and_so_does_the_one_after_a_release(
    settings: RigSettings, gains: Gains
) -> None:
    with lockstep(fitted(settings), gains) as rig:
        rig.run(0.2)
        assert rig.command(Verb.ARM) is Refusal.NONE
        rig.run(1.5)
        assert seen(rig) == []  # a reading near zero proves nothing
        tensioned(rig)
        ((applied, zero_n),) = seen(rig)
        assert (applied, zero_n) == (1, pytest.approx(0.12, abs=NOISE_N))
        held = rig.run(2.0)
        assert float(held["slack_zero_n"][-1]) == pytest.approx(0.12, abs=NOISE_N)
        true_n = [rig.rig.truth.tension_n for _ in range(200) if len(rig.run(0.001))]  # one instant has noise
        assert sum(true_n) / len(true_n) == pytest.approx(300.0, abs=0.02)  # 0.12 less without it
        rig.rig.cell._measurement.bias_n = 0.2
        assert rig.command(Verb.RELEASE) is Refusal.NONE
        rig.run_until(Mode.HOLD, 15.0)
        rig.run(2.0)
        ((applied, zero_n),) = seen(rig)
        assert (applied, zero_n) == (1, pytest.approx(0.2, abs=NOISE_N))
        assert abs(float(rig.run(1.0)["tension_n"].mean())) < NOISE_N
        assert rig.loop.machine.fault is Fault.NONE


def test_as_a_check_it_is_seen_and_nothing_is_corrected(settings: RigSettings, gains: Gains) -> None:
    with lockstep(fitted(settings, "check"), gains) as rig:
        rig.run(0.2)
        assert rig.command(Verb.ARM) is Refusal.NONE
        rig.run(1.5)
        tensioned(rig)
        assert seen(rig) == [(0, pytest.approx(0.12, abs=NOISE_N))]
        assert rig.loop.inbox.cell.slack_zero_n == 0.0


@pytest.mark.gate("0.6")
@pytest.mark.parametrize("bias_n", [0.6, -0.6])
def test_a_zero_beyond_its_limit_is_not_corrected_is_logged_and_bars_the_next_arming_until_a_tare(
    settings: RigSettings, gains: Gains, bias_n: float
) -> None:
    with lockstep(fitted(settings, bias_n=bias_n), gains) as rig:
        rig.run(0.2)
        assert rig.command(Verb.ARM) is Refusal.NONE
        rig.run(1.5)
        assert rig.command(Verb.TENSION) is Refusal.NONE
        rig.run(1.0)
        events = rig.events.read()
        (event,) = events[events["kind"] == Kind.SLACK_ZERO]
        assert (event["a"], float(event["value"])) == (0, pytest.approx(bias_n, abs=NOISE_N))
        texts = [bytes(text).rstrip(b"\0") for text in events[events["kind"] == Kind.LIMIT]["text"]]
        assert b"slack_zero_n above" in texts
        assert rig.loop.inbox.cell.slack_zero_n == 0.0
        for verb in (Verb.RELEASE, Verb.HOLD, Verb.DISARM):
            assert rig.command(verb) is Refusal.NONE
            rig.run(3.0)
        assert rig.command(Verb.ARM) is Refusal.PREFLIGHT
        assert rig.reply["checks"] == Check.CELL_ZERO
        assert rig.command(Verb.TARE) is Refusal.NONE
        assert rig.command(Setting.ZERO, float(rig.reply["reading_n"])) is Refusal.NONE
        assert rig.command(Verb.ARM) is Refusal.NONE


def test_a_load_with_such_a_zero_is_released_from_the_brake_and_from_disarmed_before_the_tare(
    settings: RigSettings, gains: Gains
) -> None:
    """A loaded rope cannot be tared: whatever barred its release would leave no way to a tare."""
    with lockstep(fitted(settings, bias_n=0.6, hold={"park_s": 0.5}), gains) as rig:
        rig.run(0.2)
        assert rig.command(Verb.ARM) is Refusal.NONE
        rig.run(1.5)
        assert rig.command(Verb.TENSION) is Refusal.NONE
        rig.run(2.5)
        assert rig.command(Verb.HOLD) is Refusal.NONE
        stand.park(rig)
        assert rig.loop.observer.snapshot.reading_n > rig.settings.slack_reading_n
        assert rig.command(Verb.TARE) is Refusal.LOADED
        assert rig.command(Verb.RELEASE) is Refusal.NONE
        for verb in (Verb.HOLD, Verb.DISARM):
            assert rig.command(verb) is Refusal.NONE
            rig.run(2.0)
        assert rig.loop.observer.snapshot.reading_n > rig.settings.slack_reading_n
        for verb in (Verb.ARM, Verb.RELEASE):
            assert rig.command(verb) is Refusal.NONE
        rig.run_until(Mode.HOLD, 15.0)
        assert rig.command(Verb.DISARM) is Refusal.NONE
        rig.run(3.0)
        assert rig.command(Verb.ARM) is Refusal.PREFLIGHT
        assert rig.reply["checks"] == Check.CELL_ZERO


def test_a_tare_takes_the_place_of_what_was_found(settings: RigSettings, gains: Gains) -> None:
    with lockstep(fitted(settings), gains) as rig:
        rig.run(0.2)
        assert rig.command(Verb.ARM) is Refusal.NONE
        rig.run(1.5)
        assert rig.command(Verb.TENSION) is Refusal.NONE
        rig.run(0.2)
        assert rig.command(Verb.HOLD) is Refusal.NONE
        assert rig.loop.inbox.cell.slack_zero_n == pytest.approx(0.12, abs=NOISE_N)
        rig.run(0.5)
        assert rig.command(Verb.TARE) is Refusal.NONE
        assert rig.command(Setting.ZERO, float(rig.reply["reading_n"])) is Refusal.NONE
        cell = rig.loop.inbox.cell
        assert (cell.slack_zero_n, cell.zero_found_n) == (0.0, 0.0)
        assert cell.offset_n == pytest.approx(0.12, abs=NOISE_N)


@pytest.mark.study
def test_without_the_setting_there_is_no_such_event_and_no_other_bit(settings: RigSettings, gains: Gains) -> None:
    found = []
    for made in (settings, fitted(settings, "off", 0.0), fitted(settings, "check", 0.0)):
        plain = changed(made, simulation={"cell": {"creep_pct": 0.0, "drift_n_h": 0.0}})
        with lockstep(plain, gains) as rig:
            rig.run(0.2)
            assert rig.command(Verb.ARM) is Refusal.NONE
            rig.run(1.2)
            assert rig.command(Verb.TENSION) is Refusal.NONE
            found.append(rig.run(1.5))
            assert len(seen(rig)) == (plain.compensation is not None and plain.compensation.slack_zero == "check")
    for other in found[1:]:
        for name in ("tension_n", "command_mm_s", "estimate_n"):
            assert np.array_equal(found[0][name], other[name])
