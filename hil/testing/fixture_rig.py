"""What the rigs of both fixtures have in common."""

from __future__ import annotations

from hil.operated_rig import CommandRefusedError, OperatedRig, arm_and_tension
from rigctl.model.states import Mode
from rigctl.model.verbs import Verb


class SimulatedTimeoutError(AssertionError):
    """The test has used up its time; ``str()`` is one line."""


class RefusedInTestError(CommandRefusedError, AssertionError):
    """The loop has refused a command, so the test has failed; ``str()`` is one line."""


class FixtureRig(OperatedRig):
    """A rig whose commands and modes a test gives by their names."""

    def compensate(self, settle_s: float = 2.0) -> None:
        """Arm, tension and settle: the state in which the rig works.

        Raises:
            RefusedInTestError: a command was refused.
            SimulatedTimeoutError: the rig does not get there.
        """
        arm_and_tension(self, settle_s=settle_s)


def name_of(given: str | Verb) -> str:
    """The name of a command, as ``rigctl`` has it."""
    return given if isinstance(given, str) else given.name.lower()


def mode_of(given: str | Mode) -> Mode:
    """The mode of a name.

    Raises:
        KeyError: there is no such mode.
    """
    return Mode[given] if isinstance(given, str) else given
