"""What the rigs of both fixtures have in common: how an operator takes them to where they work."""

from __future__ import annotations

from abc import ABC, abstractmethod

COMPENSATING_LIMIT_S = 120.0


class CommandRefusedError(AssertionError):
    """The loop has refused a command, so the test has failed; ``str()`` is one line."""


class SimulatedTimeoutError(AssertionError):
    """The test has used up its time; ``str()`` is one line."""


class OperatedRig(ABC):
    """A rig that takes commands, in simulated or in real time."""

    @abstractmethod
    def do(self, verb: str) -> None:
        """Give a command that has to be accepted."""

    @abstractmethod
    def run(self, seconds: float) -> object:
        """Let time pass."""

    @abstractmethod
    def run_until(self, mode: str, limit_s: float) -> object:
        """Let time pass until the loop is in ``mode``."""

    def compensate(self, settle_s: float = 2.0) -> None:
        """Arm, tension and settle: the state in which the rig works.

        Raises:
            CommandRefusedError: a command was refused.
            SimulatedTimeoutError: the rig does not get there.
        """
        self.do("arm")
        self.do("tension")
        self.run_until("COMPENSATING", COMPENSATING_LIMIT_S)
        self.run(settle_s)
