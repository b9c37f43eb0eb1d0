"""``rigctl status`` of a bus that is cut while the rig compensates, as a terminal of 80 columns prints it."""

from __future__ import annotations

import math

import pytest

from hil.faults import on_bus
from hil.faults.stand import Stand
from hil.lockstep import Lockstep
from rigctl.cli import status
from rigctl.model.states import Mode
from tests.loop.test_causes import Shown

COLUMNS = 80


def printed(shown: Shown, capsys: pytest.CaptureFixture[str], *, all_: bool = False) -> list[str]:
    """The lines that the command prints of the rig as it is."""
    state = shown.state()
    alarms, now_ns = shown.alarms(state)
    capsys.readouterr()
    status._show(state, "tcp/127.0.0.1:7447", alarms, now_ns, "Q1", all_=all_)
    return capsys.readouterr().out.splitlines()


@pytest.mark.starts_in(Mode.COMPENSATING)
@pytest.mark.parametrize("after_s", [0.5, 5.0])
def test_a_cut_bus_is_what_to_do_first_in_eight_lines(
    rig: Lockstep, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, after_s: float
) -> None:
    """It had been some 70 lines: each cause twice, as active and as what follows, and values that are not known."""
    monkeypatch.setenv("COLUMNS", str(COLUMNS))
    shown = Shown(rig)
    on_bus.burst(math.inf)(Stand(rig, "cut"))
    rig.run(after_s)
    lines = printed(shown, capsys)
    assert all(len(line) <= COLUMNS for line in lines)
    labels = [line[:11].strip() for line in lines]
    assert labels[:3] == ["rig", "mode", "load"]
    head = labels.index("fault")
    assert len(lines) - head <= status.LINES
    assert [label for label in labels[head:-1] if label][:4] == ["fault", "culprit", "next step", "alarms"]
    text = " ".join(" ".join(lines).split())
    for words in (
        "FAULT KEEP OUT: nothing valid is heard of the drive", "load not known what holds the load",
        "fault BUS_SILENT: no frame on the bus for 16 ms (limit 15 ms)", "culprit bus or its power supply",
        "Check the CAN interface, cable, termination and the devices' power, away from the load.",
        "alarms URGENT BUS_SILENT +",
    ):  # fmt: skip
        assert words in text
    everything = printed(shown, capsys, all_=True)
    assert lines[-1] == f"{len(everything) - len(lines) + 1} lines more: rigctl status --all"
    assert len(everything) > 60
    named = " ".join(" ".join(everything).split())
    assert all(words in named for words in ("active CELL_STALE", "blocks reset", "follows", "lateness", "lease"))
