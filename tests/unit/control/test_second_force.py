"""The second force path: weight, fusion, comparison, loss, and what a moving stretch may not do."""

from __future__ import annotations

import math

import numpy as np
import pytest

from rigctl.config import rig_file as config
from rigctl.config.second_force_section import SecondForceSettings
from rigctl.config.settings import RigSettings
from rigctl.control.bus.second_force import COMPARED_S, SecondForce
from rigctl.ipc.correction import Correction
from tests.builders.paths import ROOT

MS = 1_000_000
ZEROED = Correction(second_zero_n=0.0)


def section(**given: object) -> SecondForceSettings:
    return SecondForceSettings.model_validate(
        {"kind": "cell", "u_n": 0.1, "cell_u_n": 0.2, "disagree_n": 1.0, "fuse_s": 2.0} | given
    )


def run(path: SecondForce, second: float, cell_n: float, seconds: float, *, t_ns: int = MS, speed: float = 0.0) -> int:
    """A sample of both each 20 ms; returns the time."""
    for _ in range(round(seconds * 50)):
        t_ns += 20 * MS
        path.take(second, 0, t_ns)
        path.look(cell_n, 0.0, speed, t_ns)
    return t_ns


def test_the_weight_is_that_of_inverse_variances() -> None:
    assert section().weight == pytest.approx(0.8)
    assert section(u_n=0.2).weight == pytest.approx(0.5)


def test_fusion_reaches_the_weighted_mean_with_its_time_constant() -> None:
    path = SecondForce(section(), CELL_N, 1e-3)
    path.put(ZEROED)
    t_ns = run(path, 300.4, 300.0, 2.0)
    assert path.offset_n == pytest.approx(0.8 * 0.4 * -math.expm1(-1.0), rel=0.02)
    run(path, 300.4, 300.0, 20.0, t_ns=t_ns)
    assert path.offset_n == pytest.approx(0.8 * 0.4, rel=1e-3)
    assert path.gap_n == pytest.approx(0.4, rel=1e-6)


def test_fusion_is_bounded_however_wrong_the_second_path_is() -> None:
    path = SecondForce(section(), CELL_N, 1e-3)
    path.put(ZEROED)
    run(path, 400.0, 300.0, 60.0)
    assert path.offset_n == pytest.approx(0.8 * 1.0)


def test_nothing_is_compared_without_a_zero() -> None:
    path = SecondForce(section(), CELL_N, 1e-3)
    run(path, 400.0, 300.0, 5.0)
    assert path.offset_n == path.gap_n == 0.0
    assert math.isnan(path.tension_n)
    assert SecondForce(section(zero_n=5.0), CELL_N, 1e-3).known


def test_another_zero_begins_the_comparison_anew() -> None:
    path = SecondForce(section(), CELL_N, 1e-3)
    path.put(ZEROED)
    run(path, 300.9, 300.0, 5.0)
    path.put(ZEROED)
    assert path.gap_n > 0.8, "the same zero changes nothing"
    path.put(Correction(second_zero_n=0.9))
    assert path.offset_n == path.gap_n == 0.0


def test_a_lost_path_leaves_slowly_and_the_comparison_at_once() -> None:
    path = SecondForce(section(), CELL_N, 1e-3)
    path.put(ZEROED)
    t_ns = run(path, 300.4, 300.0, 20.0)
    was_n = path.offset_n
    for _ in range(3000):
        t_ns += MS
        before_n = path.offset_n
        path.look(300.0, 0.0, 0.0, t_ns)
        assert before_n - path.offset_n < 0.001
    assert path.offset_n == pytest.approx(was_n * math.exp(-2.5 / 2.0), rel=0.05)
    assert path.gap_n == 0.0
    assert not path.usable(t_ns)


@pytest.mark.parametrize("flag", ["in_error", "restarted"])
def test_a_device_in_error_is_not_believed(flag: str) -> None:
    path = SecondForce(section(), CELL_N, 1e-3)
    path.put(ZEROED)
    setattr(path, flag, True)
    run(path, 400.0, 300.0, 5.0)
    assert path.quality != 0
    assert path.gap_n == 0.0


def test_a_stretch_is_used_near_rest_only_and_a_pause_counts_for_nothing() -> None:
    path = SecondForce(section(kind="stretch", spring_n_mm=6.0), CELL_N, 1e-3)
    path.put(Correction(second_zero_n=0.0))
    t_ns = run(path, -50.1, 300.0, 5.0, speed=5.0)
    assert path.gap_n == 0.0
    t_ns = run(path, -50.1, 300.0, 0.1, t_ns=t_ns)
    assert 0.0 < path.gap_n < 0.6 * -math.expm1(-0.15 / COMPARED_S)
    run(path, -50.1, 300.0, 8.0, t_ns=t_ns)
    assert path.gap_n == pytest.approx(0.6, rel=1e-2)


CELL_N = 0.03


def quick(**given: object) -> SecondForce:
    made = section(kind="stretch", spring_n_mm=6.0, counts_per_mm=1e4, noise_um=1.0, quick_hz=10.0, **given)
    path = SecondForce(made, CELL_N, 1e-3)
    path.put(ZEROED)
    return path


def course(
    path: SecondForce, tension_n: np.ndarray[tuple[int], np.dtype[np.float64]], wrong_n: float = 0.0
) -> list[float]:
    """Fused less true tension each millisecond; the encoder is wrong by ``wrong_n`` from the middle on."""
    rng, off = np.random.default_rng(3), []
    for tick, true_n in enumerate(tension_n.tolist()):
        t_ns = (tick + 1) * MS
        cell_n = true_n + rng.normal(0.0, CELL_N)
        stretch_mm = true_n / 6.0 + rng.normal(0.0, 1e-3) + (wrong_n / 6.0 if 2 * tick > len(tension_n) else 0.0)
        path.take(50.0 - stretch_mm, 0, t_ns)
        path.look(cell_n, 50.0, 5.0, t_ns)
        off.append(cell_n + path.quick_n - true_n)
    return off


def test_the_stretch_takes_the_cells_quick_noise_off_and_none_of_the_tensions_course() -> None:
    moving = 300.0 + 2.0 * np.sin(2.0 * math.pi * 5.0 * np.arange(4000) * 1e-3)
    off = course(quick(), moving)[500:]
    # Of the encoder 6 mN, of the cell what is slower than 10 Hz: 5 mN of 30 mN.
    assert np.std(off) == pytest.approx(math.hypot(0.006, CELL_N * math.sqrt(math.pi * 10.0 * 1e-3)), rel=0.2)
    assert abs(np.mean(off)) < 2e-3


def test_a_stretch_that_jumps_moves_the_tension_by_no_more_than_noise_could() -> None:
    off = course(quick(disagree_n=10.0), np.full(2000, 300.0), wrong_n=5.0)
    assert 0.1 < max(off) < 6.0 * math.hypot(CELL_N, 0.006) + 3.0 * CELL_N
    assert abs(np.mean(off[-200:])) < 0.01  # what stays is the cell's


def test_without_a_fresh_stretch_the_cell_reads_alone() -> None:
    path = quick()
    course(path, np.full(100, 300.0))
    assert path.quick_n != 0.0
    path.look(300.0, 50.0, 0.0, 101 * MS)
    assert path.quick_n == 0.0


def test_a_quick_stretch_comes_with_every_sample_of_the_loop() -> None:
    with pytest.raises(ValueError, match="quick_hz"):
        section(quick_hz=10.0)
    paper = config.load(ROOT / "config/paper_rig.yaml").model_dump()
    slow = {"kind": "stretch", "spring_n_mm": 6.0, "u_n": 0.1, "cell_u_n": 0.2, "disagree_n": 1.0, "quick_hz": 10.0}
    with pytest.raises(ValueError, match=r"loop.rate_hz \(1000\) where quick_hz is given"):
        RigSettings.model_validate(paper | {"second_force": slow | {"rate_hz": 50}})
