"""The page with its parts numbered: ``python -m tests.page_parts docs/pictures`` draws on the picture of a silent cell.

docs/operate.md names the parts. Taken anew after `tests.page_shots`, whose picture it needs.
"""

from __future__ import annotations

import argparse
import pathlib

import matplotlib
from PIL import Image, ImageDraw, ImageFont

UNDER, OVER = "page-cell-silent.png", "page-parts.png"
PARTS = {
    "mode": (690, 79), "entry": (1450, 180), "tension": (1545, 79), "cause": (1140, 264), "next": (1878, 264),
    "rig": (45, 480), "charts": (1222, 462), "alarms": (1870, 600), "devices": (1870, 905), "HOLD": (26, 962),
    "commands": (1090, 996), "lease": (1565, 1046), "views": (790, 27),
}  # fmt: skip
"""Where the number of each part is, in pixels, in the order of the numbers."""
RADIUS = 24
COLOURS = 64


def drawn(under: pathlib.Path) -> Image.Image:
    """The picture with a number on each part."""
    picture = Image.open(under).convert("RGB")
    font = ImageFont.truetype(f"{matplotlib.get_data_path()}/fonts/ttf/DejaVuSans-Bold.ttf", 30)
    draw = ImageDraw.Draw(picture)
    for number, (x, y) in enumerate(PARTS.values(), 1):
        draw.ellipse((x - RADIUS, y - RADIUS, x + RADIUS, y + RADIUS), fill="#0b5394", outline="white", width=4)
        draw.text((x, y), str(number), fill="white", font=font, anchor="mm")
    return picture.quantize(COLOURS)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(prog="python -m tests.page_parts", description="Number the parts of the page.")
    parser.add_argument("folder", type=pathlib.Path, help="of the pictures")
    folder = parser.parse_args().folder
    drawn(folder / UNDER).save(folder / OVER, optimize=True)
