"""Types of messages and files, complete before a thread uses them."""

from __future__ import annotations

from typing import TypeVar

import msgspec

_Type = TypeVar("_Type")


def built(kind: _Type) -> _Type:
    """Let msgspec build now what it decodes a type by; a decorator of every type that is decoded or converted to.

    msgspec (0.22) builds that at the type's first use, in Python code that lets other threads run, and keeps it with
    the type before it is complete: a second thread that decodes the type meanwhile crashes the process.
    """
    msgspec.json.Decoder(kind)
    return kind
