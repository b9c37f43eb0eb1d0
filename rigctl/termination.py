"""Told to end by a signal, without a lock.

``threading.Event`` will not do: a handler runs in the main thread, and one that sets the event that very thread is
waiting on, or is just setting, waits for a lock that is its own. A gateway that hung like this kept its port.
"""

from __future__ import annotations

import signal
from types import FrameType


class Termination:
    """Whether a signal has asked the process to end."""

    def __init__(self, *numbers: signal.Signals) -> None:
        """``numbers``: signals that ask for it, from now on."""
        self.requested = False
        for number in numbers:
            signal.signal(number, self._on_signal)

    def _on_signal(self, _number: int, _frame: FrameType | None) -> None:
        self.requested = True
