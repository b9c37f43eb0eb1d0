"""Mutations of structured data and of bytes: the effects of a typing error, a broken disk or malice on a file."""

from __future__ import annotations

import copy
import math
import random
from collections.abc import Callable, Iterator
from typing import Any

ODD: tuple[Any, ...] = (
    None, True, False, 0, -1, 1, 0.0, -0.0, 1e-300, 1e300, -1e300, 2**31, 2**63, 2**64, -(2**63) - 1, 10**400, math.nan,
    math.inf, -math.inf, 0.1, 1e-9, "", " ", "a", "NaN", "1.0", "0x10", "12:30", "../..", "/dev/null", "a\nb", "a\x00b",
    "\u202eabc", "\ud7ff", "é" * 50, "x" * 5000, [], {}, [[]], [{}], {"a": 1}, [None], [1, 2, 3], {"": ""},
    "2026-11-21",
)  # fmt: skip
_DEPTHS = (3, 60, 3000)
_SLIPS = ("", "x", " ", "\n", "é", "\u2028", "%s", "{}", "#", ": ")
_MARKS = (b"\n", b"\t", b"\x00", b"\xff", b"  ", b"- ", b"*a", b"&a ", b"!!", b"{", b"}")
_WORDS = (b"\xef\xbb\xbf", b"\xed\xa0\x80", "é\u2028".encode(), b"1e999", b"--- ", b"%")


def data(document: Any, chance: random.Random) -> Any:
    """A copy of a document of mappings, lists and values, with one to four changes in it."""
    changed = copy.deepcopy(document)
    for _ in range(chance.choice((1, 1, 1, 2, 4))):
        places = list(_places(changed))
        if not places:
            return chance.choice(ODD)
        holder, key = chance.choice(places)
        chance.choice(_CHANGES)(holder, key, chance)
    return changed


def _places(document: Any) -> Iterator[tuple[Any, Any]]:
    """Every value but the document itself, as its container and its key."""
    keys = document.keys() if isinstance(document, dict) else range(len(document)) if isinstance(document, list) else ()
    for key in keys:
        yield document, key
        yield from _places(document[key])


def _delete(holder: Any, key: Any, _chance: random.Random) -> None:
    del holder[key]


def _odd(holder: Any, key: Any, chance: random.Random) -> None:
    holder[key] = copy.deepcopy(chance.choice(ODD))


def _nudge(holder: Any, key: Any, chance: random.Random) -> None:
    """Numbers stay numbers, names stay nearly names: changes that only a check of the value can refuse."""
    found = holder[key]
    if isinstance(found, bool):
        holder[key] = not found
    elif isinstance(found, int):
        near = float(found) if abs(found) < 1 << 1000 else math.inf  # the number may come from an earlier mutation
        holder[key] = chance.choice((found + 1, found - 1, -found, found * 2, found // 2, found * 1000, near))
    elif isinstance(found, float):
        factor = chance.choice((-1.0, 0.5, 0.9, 1.1, 2.0, 10.0, 0.01, 1e6, 1e-6))
        holder[key] = chance.choice((found * factor, round(found) if math.isfinite(found) else 0))
    elif isinstance(found, str):
        at = chance.randrange(len(found) + 1)
        holder[key] = found[:at] + chance.choice(_SLIPS) + found[at + 1 :]
    else:
        _odd(holder, key, chance)


def _nest(holder: Any, key: Any, chance: random.Random) -> None:
    for _ in range(chance.choice(_DEPTHS)):
        holder[key] = [holder[key]] if chance.random() < 0.5 else {"a": holder[key]}
        if chance.random() < 0.5:
            return


def _duplicate(holder: Any, key: Any, chance: random.Random) -> None:
    if isinstance(holder, list):
        holder.insert(chance.randrange(len(holder) + 1), copy.deepcopy(holder[key]))
    else:
        holder[f"{key}{chance.choice(('', '_', '2', 'é'))}x"] = copy.deepcopy(holder[key])


def _exchange(holder: Any, key: Any, chance: random.Random) -> None:
    other = chance.choice(list(holder) if isinstance(holder, dict) else range(len(holder)))
    holder[key], holder[other] = holder[other], holder[key]


def _rename(holder: Any, key: Any, chance: random.Random) -> None:
    value = holder.pop(key)
    name = chance.choice(("", "x", str(key).upper(), f"{key} ", 1, None, True, "a" * 300, "a.b"))
    if isinstance(holder, dict):
        holder[name] = value


_CHANGES: tuple[Callable[[Any, Any, random.Random], None], ...] = (
    _nudge, _nudge, _nudge, _nudge, _odd, _odd, _delete, _duplicate, _exchange, _rename, _nest,
)  # fmt: skip


def raw(text: bytes, chance: random.Random) -> bytes:
    """Bytes with some of them changed, left out, doubled, or cut off."""
    changed = bytearray(text)
    for _ in range(chance.choice((1, 1, 2, 8, 40))):
        at, length = chance.randrange(len(changed) + 1), chance.choice((1, 1, 4, 40))
        match chance.randrange(7):
            case 0:
                changed[at : at + length] = chance.randbytes(length)
            case 1:
                del changed[at : at + length]
            case 2:
                changed[at:at] = changed[at : at + length]
            case 3:
                changed[at:at] = chance.choice(_MARKS)
            case 4:
                changed[at:at] = chance.choice(_WORDS)
            case 5:
                lines = bytes(changed).splitlines(keepends=True) or [b""]
                lines.insert(chance.randrange(len(lines)), chance.choice(lines))
                changed = bytearray(b"".join(lines))
            case _:
                changed = changed[:at] if chance.random() < 0.1 else changed
    return bytes(changed)
