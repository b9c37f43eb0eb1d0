"""Every command is answered exactly once, in every mode and while anything is under way, HOLD in between or not."""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Iterator
from typing import Any

import numpy.typing as npt
import pytest

from hil.lockstep import lockstep
from hil.scenario.play import bring_to_target
from rigctl.config.settings import RigSettings
from rigctl.control.bus.hold_sockets import Hold
from rigctl.control.law.tension import Gains
from rigctl.ipc.record import HOLD_ID
from rigctl.model.states import Mode
from rigctl.model.verbs import Verb

GIVEN = 40
VALUES = {Verb.RELEASE: (5.0,), Verb.TARGET: (290.0,), Verb.CALIBRATE: (150.0, 0.0), Verb.CARRY: (5.0, 0.0)}
GAPS_S = (0.0, 0.001, 0.02, 0.3, 1.2)
ONWARD = {
    Mode.DISARMED: Verb.ARM, Mode.HOLD: Verb.TENSION, Mode.FAULT: Verb.RESET, Mode.RELEASING: Verb.HOLD,
    Mode.TENSIONING: Verb.TARE, Mode.COMPENSATING: Verb.RELEASE,
}  # fmt: skip
"""Half of the commands, so that the modes follow each other."""
ENDS_S = 50
"""Half seconds, in which the longest read-back and trial end."""


def _ids(replies: npt.NDArray[Any]) -> Iterator[int]:
    for reply in replies:
        id_ = int(reply["id"])
        yield HOLD_ID if id_ & HOLD_ID else id_


@pytest.mark.parametrize("begins", [Mode.DISARMED, Mode.COMPENSATING, Mode.RELEASING])
def test_every_command_is_answered_exactly_once(settings: RigSettings, gains: Gains, begins: Mode) -> None:
    draw, given, replies, modes = random.Random(5), Counter[int](), Counter[int](), set[Mode]()
    with lockstep(settings, gains) as rig:
        if begins is not Mode.DISARMED:
            bring_to_target(rig, settings.tension.target_n, 0.1)
        if begins is Mode.RELEASING:
            rig.command(Verb.RELEASE)
        assert rig.loop.machine.mode is begins
        reader = rig.runtime.replies.reader()
        for _ in range(GIVEN):
            mode = rig.loop.machine.mode
            if draw.random() < 0.15:
                rig.holds.append(Hold(0, 0, "test"))
                given[HOLD_ID] += 1
            verb = ONWARD[mode] if draw.random() < 0.5 else draw.choice(list(Verb))
            given[rig.give(verb, *VALUES.get(verb, ()))] += 1
            rig.run(draw.choice(GAPS_S))
            modes.add(rig.loop.machine.mode)
            replies.update(_ids(reader.read()))
        given[rig.give(Verb.HOLD)] += 1
        for _ in range(ENDS_S):
            whole = replies == given
            rig.run(0.5)  # once more than it takes, for a second answer
            replies.update(_ids(reader.read()))
            if whole:
                break
    assert replies == given
    assert len(modes) >= 2
