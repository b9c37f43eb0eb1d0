"""Permitted outcomes of reading an input: accepted, or refused in plain lines. Any other outcome is a bug."""

from __future__ import annotations

import contextlib
import signal
import traceback
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

PATIENCE_S = 60.0  # of processor time, far above any expected: only a hang takes that long
LONGEST_LINE = 4000


class HangsError(BaseException):
    """A reader that does not return; no ``except Exception`` of it can catch this."""


@dataclass
class Tally:
    """Results by name of the input's kind; ``wrong`` lists the outcomes that are bugs."""

    tried: Counter[str] = field(default_factory=Counter)
    taken: Counter[str] = field(default_factory=Counter)
    wrong: list[str] = field(default_factory=list)

    def attempt(
        self,
        name: str,
        what: bytes,
        read: Callable[[], object],
        allowed: tuple[type[Exception], ...],
        *,
        line: bool = True,
    ) -> object | None:
        """Read an input; None if it is refused. ``line``: the refusal is one line, else several, none of them empty."""
        self.tried[name] += 1
        try:
            with patience():
                found = read()
        except allowed as error:
            said = str(error)
            if not plain(said) if line else not all(plain(part) for part in said.split("\n")):
                self.wrong.append(f"{name}: refused in other than plain lines: {said[:300]!r}")
            return None
        except (Exception, HangsError) as error:  # noqa: BLE001 - finding these is the purpose
            place = traceback.extract_tb(error.__traceback__)[-1]
            said = f"{type(error).__name__}: {str(error)[:200]!r} at {place.filename}:{place.lineno}"
            self.wrong.append(f"{name}: {said}, of {what[:2000]!r}")
            return None
        self.taken[name] += 1
        return found if found is not None else True


def plain(said: str) -> bool:
    """Whether a text is one line of limited length that a terminal shows unchanged."""
    return bool(said.strip()) and len(said) <= LONGEST_LINE and said.isprintable()


@contextlib.contextmanager
def patience() -> Iterator[None]:
    """Interrupt a reader that hangs.

    Raises:
        HangsError: the time is over.
    """

    def give_up(_number: int, _frame: object) -> None:
        raise HangsError(f"no answer within {PATIENCE_S:g} s of processor time")

    before = signal.signal(signal.SIGPROF, give_up)
    signal.setitimer(signal.ITIMER_PROF, PATIENCE_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)
