"""Sets of flags, in every Python that runs them: that of Debian 12 is 3.11.2, whose ``~`` may leave out bits."""

from __future__ import annotations

import re
from enum import IntFlag

import pytest

from rigctl.control.power.arming import AWAITED_CHECKS
from rigctl.devices.objects import AiStatus
from rigctl.ipc.record import FrameFlag
from rigctl.model.checks import HOST_CHECKS, Check
from rigctl.model.faults import Trait
from rigctl.model.samples import Quality
from rigctl.model.states import EStop, Flag
from rigctl.model.verbs import VerbTrait
from tests.builders.paths import ROOT

FLAGS: list[type[IntFlag]] = [AiStatus, Check, EStop, Flag, FrameFlag, Quality, Trait, VerbTrait]


def test_every_kind_of_flag_is_looked_at() -> None:
    sources = (file.read_text() for file in (ROOT / "rigctl").rglob("*.py"))
    found = [name for source in sources for name in re.findall(r"^class (\w+)\(\w*Flag\b", source, re.MULTILINE)]
    assert sorted(found) == [kind.__name__ for kind in FLAGS]


@pytest.mark.parametrize("kind", FLAGS)
def test_what_is_left_without_a_flag_is_every_other_one(kind: type[IntFlag]) -> None:
    for one in kind:
        assert [other for other in kind if other & ~one] == [other for other in kind if other is not one]


@pytest.mark.parametrize("some", [AWAITED_CHECKS, HOST_CHECKS, Check(0)])
def test_what_is_left_without_several_checks_is_every_other_one(some: Check) -> None:
    assert {*(~some), *some} == set(Check)
    assert not ~some & some
    assert ~~some == some
