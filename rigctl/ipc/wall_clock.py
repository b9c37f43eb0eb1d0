"""Whether the computer's wall clock can be right: without a battery it starts in 1970, and anyone may set it to 2099.

A date on record is only compared with a clock that can be right. If the comparison is not possible, nothing is refused
for its age: a warning names the clock and the date.
"""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime, timedelta

from rigctl import __version__

FIRST = datetime(2026, 1, 1, tzinfo=UTC)  # no date on record is earlier: there was no rigctl
RELEASED = FIRST  # of this version, to be set at each release: a clock that is set reads a later time
SERVICE = timedelta(days=30 * 365)  # of a version, at most
CLOCKS_DIFFER = timedelta(days=1)  # at most, between the wall clocks of two starts


def unset(now: datetime) -> str:
    """Why a clock that reads ``now`` cannot be right, in words; empty if it can."""
    released = f"the release of rigctl {__version__} ({RELEASED:%Y-%m-%d})"
    if now < RELEASED:
        return f"the computer's clock reads {now:%Y-%m-%d}, which is before {released}"
    if now > RELEASED + SERVICE:
        years = SERVICE.days // 365
        return f"the computer's clock reads {now:%Y-%m-%d}, which is more than {years} years after {released}"
    return ""


def age(when: datetime, now: datetime) -> timedelta | None:
    """How long ago a date on record is; None where the date or the clock cannot be right, see `doubt`."""
    return None if unset(now) or not FIRST <= when <= now + CLOCKS_DIFFER else now - when


def doubt(now: datetime, dates: Mapping[str, datetime]) -> str:
    """Why `age` is None for some of the ``dates`` on record, in one line for the operator; empty if it never is.

    ``dates``: by what they are of, in words. A clock that cannot be right is one line without any.
    """
    if why := unset(now):
        return f"{why}: no age or due date is judged by it; set the clock"
    for what, when in dates.items():
        if when > now + CLOCKS_DIFFER:
            reads = f"the computer's clock reads {now:%Y-%m-%d}, which is before {what} ({when:%Y-%m-%d})"
            return f"{reads}: its age is not judged; set the clock, or renew {what} if the clock is right"
        if when < FIRST:
            return f"{what} has the date {when:%Y-%m-%d}, before there was rigctl: its age is not judged; renew it"
    return ""
