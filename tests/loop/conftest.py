"""The real loop against the simulated rig, in lockstep."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest

from hil.lockstep import Lockstep, lockstep
from rigctl.config import rig_file as config
from rigctl.config.settings import RigSettings
from rigctl.control.modes import Mode, Refusal, Verb
from rigctl.control.tension import Gains
from rigctl.design.margins import design_and_check
from tests.builders.paths import ROOT


@pytest.fixture(scope="session")
def settings() -> RigSettings:
    return config.load(ROOT / "config/paper_rig.yaml")


@pytest.fixture(scope="session")
def gains(settings: RigSettings) -> Gains:
    return design_and_check(settings).gains


@pytest.fixture
def rig(settings: RigSettings, gains: Gains) -> Iterator[Lockstep]:
    """A running rig, DISARMED, every signal fresh."""
    with lockstep(settings, gains) as subject:
        subject.run(0.2)
        yield subject


@pytest.fixture
def enter(rig: Lockstep) -> Callable[[Mode], None]:
    """Take the rig to a mode as an operator does."""

    def to(mode: Mode) -> None:
        if mode is Mode.DISARMED:
            return
        assert rig.command(Verb.ARM) is Refusal.NONE
        if mode in (Mode.TENSIONING, Mode.COMPENSATING, Mode.RELEASING):
            assert rig.command(Verb.TENSION) is Refusal.NONE
            rig.run(2.0)
        if mode in (Mode.COMPENSATING, Mode.RELEASING):
            rig.run_until(Mode.COMPENSATING, 10.0)
            rig.run(0.5)
        if mode is Mode.RELEASING:
            assert rig.command(Verb.RELEASE) is Refusal.NONE
            rig.run(1.0)
        assert rig.loop.machine.mode is mode

    return to
