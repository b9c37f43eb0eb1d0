"""A reaction without effect is followed by the next stronger one, after its time; an effective one stays."""

from __future__ import annotations

from dataclasses import replace

import pytest

from rigctl.config import rig_file as config
from rigctl.control.snapshot import Snapshot
from rigctl.control.watch.escalation import STEPS, Bounds, Escalation, Escalator, Step
from rigctl.model.events import Kind, worded
from rigctl.model.faults import Fault
from rigctl.model.reactions import Action, Symptom
from tests.builders.paths import ROOT

SETTINGS = config.load(ROOT / "config/paper_rig.yaml")
MS = 1_000_000
STOP_NS = 60 * MS
BOUNDS = Bounds(SETTINGS, STOP_NS)
GOOD = Snapshot(tension_n=300.0, stroke_mm=50.0, drive_age_ns=MS, drive_heard=True, drive_may_be_on=True)
OFF = replace(GOOD, drive_off=True, drive_may_be_on=False)
STOPS = replace(GOOD, drive_stops=True)
HELPED = {Action.RAMP_DOWN: GOOD, Action.HOLD: GOOD, Action.QUICK_STOP: OFF, Action.POWER_OFF: OFF,
          Action.SILENCE: OFF}  # fmt: skip
BAD = {
    Symptom.RAMP_RISES: {"tension_n": 303.1},
    Symptom.HOLD_RISES: {"tension_n": 403.1},
    Symptom.HOLD_MOVES: {"speed_mm_s": -1.1},
    Symptom.STOP_MOVES: {"speed_mm_s": 0.21},
    Symptom.STOP_DRIFTS: {"stroke_mm": 49.79},
    Symptom.STOP_STAYS_ON: {"drive_may_be_on": True, "drive_stops": True},
    Symptom.OFF_DRIFTS: {"stroke_mm": 50.21},
    Symptom.HOLD_BLIND: {"unseen_mm": 0.21, "drive_heard": False},
    Symptom.STOP_UNANSWERED: {"drive_may_be_on": True},
    Symptom.OFF_UNANSWERED: {"drive_may_be_on": True},
    Symptom.OFF_STAYS_ON: {"drive_may_be_on": True, "drive_stops": True},
    Symptom.SILENCE_MOVES: {"tension_n": 303.1},
}


def watched(step: Step, *, bad_from_ms: int, until_ms: int, fault: Fault = Fault.LIMIT) -> list[tuple[int, Escalation]]:
    """The escalations found, with their times in ms from the reaction on."""
    subject, found = Escalator(SETTINGS, STOP_NS), []
    for ms in range(until_ms):
        snapshot = replace(HELPED[step.action], t_ns=ms * MS)
        if ms >= bad_from_ms:
            snapshot = replace(snapshot, **BAD.get(step.symptom, {}))  # type: ignore[arg-type]
        if (escalation := subject.look(fault, step.action, snapshot, ms * MS)) is not None:
            found.append((ms, escalation))
    return found


def time_ms(step: Step) -> int:
    return (step.waits_ns(BOUNDS) + step.persistence_ns) // MS


def test_every_symptom_has_its_line_and_leads_to_something_stronger() -> None:
    assert [step.symptom for step in STEPS] == list(Symptom)
    assert all(step.after is None or step.after > step.action for step in STEPS)
    assert [step.symptom for step in STEPS if step.after is None] == [Symptom.OFF_DRIFTS, Symptom.SILENCE_MOVES]


@pytest.mark.parametrize("step", [step for step in STEPS if step.symptom in BAD], ids=lambda step: step.symptom.name)
def test_what_has_not_helped_is_found_once_after_its_time_and_not_before(step: Step) -> None:
    rests_ms = step.waits_ns(BOUNDS) // MS + 1
    due_ms = rests_ms + step.persistence_ns // MS
    seen = watched(step, bad_from_ms=rests_ms, until_ms=due_ms + 1500)
    ((at_ms, found),) = [item for item in seen if item[1].symptom is step.symptom]
    assert at_ms == due_ms
    assert (found.symptom, found.fault, found.after) == (step.symptom, Fault.LIMIT, step.after)
    assert found.value > found.limit == step.bound(BOUNDS)
    assert (found.trip is None) == (step.after is None)
    text = worded(Kind.ESCALATION, found.fault, found.symptom, found.value, found.limit, "").text
    assert text.startswith("LIMIT, reaction did not help: ")


@pytest.mark.parametrize("action", HELPED)
def test_a_reaction_that_helped_is_left_alone(action: Action) -> None:
    step = next(step for step in STEPS if step.action is action)
    assert watched(step, bad_from_ms=1 << 30, until_ms=3000) == []


def test_a_ramp_down_that_does_not_end_is_held() -> None:
    step = next(step for step in STEPS if step.symptom is Symptom.RAMP_LATE)
    ((at_ms, found),) = watched(step, bad_from_ms=1 << 30, until_ms=18_000)
    assert at_ms == pytest.approx(17_000, abs=1)  # 300 N at 50 N/s, twice, and 5 s
    assert found.after is Action.HOLD


def test_a_drive_that_is_not_heard_for_100_ms_is_stopped() -> None:
    subject, found = Escalator(SETTINGS, STOP_NS), []
    stale_ms = SETTINGS.safety.stale_ms
    for ms in range(1500):
        snapshot = replace(GOOD, t_ns=ms * MS, drive_age_ns=max(0, ms - 400) * MS)
        if (escalation := subject.look(Fault.DRIVE_STALE, Action.HOLD, snapshot, ms * MS)) is not None:
            found.append((ms, escalation.symptom, escalation.after))
    assert found == [(400 + stale_ms + 101, Symptom.HOLD_UNSEEN, Action.QUICK_STOP)]


def test_a_rising_tension_below_its_limit_is_nobodys_fault() -> None:
    subject = Escalator(SETTINGS, STOP_NS)
    for ms in range(1000):
        snapshot = replace(GOOD, t_ns=ms * MS, tension_n=300.0 + 0.09 * ms)
        assert subject.look(Fault.CELL_STALE, Action.HOLD, snapshot, ms * MS) is None


def test_each_reaction_has_its_own_time() -> None:
    subject, moving = Escalator(SETTINGS, STOP_NS), replace(STOPS, speed_mm_s=2.0)
    hold, stop = (next(step for step in STEPS if step.symptom is name) for name in (Symptom.HOLD_MOVES,
                                                                                    Symptom.STOP_MOVES))  # fmt: skip
    found = []
    action = Action.HOLD
    for ms in range(2000):
        escalation = subject.look(Fault.CELL_STALE, action, moving, ms * MS)
        if escalation is not None and escalation.after is not None:
            found.append((ms, escalation.symptom))
            action = escalation.after
    first, second, _ = found
    assert first == (time_ms(hold), Symptom.HOLD_MOVES)
    assert second == (first[0] + 1 + time_ms(stop), Symptom.STOP_MOVES)


def test_nothing_is_watched_without_a_fault() -> None:
    subject = Escalator(SETTINGS, STOP_NS)
    assert all(subject.look(Fault.NONE, Action.HOLD, replace(GOOD, speed_mm_s=9.0), t * MS) is None for t in range(900))


@pytest.mark.parametrize(("rises_n", "found"), [(2.9, False), (3.1, True)])
def test_a_ramp_down_may_stretch_the_rope_by_half_a_millimetre(
    monkeypatch: pytest.MonkeyPatch, rises_n: float, found: bool
) -> None:
    (step,) = [step for step in STEPS if step.symptom is Symptom.RAMP_RISES]
    monkeypatch.setitem(BAD, Symptom.RAMP_RISES, {"tension_n": 300.0 + rises_n})  # 6 N/mm
    assert bool(watched(step, bad_from_ms=1, until_ms=time_ms(step) + 200)) == found
