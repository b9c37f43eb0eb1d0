"""Told to end by a signal, without a lock.

``threading.Event`` will not do: a handler runs in the main thread, and one that sets the event that very thread is
waiting on, or is just setting, waits for a lock that is its own. A gateway that hung like this kept its port.
"""

from __future__ import annotations

import signal
from collections.abc import Callable
from types import FrameType

ENDING = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)
"""Signals that end a process in order: told to, Ctrl-C, its terminal has gone."""


def heeded(*numbers: signal.Signals) -> list[signal.Signals]:
    """Those of them to act on: not a SIGHUP that this process was started to ignore, as ``nohup`` does."""
    return [n for n in numbers if n is not signal.SIGHUP or signal.getsignal(n) is not signal.SIG_IGN]


def on_signals(handler: Callable[[int, FrameType | None], object], *numbers: signal.Signals) -> None:
    """Have ``handler`` called on those that are `heeded`."""
    for number in heeded(*numbers):
        signal.signal(number, handler)


class Termination:
    """Whether a signal has asked the process to end."""

    def __init__(self, *numbers: signal.Signals) -> None:
        """``numbers``: signals that ask for it, from now on."""
        self.requested = False
        on_signals(self._on_signal, *numbers)

    def _on_signal(self, _number: int, _frame: FrameType | None) -> None:
        self.requested = True
