"""What fits into a narrow terminal: values before words."""

from __future__ import annotations

import io
import pathlib
from typing import Any

import pytest
from rich.console import Console

from rigctl import check, config

RIG = config.load(pathlib.Path(__file__).parents[2] / "config/paper_rig.yaml")


def shown(width: int) -> list[str]:
    out = io.StringIO()
    check.show(RIG, Console(file=out, width=width))
    return out.getvalue().splitlines()


def leaves(data: dict[str, Any]) -> int:
    return sum(leaves(value) if isinstance(value, dict) else 1 for value in data.values())


@pytest.mark.parametrize("width", [30, 40, 60, 80, 200])
def test_check_shows_every_value_at_any_width(width: int) -> None:
    lines = shown(width)
    text = "".join("".join(lines).split())
    for key, value in (("rate_hz", "1000"), ("stroke_max_mm", f"{RIG.cylinder.stroke_max_mm:g}"),
                       ("bitrate_bit_s", str(RIG.can.bitrate_bit_s))):  # fmt: skip
        assert f"{key}{value}" in text or width < 40  # below, keys are broken over lines
    values = [line for line in lines if line.startswith("   ") and len(line.split()) >= 2]
    assert len(values) >= 0.8 * leaves(RIG.model_dump(exclude={"directory", "plain"}))
    assert max(map(len, lines)) <= max(width, 32)


def test_check_tells_units_and_meanings_where_there_is_room() -> None:
    assert any("Hz" in line and "loop rate" in line for line in shown(80))
    assert not any("loop rate" in line for line in shown(40))
