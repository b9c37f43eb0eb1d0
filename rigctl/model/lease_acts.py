"""The vocabulary of the lease: what an operator does about it, why he is refused, the form of its id."""

from __future__ import annotations

import re
from enum import Enum

ID_BYTES = 16
_ID = re.compile(rf"[0-9a-f]{{{2 * ID_BYTES}}}")


def is_id(text: str) -> bool:
    """Whether ``text`` has the form of a lease's id."""
    return _ID.fullmatch(text) is not None


class LeaseAct(Enum):
    """Requests about the lease itself; the value is the key's ending."""

    TAKE = "lease_take"
    RETURN = "lease_return"


ACTS = {act.value: act for act in LeaseAct}


class Denial(Enum):
    """Why a command or a request about the lease is refused; the value is the answer's ``reason``."""

    HELD = "lease_held"  # by another operator, terminal or program
    LAPSED = "lease_lapsed"  # the id shown is not in force, and nobody holds a lease
    NOT_HELD = "lease_not_held"  # nothing to give back
