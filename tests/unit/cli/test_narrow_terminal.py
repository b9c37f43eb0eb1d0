"""The layout of a narrow terminal: values before words."""

from __future__ import annotations

import io
import time
from collections.abc import Iterator
from typing import Any

import pytest
from rich.console import Console

from rigctl.cli import check
from rigctl.cli.watch_screen import Screen
from rigctl.client.rig_view import RigView
from rigctl.config import rig_file as config
from rigctl.config.settings_base import Settings
from rigctl.devices import busload
from rigctl.wire import state_words as figures
from rigctl.wire.operator_view import view as operator_view
from tests.builders.page_states import ACTIVE, catalogue
from tests.builders.paths import ROOT
from tests.unit.client.test_hostile_messages import EVENT, STATE, view_of

RIG = config.load(ROOT / "config/paper_rig.yaml")


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
        assert f"{key}{value}" in text or width < 40  # in narrower terminals, keys are broken over lines
    values = [line for line in lines if line.startswith("   ") and len(line.split()) >= 2]
    assert len(values) >= 0.8 * leaves(RIG.model_dump(exclude={"directory", "plain"}))
    assert max(map(len, lines)) <= max(width, 32)


def keys_of(section: Settings) -> Iterator[str]:
    for key in type(section).model_fields:
        if key not in ("directory", "plain"):
            yield key
            if isinstance(inner := getattr(section, key), Settings):
                yield from keys_of(inner)


@pytest.mark.parametrize("width", [72, 80, 200])
def test_check_cuts_no_key(width: int) -> None:
    """A pipe has 80 columns."""
    words = {part for line in shown(width) for word in line.split() for part in (word, *word.split("."))}
    assert not set(keys_of(RIG)) - words - {"limits", "dbc", "eds"}
    assert not [line for line in shown(width) if "…" in line], "nor a key that its meaning names"


def test_check_tells_units_and_meanings_where_there_is_room() -> None:
    assert any("Hz" in line and "loop rate" in line for line in shown(80))
    assert not any("loop rate" in line for line in shown(40))


def test_check_breaks_no_name_of_a_frame_at_40_columns() -> None:
    text = "\n".join(shown(40))
    for word in ("inclination", "heartbeat,", "controller", "heartbeats,"):
        assert word in text.split()
    for item in busload.traffic(RIG):
        assert f"{item.bit_s:.0f}" in text.split()


def screen(width: int, height: int = 60) -> list[str]:
    out = io.StringIO()
    Console(file=out, width=width, height=height, highlight=False).print(Screen(view_of()))
    return out.getvalue().splitlines()


@pytest.mark.parametrize("width", [30, 40, 60, 71])
def test_watch_goes_on_in_the_next_line_where_a_terminal_is_narrow(width: int) -> None:
    lines = screen(width)
    text = "".join("".join(lines).split())
    assert max(map(len, lines)) <= width
    assert "…" not in text
    for value in (
        figures.error(STATE), figures.inclination(STATE), figures.percentiles(STATE["work_us"]),
        figures.counters(STATE), figures.calibration(STATE)[0], figures.recorder(STATE)[0], figures.lease(STATE),
        EVENT["text"],
    ):  # fmt: skip
        assert "".join(value.split()) in text


def test_watch_keeps_to_its_height_where_a_terminal_is_narrow() -> None:
    assert len(screen(40, 24)) <= 24


def test_watch_shows_every_step_and_cuts_nothing_in_80_columns_and_24_lines() -> None:
    """Whatever is wrong: the last step is the RESET that the operator looks for."""
    for shown in catalogue():
        view = RigView("tcp/127.0.0.1:1", "paper_rig")
        view.take_state(shown.state)
        view.take_active(ACTIVE)
        view.add_events(shown.events)
        lines = Screen(view).lines(80, 24)[:24]
        assert max(line.cell_len for line in lines) <= 80, shown.name
        if shown.state["mode"] is not None:
            seen = operator_view(shown.state, view.alarms.rows(shown.state, time.time_ns()), "Q1 (24 V stays on)")
            text = "".join("".join(line.plain for line in lines).split())
            assert "".join(seen.next_step.split()) in text, shown.name
