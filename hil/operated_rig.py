"""One way to drive a rig, in simulated or in real time, and the way to where it works."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from rigctl.model.states import Mode
from rigctl.model.verbs import Verb

COMPENSATING_LIMIT_S = 120.0


class CommandRefusedError(RuntimeError):
    """The loop has refused a command; ``str()`` is one line."""


class OperatedRig(Protocol):
    """A rig that takes an operator's commands."""

    def do(self, verb: Verb, *values: float) -> object:
        """Give a command that has to be accepted, with values in the units of its row.

        Raises:
            CommandRefusedError: it was refused.
        """

    def run(self, seconds: float) -> object:
        """Let time pass."""

    def run_until(self, mode: Mode, limit_s: float) -> object:
        """Let time pass until the loop is in ``mode``; raises where it does not get there within ``limit_s``."""


def arm_and_tension(
    rig: OperatedRig,
    *,
    armed_s: float = 0.0,
    target_n: float | None = None,
    limit_s: float = COMPENSATING_LIMIT_S,
    until: Callable[[Mode, float], object] | None = None,
    settle_s: float = 0.0,
) -> None:
    """Take a rig from DISARMED to COMPENSATING, and settle there: the state in which it works.

    Args:
        rig: every signal of it is fresh.
        armed_s: time in HOLD before it tensions.
        target_n: vertical tension to hold; None leaves it as it is.
        limit_s: longest time of TENSIONING.
        until: waits for the mode in place of ``rig.run_until``.
        settle_s: time in COMPENSATING.

    Raises:
        CommandRefusedError: a command was refused.
    """
    rig.do(Verb.ARM)
    if armed_s:
        rig.run(armed_s)
    if target_n is not None:
        rig.do(Verb.TARGET, target_n)
    rig.do(Verb.TENSION)
    (until or rig.run_until)(Mode.COMPENSATING, limit_s)
    if settle_s:
        rig.run(settle_s)
