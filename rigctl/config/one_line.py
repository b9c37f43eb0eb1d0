"""Words from outside, as an error on one line can quote them."""

from __future__ import annotations

LONGEST_SHOWN = 300


def printable(text: str) -> str:
    """What a terminal would not show, or take for a line's end, in its escaped form; the rest as it is."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text)


def on_one_line(text: str) -> str:
    """Printable, and cut where it goes on and on."""
    shown = text if text.isprintable() else ascii(text)[1:-1]
    return shown if len(shown) <= LONGEST_SHOWN else f"{shown[:LONGEST_SHOWN]}..."
