"""A ledger entry that was written but not put in force: the next gateway makes ledger and loop agree.

An entry is on record before the loop gets its settings. In between, the gateway may be killed or the loop may give no
answer. The newest entry is then sent to the loop again; if the loop refuses it (it moves, or the rope is loaded), the
entry is withdrawn. Any other difference means that somebody else changed the ledger; such a change takes effect at the
next start of the daemon.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from rigctl.config.settings import RigSettings
from rigctl.control.events import Kind
from rigctl.control.modes import Setting
from rigctl.ipc import ledger
from rigctl.ipc.ledger import Entry, Standing, in_force
from rigctl.ipc.runtime_folder import Runtime

Pair = tuple[float, float]


@dataclass(frozen=True)
class LeftOver:
    """``entry`` is on record but not in force; ``settings`` puts it in force, None where that cannot be known."""

    entry: Entry
    standing: Standing
    settings: tuple[tuple[Setting, float], ...] | None

    @property
    def pair(self) -> Pair:
        """Zero in N and scale, as on record."""
        return self.standing.zero_n, self.standing.scale

    def __str__(self) -> str:
        """The entry's name for messages."""
        return f"the {self.entry.what} by {self.entry.operator} of {self.entry.when}"


def loop_has(runtime: Runtime) -> Pair:
    """Zero in N and scale that the loop uses, from its newest CORRECTION event."""
    events = runtime.event_reader(from_start=True).read()
    corrections = events[events["kind"] == Kind.CORRECTION]
    if len(corrections):
        return float(corrections["value"][-1]), float(corrections["limit"][-1])
    standing = in_force(runtime)
    return standing.zero_n, standing.scale


def find(settings: RigSettings, entries: Sequence[Entry], has: Pair, now: Standing, wall_ns: int) -> LeftOver | None:
    """The ledger's newest entry if the loop does not use it; ``has``: what it uses, ``now``: what was last in force."""
    if not entries or settings.calibration is None:
        return None
    wanted = ledger.standing(settings, entries, wall_ns)
    pair, newest = (wanted.zero_n, wanted.scale), entries[-1]
    if (*pair, wanted.due) == (now.zero_n, now.scale, now.due) and pair == has:
        return None
    before = newest.before.get("zero_n"), newest.before.get("scale")
    own = newest.what in ("tare", "calibrate") and has in (before, pair)
    if not own:
        return LeftOver(newest, wanted, None)
    changed = zip((Setting.ZERO, Setting.SCALE), pair, has, strict=True)
    settings_to_give = tuple((setting, value) for setting, value, old in changed if value != old)
    return LeftOver(newest, wanted, settings_to_give)
