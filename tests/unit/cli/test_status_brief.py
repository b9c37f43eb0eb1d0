"""``rigctl status``: at most eight lines below its head in every mode and fault, and how many more there are."""

from __future__ import annotations

import itertools
import time

import pytest

from rigctl.cli import status
from rigctl.model.faults import Fault
from rigctl.model.states import Mode
from rigctl.wire.mode_origin import Origin
from rigctl.wire.state_words import began
from tests.builders.page_states import LOCK_OUT, Shown, catalogue, picture_of, state, tripped

HEAD = ("rig", "mode", "load")
EACH = 7
"""Of the catalogue's states, whose blocks of five losses, two carriers and two conditions it does not divide."""


def printed(shown: Shown, capsys: pytest.CaptureFixture[str], *, all_: bool = False) -> list[str]:
    now_ns = time.time_ns()
    rows = picture_of(shown).alarms.rows(shown.state, now_ns)
    capsys.readouterr()
    status._show({"rig": "paper_rig", **shown.state}, "tcp/127.0.0.1:7447", rows, now_ns, LOCK_OUT, all_=all_)
    return capsys.readouterr().out.splitlines()


def test_every_state_fits_and_says_how_much_is_left_out(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    for shown in itertools.islice(catalogue(), 0, None, EACH):
        lines, everything = printed(shown, capsys), printed(shown, capsys, all_=True)
        labels = [line[:11].strip() for line in lines]
        assert tuple(labels[:2]) == HEAD[:2], shown.name
        first = next(at for at, label in enumerate(labels) if label and label not in HEAD)
        assert len(lines) - first <= status.LINES, (shown.name, lines)
        assert "next step" in labels, shown.name
        if shown.state["fault"]:
            assert f"fault      {shown.state['fault']}: " in "\n".join(lines), shown.name
        more = len(everything) - len(lines)
        if lines[-1].endswith("rigctl status --all"):
            assert lines[-1] == f"{more + 1} line{'s' if more else ''} more: rigctl status --all", shown.name
        else:
            assert more <= 0, shown.name


def test_a_narrow_terminal_has_what_is_wrong_and_the_first_step_whole(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "30")
    lines = printed(Shown("", state(Mode.FAULT, fault=Fault.BUS_SILENT), tripped(Fault.BUS_SILENT)), capsys)
    text = " ".join(" ".join(lines).split())
    assert "BUS_SILENT: no frame on the bus for 12 ms (limit 5 ms)" in text
    assert "1 Keep out. To go in: emergency stop, lock out Q1 (24 V stays on). and 3 more" in text


def test_values_that_are_trusted_fill_the_room_of_a_calm_rig(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    lines = printed(Shown("", state(Mode.COMPENSATING)), capsys)
    labels = [label for line in lines[:-1] if (label := line[:11].strip())]
    assert labels == ["rig", "mode", "load", "next step", "tension", "error", "stroke", "warning", "lease"]
    lost = printed(Shown("", state(Mode.COMPENSATING, lost=frozenset({"tension"}))), capsys)
    assert "tension" not in [line[:11].strip() for line in lost]


@pytest.mark.parametrize("all_", [True, False])
def test_who_began_the_mode_is_below_it(capsys: pytest.CaptureFixture[str], all_: bool) -> None:
    origin = Origin(1_700_000_000_000_000_000, "kim: hold commanded")
    status._show(
        {"rig": "paper_rig", **state(Mode.HOLD)}, "tcp/127.0.0.1:7447", [], time.time_ns(), LOCK_OUT, all_=all_,
        began=began(origin),
    )  # fmt: skip
    lines = capsys.readouterr().out.splitlines()
    below = next(at for at, line in enumerate(lines) if line.startswith("mode")) + 1
    assert any(", kim: hold commanded" in line for line in lines[below : below + 2]), lines
