"""Text from outside, made fit to be quoted in an error of one line."""

from __future__ import annotations

LONGEST_SHOWN = 300


def printable(text: str) -> str:
    """The text with unprintable characters and line ends escaped."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text)


def on_one_line(text: str) -> str:
    """The text, printable and cut to a bounded length."""
    shown = text if text.isprintable() else ascii(text)[1:-1]
    return shown if len(shown) <= LONGEST_SHOWN else f"{shown[:LONGEST_SHOWN]}..."
