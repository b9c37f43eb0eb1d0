"""A drive that has lost its zero position is not armed: compared with the last stroke, and watched for jumps."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest

from hil.faults import on_bus
from hil.faults.in_device import STROKE
from hil.faults.stand import Stand
from hil.lockstep import Lockstep, lockstep
from rigctl.config.settings import RigSettings
from rigctl.control.law.tension import Gains
from rigctl.control.load.homed import LastStroke
from rigctl.model.checks import Check
from rigctl.model.events import Kind, worded
from rigctl.model.faults import Fault
from rigctl.model.reactions import Action
from rigctl.model.states import Flag, Mode
from rigctl.model.verbs import STROKE_TOLERANCE_MM, Refusal, Verb
from tests.builders.loop_frames import latched

JUMP_UM = 52_000


def changed(settings: RigSettings, **change: object) -> RigSettings:
    return settings.model_copy(update={"cylinder": settings.cylinder.model_copy(update=change)})


@pytest.fixture
def start(settings: RigSettings, gains: Gains) -> Iterator[Callable[..., Lockstep]]:
    """Starts a rig at stroke 0 with a given last stroke."""
    opened = []

    def begin(last: LastStroke, **change: object) -> Lockstep:
        held_against_the_last = changed(settings, **{"stroke_waiver": None, **change})
        context = lockstep(held_against_the_last, gains, last_stroke=last)
        opened.append(context)
        rig = context.__enter__()
        rig.run(0.2)
        return rig

    yield begin
    for context in opened:
        context.__exit__(None, None, None)


def strokes(rig: Lockstep) -> list[str]:
    found = []
    for event in rig.events.read():
        if event["kind"] == Kind.STROKE:
            numbers = (event[name].item() for name in ("a", "b", "value", "limit", "text"))
            a, b, value, limit, text = numbers
            found.append(worded(Kind.STROKE, a, b, value, limit, text.decode()).text)
    return found


@pytest.mark.parametrize(
    "last", [LastStroke(52.0), LastStroke(-0.51), LastStroke(None, "rig.stroke.json is damaged")], ids=str
)
def test_a_stroke_that_is_not_the_last_known_is_refused_until_it_is_confirmed(
    start: Callable[..., Lockstep], last: LastStroke
) -> None:
    rig = start(last)
    assert rig.command(Verb.ARM) is Refusal.PREFLIGHT
    assert rig.reply["checks"] == Check.STROKE_UNCONFIRMED
    (told,) = strokes(rig)
    assert told.startswith(f"the stroke reads 0.00 mm, but {last.why or f'{last.mm:.2f} mm when last known'}: measure")
    assert rig.command(Verb.CONFIRM_STROKE, 52.0) is Refusal.STROKE_DIFFERS
    assert rig.command(Verb.CONFIRM_STROKE, STROKE_TOLERANCE_MM + 0.1) is Refusal.STROKE_DIFFERS
    assert rig.command(Verb.ARM) is Refusal.PREFLIGHT
    assert all(record["flags"] & Flag.STROKE_UNCONFIRMED for record in rig.run(0.01))
    assert rig.command(Verb.CONFIRM_STROKE, 0.2) is Refusal.NONE
    assert strokes(rig) == ["stroke 0.00 mm: confirmed by an operator"]
    assert not any(record["flags"] & Flag.STROKE_UNCONFIRMED for record in rig.run(0.01))
    assert rig.command(Verb.ARM) is Refusal.NONE


@pytest.mark.parametrize("last", [LastStroke(), LastStroke(0.4), LastStroke(-0.4)], ids=str)
def test_the_first_start_ever_and_a_stroke_that_agrees_are_allowed_and_told(
    start: Callable[..., Lockstep], last: LastStroke
) -> None:
    rig = start(last)
    assert rig.command(Verb.ARM) is Refusal.NONE
    (told,) = strokes(rig)
    assert told.startswith("stroke 0.00 mm: ")


def test_an_encoder_that_is_not_absolute_is_confirmed_at_every_start(start: Callable[..., Lockstep]) -> None:
    rig = start(LastStroke(0.0), absolute_encoder=False)
    assert rig.command(Verb.ARM) is Refusal.PREFLIGHT
    assert rig.reply["checks"] == Check.STROKE_UNCONFIRMED
    assert rig.command(Verb.CONFIRM_STROKE, 0.0) is Refusal.NONE
    assert rig.command(Verb.ARM) is Refusal.NONE


def test_a_waiver_arms_all_the_same_and_says_so(start: Callable[..., Lockstep]) -> None:
    rig = start(LastStroke(52.0), stroke_waiver="simulated rig")
    assert rig.command(Verb.ARM) is Refusal.NONE
    assert strokes(rig) == ["stroke 0.00 mm: 52.00 mm when last known, waived: simulated rig"]


@pytest.mark.parametrize("rig", [Mode.HOLD, Mode.TENSIONING, Mode.COMPENSATING], indirect=["rig"])
def test_a_jump_while_armed_takes_the_drive_off_power_and_waits_for_the_operator(rig: Lockstep) -> None:
    before_mm = rig.rig.truth.stroke_mm
    rig.rig.drive.distort(*STROKE, lambda raw: raw - JUMP_UM)
    rig.run(0.5)
    assert latched(rig) == (Mode.FAULT, Fault.STROKE_JUMPED, Action.POWER_OFF)
    assert rig.rig.truth.stroke_mm == pytest.approx(before_mm, abs=0.3)
    assert not rig.rig.drive.control.enabled
    assert rig.command(Verb.RESET) is Refusal.CAUSE_PRESENT
    assert rig.reply["cause"] == Fault.STROKE_JUMPED
    assert rig.command(Verb.CONFIRM_STROKE, before_mm) is Refusal.STROKE_DIFFERS
    assert rig.command(Verb.CONFIRM_STROKE, rig.loop.inbox.drive.stroke_mm) is Refusal.NONE
    assert rig.command(Verb.RESET) is Refusal.NONE


def test_a_jump_while_disarmed_refuses_the_arm_even_with_a_waiver(
    start: Callable[..., Lockstep],
) -> None:
    rig = start(LastStroke(), stroke_waiver="simulated rig")
    strokes(rig)
    rig.rig.drive.distort(*STROKE, lambda raw: raw + JUMP_UM)
    rig.run(0.1)
    assert [told.split(":")[0] for told in strokes(rig)] == ["the stroke reads 52.00 mm, but 0.00 mm the sample before"]
    assert rig.command(Verb.ARM) is Refusal.PREFLIGHT
    assert rig.reply["checks"] == Check.STROKE_UNCONFIRMED
    assert rig.command(Verb.CONFIRM_STROKE, 52.0) is Refusal.NONE
    assert rig.command(Verb.ARM) is Refusal.NONE


def test_a_stroke_that_was_moved_while_the_drive_was_silent_is_in_doubt(start: Callable[..., Lockstep]) -> None:
    rig = start(LastStroke())
    on_bus.silent(on_bus.drive)(Stand(rig, "silent"))
    rig.run(1.0)
    rig.rig.drive.distort(*STROKE, lambda raw: raw + 600)
    rig.hub.tap = None
    rig.run(0.1)
    assert rig.loop.homed.doubted


def test_no_stroke_is_confirmed_that_the_drive_does_not_say_now(rig: Lockstep) -> None:
    on_bus.silent(on_bus.drive)(Stand(rig, "silent"))
    rig.run(0.1)
    assert rig.command(Verb.CONFIRM_STROKE, 0.0) is Refusal.STROKE_DIFFERS


@pytest.mark.starts_in(Mode.HOLD)
def test_confirming_needs_a_rig_at_rest(rig: Lockstep) -> None:
    assert rig.command(Verb.CONFIRM_STROKE, 0.0) is Refusal.WRONG_MODE
