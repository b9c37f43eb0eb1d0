"""Faults of the daemon's processes: their judgement, and a few of them on the real daemon."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hil.faults import gateway_kills as gateway
from hil.faults import kills, processes
from hil.faults.expected import Reaction
from hil.faults.processes import Seen, judged
from hil.faults.rows.live_rows_rig import live
from hil.truth import TRUTH_DTYPE
from rigctl.config import rig_file as config
from rigctl.config.changed_settings import changed
from rigctl.ipc.record import RECORD
from rigctl.model.states import Mode
from tests.builders.paths import ROOT

RIG = ROOT / "config/paper_rig.yaml"
# The machine is shared with other tests: limits of time are wide, except for the drive's own stop.
PATIENT = (
    ("safety.stale_ms", 100), ("safety.bus_silent_ms", 100), ("safety.inclination_stale_ms", 500),
    ("safety.overrun_ticks", 900), ("cylinder.command_deadline_ms", 60), ("cylinder.heartbeat_timeout_ms", 90),
    ("tension.target_n", 100.0), ("safety.waiver", "a simulated rig on a machine that pauses"),
)  # fmt: skip
STILL = Seen(Mode.DISARMED, "NONE", 40.0, 0.2, 1.0, 0.0, 299.0, 300.0, tripped=False, carried=True)


# -- judgement ------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("seen", "words"),
    [
        (STILL, []),
        (replace(STILL, stopped_ms=101.0), ["moves for 101 ms, expected at most 100"]),
        (replace(STILL, moved_mm=1.1), ["stroke moved 1.10 mm, expected at most 1"]),
        (replace(STILL, tension_off_n=9.5), ["tension 9.5 N off, expected at most 9"]),
        (replace(STILL, carried=False), ["load not carried"]),
        (replace(STILL, mode_after=Mode.HOLD), ["then HOLD, not DISARMED or FAULT"]),
    ],
)
def test_a_loop_that_has_gone_leaves_the_load_where_it_was(seen: Seen, words: list[str]) -> None:
    reaction, findings = judged(Reaction.DRIVE_STOPS, seen, Mode.COMPENSATING)
    assert findings == words
    assert reaction is (Reaction.MOVES if seen.stopped_ms > 100.0 else Reaction.DRIVE_STOPS)


@pytest.mark.parametrize(
    ("mode", "seen", "words"),
    [
        (Mode.COMPENSATING, replace(STILL, mode_after=Mode.COMPENSATING), []),
        (Mode.COMPENSATING, replace(STILL, mode_after=Mode.COMPENSATING, setpoint_off_n=10.0),
         ["tension 10.0 N off its set-point, expected at most 9"]),
        (Mode.TENSIONING, replace(STILL, mode_after=Mode.COMPENSATING, moved_mm=8.0, tension_off_n=40.0), []),
        (Mode.TENSIONING, replace(STILL, mode_after=Mode.FAULT, fault="OVERRUN", tripped=True), ["tripped: OVERRUN"]),
        (Mode.HOLD, replace(STILL, mode_after=Mode.HOLD, moved_mm=1.5), ["stroke moved 1.50 mm, expected at most 1"]),
        (Mode.RELEASING, replace(STILL, mode_after=Mode.DISARMED), ["then DISARMED"]),
    ],
)  # fmt: skip
def test_a_loop_that_goes_on_must_not_notice(mode: Mode, seen: Seen, words: list[str]) -> None:
    assert judged(Reaction.RIDDEN, seen, mode)[1] == words


def test_a_kept_fault_is_not_left() -> None:
    assert judged(Reaction.KEPT, replace(STILL, mode_after=Mode.FAULT), Mode.FAULT) == (Reaction.KEPT, [])
    assert judged(Reaction.KEPT, replace(STILL, mode_after=Mode.HOLD), Mode.FAULT)[1] == ["FAULT was left"]


def test_the_truth_tells_when_the_stroke_stopped_and_how_far_it_went() -> None:
    truth = np.zeros(300, TRUTH_DTYPE)
    truth["t_ns"] = np.arange(300) * 1_000_000
    truth["speed_mm_s"][:141] = 8.0
    truth["stroke_mm"] = np.minimum(np.arange(300), 140) * 8e-3
    truth["tension_n"] = 200.0 + 6.0 * truth["stroke_mm"]
    seen = processes.seen(truth, np.zeros(0, RECORD.dtype), 100_000_000, Mode.DISARMED, "NONE")
    assert seen.stopped_ms == pytest.approx(27.0)  # the stroke stays within 0.1 mm from there on
    assert seen.moved_mm == pytest.approx(0.32)
    assert seen.tension_off_n == pytest.approx(1.92)
    assert seen.carried


def test_lateness_is_compared_with_the_same_run_without_kills() -> None:
    good = gateway.Figures(50, 20.0, 23.9, 0, 100_000, 0, left_compensating=False)
    assert good.ok
    assert not replace(good, killed_p999_us=25.1).ok
    assert not replace(good, lost=1).ok
    assert not replace(good, left_compensating=True).ok


def test_kills_are_counted_and_the_largest_figures_found() -> None:
    found = kills.document(
        [
            kills.Kill("control", "SIGKILL", "HOLD", 0.2, 1.0, ()),
            kills.Kill("gateway", "SIGSTOP", "TENSIONING", None, 2.0, ()),
            kills.Kill("control", "SIGSTOP", "COMPENSATING", 1.2, 0.5, ("stroke moved 1.20 mm, expected at most 1",)),
        ]
    )
    assert (found["moved_max_mm"], found["tension_off_max_pct"], found["bad"]) == (1.2, 2.0, 1)
    assert (found["ok"], found["total"]) == (False, 3)


# -- the real daemon ------------------------------------------------------------------------------------------------
def test_the_load_does_not_notice_what_happens_to_the_daemons_processes() -> None:
    rows = {fault.id: fault for fault in processes.CATALOGUE}
    with live(changed(config.load(RIG), dict(PATIENT))) as rig:
        for name, mode in (
            ("gateway_killed", Mode.COMPENSATING),
            ("disk_full", Mode.HOLD),
            ("recorder_stopped", Mode.COMPENSATING),
            ("all_but_control_stopped", Mode.COMPENSATING),
            ("control_stopped", Mode.COMPENSATING),
            ("config_replaced_killed", Mode.COMPENSATING),
        ):
            found = processes.row_of(rig, rows[name], mode)
            assert found.findings == (), found
    assert not rig.runtime.directory.exists()
