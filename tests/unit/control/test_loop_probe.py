"""The probe in the loop: what it has found ends with the multisine."""

from __future__ import annotations

from rigctl.config import rig_file as config
from rigctl.control.excitation.loop_probe import LoopProbe
from rigctl.control.excitation.margin_probe import GROW_S, SETTLED_S
from rigctl.control.excitation.probe_plan import plan
from rigctl.control.excitation.sensor_probe import ProbeFinding
from rigctl.control.snapshot import Snapshot
from rigctl.design.gains import design
from tests.builders.paths import ROOT

PAPER = config.load(ROOT / "config/paper_rig.yaml")
RATE = PAPER.loop.rate_hz
NOTHING_MOVES = Snapshot(tension_n=300.0, stroke_mm=50.0)


def shown(probe: LoopProbe) -> tuple[bool, ...]:
    """What the rows read after the next look."""
    probe.look(NOTHING_MOVES, 1.0, 300.0, ramping=False, compensating=True)
    seen = probe.seen
    return seen.cell_frozen, seen.encoder_stuck, seen.drive_motionless, seen.rope_changed


def test_what_was_found_ends_with_the_multisine_and_is_found_anew() -> None:
    planned = plan(PAPER, design(PAPER))
    probe = LoopProbe(PAPER, planned, 1e-5)
    most_s = SETTLED_S + GROW_S + planned.detection_s + planned.period_s
    for _ in range(2):
        speed_mm_s = 0.0
        for _ in range(round(most_s * RATE)):
            speed_mm_s = probe.speed_mm_s(NOTHING_MOVES, speed_mm_s, 1, free=True)
            if probe.found is not ProbeFinding.NONE:
                break
        assert probe.found is ProbeFinding.DRIVE_MOTIONLESS
        assert shown(probe) == (False, False, True, False)
        assert probe.speed_mm_s(NOTHING_MOVES, 0.0, 1, free=False) == 0.0
        assert probe.found is ProbeFinding.NONE
        assert shown(probe) == (False, False, False, False)
