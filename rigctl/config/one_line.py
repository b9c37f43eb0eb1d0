"""Text from outside, made fit to be quoted in an error of one line."""

from __future__ import annotations

import re

LONGEST_SHOWN = 300
LONGEST_LINE = 2000
_LONG_WORD = re.compile(rf"(\S{{200}})\S{{{LONGEST_SHOWN - 250},}}(\S{{50}})")


def printable(text: str) -> str:
    """The text with unprintable characters and line ends escaped."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text)


def on_one_line(text: str) -> str:
    """The text, printable and cut to a bounded length."""
    shown = text if text.isprintable() else ascii(text)[1:-1]
    return shown if len(shown) <= LONGEST_SHOWN else f"{shown[:LONGEST_SHOWN]}..."


def wrong_usage(text: str) -> str:
    """What typer says of a command line, in one line without its full stop and the heading of a validator."""
    return " ".join(text.split()).rstrip(".").replace(": Value error, ", ": ")


def complaint(text: str) -> str:
    """A message for standard error of which no word and no line is longer than a reader reads.

    A path or a name given by mistake may have many thousand letters; its ends remain, and what is said of it.
    """
    lines = [_LONG_WORD.sub(r"\1...\2", line) for line in text.split("\n")]
    return "\n".join(line if len(line) <= LONGEST_LINE else f"{line[:LONGEST_LINE]}..." for line in lines)
