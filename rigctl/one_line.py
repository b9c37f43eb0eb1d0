"""Words from outside, as an error on one line can quote them."""

from __future__ import annotations

LONGEST_SHOWN = 300


def on_one_line(text: str) -> str:
    """Printable, and cut where it goes on and on."""
    shown = text if text.isprintable() else ascii(text)[1:-1]
    return shown if len(shown) <= LONGEST_SHOWN else f"{shown[:LONGEST_SHOWN]}..."
