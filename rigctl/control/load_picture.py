"""``python -m rigctl.control.load_picture > docs/pictures/load.svg``: who holds the load over time, as a picture."""

from __future__ import annotations

import sys
from collections.abc import Iterator

from rigctl.control.diagram import WAYS

_COLOURS = {"the motor": "#f4b942", "the brake": "#7a8b99", "nothing": "#ffffff"}
_LEFT, _BAR, _ROW, _TOP = 180, 300, 84, 50
"""Pixels: names at the left, length of a bar, from way to way, above the first."""


def document() -> str:
    """The picture, in SVG: a row for each way, a bar for each part of it."""
    width, height = _LEFT + 3 * _BAR + 10, _TOP + _ROW * len(WAYS)
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" font-family="sans-serif" '
        f'font-size="14">\n<rect width="{width}" height="{height}" fill="#ffffff"/>'
    )
    return "\n".join([head, *_legend(), *_rows(), "</svg>"]) + "\n"


def _legend() -> Iterator[str]:
    for at, (who, colour) in enumerate(_COLOURS.items()):
        x = _LEFT + at * _BAR
        yield f'<rect x="{x}" y="12" width="24" height="16" fill="{colour}" stroke="#333333"/>'
        yield f'<text x="{x + 32}" y="25">{who} holds the load</text>'


def _rows() -> Iterator[str]:
    for row, (way, parts) in enumerate(WAYS.items()):
        y = _TOP + row * _ROW
        yield f'<text x="8" y="{y + 24}" font-weight="bold">{way.replace("`", "")}</text>'
        for at, (stage, who, how) in enumerate(parts):
            x = _LEFT + at * _BAR
            yield f'<rect x="{x}" y="{y}" width="{_BAR}" height="36" fill="{_COLOURS[who]}" stroke="#333333"/>'
            yield f'<text x="{x + 8}" y="{y + 23}">{stage.name}: {who}</text>'
            yield from _lines(how, x + 4, y + 50)


def _lines(words: str, x: int, y: int) -> Iterator[str]:
    """The words below a bar, on two lines."""
    first, second = "", ""
    for word in words.split():
        if second or len(first) + len(word) > 46:
            second = f"{second} {word}".strip()
        else:
            first = f"{first} {word}".strip()
    for line, text in enumerate(filter(None, (first, second))):
        yield f'<text x="{x}" y="{y + 15 * line}" font-size="12">{text}</text>'


if __name__ == "__main__":
    sys.stdout.write(document())
