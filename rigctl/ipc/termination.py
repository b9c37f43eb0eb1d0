"""The request by a signal to end, without a lock.

``threading.Event`` does not work here: a handler runs in the main thread, and if that thread is just waiting on the
event or setting it, the handler waits for a lock that its own thread holds. A gateway that hung so kept its port.
"""

from __future__ import annotations

import signal
from collections.abc import Callable
from types import FrameType

ENDING = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)
"""Signals that end a process in order: a request to end, Ctrl-C, loss of its terminal."""
EXIT_STARTS_ANEW = 3
"""Exit code of the control process after a reset of the silence: the next one brings all devices up again."""


def heeded(*numbers: signal.Signals) -> list[signal.Signals]:
    """The signals to act on: all but a SIGHUP that this process was started to ignore, as by ``nohup``."""
    return [n for n in numbers if n is not signal.SIGHUP or signal.getsignal(n) is not signal.SIG_IGN]


def on_signals(handler: Callable[[int, FrameType | None], object], *numbers: signal.Signals) -> None:
    """Call ``handler`` on those of ``numbers`` that are `heeded`."""
    for number in heeded(*numbers):
        signal.signal(number, handler)


class Termination:
    """Whether a signal to end has come, or there is another reason to end."""

    def __init__(self, *numbers: signal.Signals) -> None:
        """``numbers``: signals that end the process."""
        self._signalled = False
        self.also: Callable[[], bool] = lambda: False
        """A further reason to end."""
        on_signals(self._on_signal, *numbers)

    def _on_signal(self, _number: int, _frame: FrameType | None) -> None:
        self._signalled = True

    @property
    def requested(self) -> bool:
        """Whether to end."""
        return self._signalled or self.also()
