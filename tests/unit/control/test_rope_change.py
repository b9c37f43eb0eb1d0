"""The stiffness in the probe's windows: constant under noise that both signals share, and a change of it is found."""

from __future__ import annotations

import numpy as np

from rigctl.config import rig_file as config
from rigctl.control.excitation.probe_plan import LEAST_CHANGE, ProbePlan, plan
from rigctl.control.watch.rope_change import RopeChange
from rigctl.design.gains import design
from tests.builders.paths import ROOT

PAPER = config.load(ROOT / "config/paper_rig.yaml")
STIFFNESS_N_MM = 6.0


def planned() -> ProbePlan:
    return plan(PAPER, design(PAPER))


def play(rope: RopeChange, windows: int, stiffness_n_mm: float, random: np.random.Generator, moves: float = 0.0) -> int:
    """Windows until a change is found, or all of them; the cell's noise, and a payload that ``moves``."""
    of_plan = planned()
    spread = of_plan.silent
    for window in range(windows):
        shared, own, other = (complex(*random.normal(size=2)) for _ in range(3))
        moved = moves * other
        stroke = (1.0 + 0.3 * shared) / STIFFNESS_N_MM
        rope.add(stiffness_n_mm * (stroke - moved / STIFFNESS_N_MM) + spread * own, stroke)
        if rope.changed:
            return window + 1
    return windows


def test_a_changed_stiffness_is_found_in_the_time_printed_and_its_value_is_right() -> None:
    for factor in (1.0 + LEAST_CHANGE, 1.0 - LEAST_CHANGE):
        random, rope = np.random.default_rng(3), RopeChange(planned())
        before = 3 * planned().rope_windows
        assert play(rope, before, STIFFNESS_N_MM, random) == before
        assert not rope.changed
        assert play(rope, 1000, factor * STIFFNESS_N_MM, random) <= planned().rope_windows + 1
        assert abs(rope.before_n_mm / STIFFNESS_N_MM - 1.0) < 0.15
        rope.forget()
        assert not rope.changed


def test_neither_noise_nor_a_payload_that_moves_is_a_change() -> None:
    for seed, moves in ((1, 0.0), (2, 0.0), (3, 1.0), (4, 3.0)):
        rope = RopeChange(planned())
        play(rope, 4000, STIFFNESS_N_MM, np.random.default_rng(seed), moves)
        assert not rope.changed
