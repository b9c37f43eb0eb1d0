"""The real loop against the simulated rig, in lockstep."""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable, Iterator

import pytest

from hil.lockstep import Lockstep, lockstep
from hil.operated_rig import arm_and_tension
from rigctl.config import rig_file as config
from rigctl.config.settings import RigSettings
from rigctl.control.law.tension import Gains
from rigctl.design.margins import design_and_check
from rigctl.model.states import Mode
from rigctl.model.verbs import Verb
from tests.builders.branches import Started, pytest_pyfunc_call
from tests.builders.paths import ROOT

__all__ = ["pytest_pyfunc_call"]


@pytest.fixture(scope="session")
def settings() -> RigSettings:
    return config.load(ROOT / "config/paper_rig.yaml")


@pytest.fixture(scope="session")
def gains(settings: RigSettings) -> Gains:
    return design_and_check(settings).gains


@pytest.fixture
def rig_settings(settings: RigSettings) -> RigSettings:
    """Rig file of the fixture ``rig``: the paper's, where a module has no other."""
    return settings


StartedIn = Callable[[RigSettings, Gains, Mode], Started]


@pytest.fixture(scope="session")
def started() -> Iterator[StartedIn]:
    """Rigs in a mode, into which an operator has taken each once."""
    found: dict[tuple[str, Gains, Mode], Started] = {}
    with contextlib.ExitStack() as rigs:

        def started_in(settings: RigSettings, gains: Gains, mode: Mode) -> Started:
            key = settings.model_dump_json(), gains, mode
            if key not in found:
                subject = rigs.enter_context(lockstep(settings, gains))
                subject.run(0.2)
                entered(subject, mode)
                found[key] = Started.now(subject)
            return found[key]

        yield started_in


@pytest.fixture
def rig(
    request: pytest.FixtureRequest, rig_settings: RigSettings, gains: Gains, started: StartedIn
) -> Iterator[Lockstep]:
    """A running rig, every signal fresh: DISARMED, or in the mode that the mark ``starts_in`` or a parameter names."""
    mark = request.node.get_closest_marker("starts_in")
    mode = mark.args[0] if mark is not None else getattr(request, "param", None)
    if mode is not None:
        mode = request.node.callspec.params[mode] if isinstance(mode, str) else mode
        yield started(rig_settings, gains, mode).go_on(request)
        return
    with lockstep(rig_settings, gains) as subject:
        subject.run(0.2)
        yield subject


@pytest.fixture
def enter(rig: Lockstep) -> Callable[[Mode], None]:
    """Take the rig to a mode as an operator does."""
    return functools.partial(entered, rig)


def entered(rig: Lockstep, mode: Mode) -> None:
    """Take a rig to a mode as an operator does."""
    if mode in (Mode.COMPENSATING, Mode.RELEASING):
        arm_and_tension(rig, limit_s=12.0, settle_s=0.5)
    elif mode is not Mode.DISARMED:
        rig.do(Verb.ARM)
    if mode is Mode.TENSIONING:
        rig.do(Verb.TENSION)
        rig.run(2.0)
    if mode is Mode.RELEASING:
        rig.do(Verb.RELEASE)
        rig.run(1.0)
    assert rig.loop.machine.mode is mode
