"""The proof of the change between settings, against brute force and against Lyapunov functions in numbers."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from rigctl.config.settings import RigSettings
from rigctl.control.law.estimator import filter_model
from rigctl.design.closed_loop import closed_loop, controller
from rigctl.design.gains import OPEN, QUIET, design, filter_gains
from rigctl.design.margins import controllers, design_and_check, frequency_grid, margins_over
from rigctl.design.plant_family import Family, member
from rigctl.design.switching import _joined, circle_margin, common_lyapunov, level_gains

Rig = Callable[..., RigSettings]
QUIETER = {"quiet_disturbance_walk_mm_s": 3.0}


@pytest.mark.parametrize("k_m", [None, 20.0])
def test_the_criterion_is_that_of_the_closed_loop(rig: Rig, k_m: float | None) -> None:
    settings = rig(estimator=QUIETER)
    model, plant = filter_model(settings), member(settings, k_m)
    laws = controllers(model, design(settings))
    hz = np.geomspace(0.01, 500.0, 40)
    z = np.exp(2j * np.pi * hz * model.period_s)
    a = closed_loop(plant, laws[QUIET]).a
    b, c = _joined(plant, laws[QUIET], laws[OPEN])
    np.testing.assert_allclose(a + np.outer(b, c), closed_loop(plant, laws[OPEN]).a, atol=1e-9)
    direct = min(1.0 - float((c @ np.linalg.solve(at * np.eye(len(a)) - a, b)).real) for at in z)
    (gain,) = level_gains([plant.response(z)], laws[QUIET], laws[OPEN], hz, model.period_s)
    assert circle_margin(gain) == pytest.approx(direct, rel=1e-6)


def test_one_lyapunov_function_falls_at_every_blend_of_the_settings(rig: Rig) -> None:
    settings = rig(estimator=QUIETER)
    plant, laws = member(settings, None), controllers(filter_model(settings), design(settings))
    p = common_lyapunov(plant, laws[QUIET], laws[OPEN])
    assert p is not None
    scale = 1.0 / np.sqrt(np.diag(p))
    quiet, opened = (closed_loop(plant, laws[name]).a for name in (QUIET, OPEN))
    assert np.linalg.eigvalsh(p * np.outer(scale, scale)).min() > 0.0
    for share in np.linspace(0.0, 1.0, 11):
        a = (1.0 - share) * quiet + share * opened
        fall = (p - a.T @ p @ a) * np.outer(scale, scale)
        assert np.linalg.eigvalsh(0.5 * (fall + fall.T)).min() > 0.0


def test_the_gate_judges_every_setting_and_the_change_between_them(rig: Rig) -> None:
    found = design_and_check(rig(estimator=QUIETER))
    *ends, between = found.settings
    assert [setting.name for setting in ends] == ["open", "quiet"]
    assert between.name.endswith(" % open")
    assert found.ms_max == max(setting.ms_max for setting in found.settings)
    assert found.switching is not None
    assert 0.0 < found.switching < 1.0
    assert found.accepted == (found.ms_max <= 1.6)
    quiet = next(setting for setting in found.settings if setting.name == "quiet").performance
    assert quiet is not None
    assert found.performance is not None
    assert found.performance.command_noise_mm_s == quiet.command_noise_mm_s


@pytest.mark.parametrize(
    ("quieter", "within"),
    [
        ({"quiet_disturbance_walk_mm_s": 8.0, "quiet_tension_walk_n": 0.2}, False),
        ({"quiet_disturbance_walk_mm_s": 0.3, "quiet_tension_walk_n": 0.3}, True),
    ],
)
def test_ms_is_that_of_the_worst_of_all_levels(rig: Rig, quieter: dict[str, float], within: bool) -> None:
    """Against every hundredth level by brute force; with the second setting the worst level is between the two."""
    settings = rig(estimator=quieter)
    model, gains = filter_model(settings), design(settings)
    members = [member(settings, None, 1.2, 2), member(settings, 60.0, 1.0, 1)]
    found = design_and_check(settings, Family("two", tuple(members)))
    of_setting, grid = filter_gains(model), frequency_grid(members, model.period_s)
    quiet, opened = of_setting[QUIET], of_setting[OPEN]
    peaks = []
    for level in np.linspace(0.0, 1.0, 101):
        law = controller(model, gains, quiet + level * (opened - quiet))
        peaks.append([one.ms_worst for one in margins_over(members, law, grid, model.period_s)])
    brute = np.array(peaks)
    for at, one in enumerate(found.margins):
        assert brute[:, at].max() <= one.ms_worst * (1.0 + 1e-9)
        assert one.ms_worst == pytest.approx(brute[:, at].max(), rel=2e-4)
    worst = brute.max(axis=1)
    assert (worst.max() > max(worst[0], worst[-1]) + 1e-3) == within, "the level of the worst Ms is an end or is not"
    level = float(found.settings[-1].name.removesuffix(" % open"))
    assert level == pytest.approx(int(np.argmax(worst)), abs=1.0)


def test_settings_that_differ_too_much_are_refused(rig: Rig) -> None:
    # Quiet enough, the loop is unstable at times although it is stable in both settings.
    found = design_and_check(
        rig(
            estimator={"quiet_disturbance_walk_mm_s": 0.001, "quiet_tension_walk_n": 1e-4},
            design={"stretch_weight": 2000.0, "integral_weight": 1e5},
        )
    )
    assert not found.accepted


def test_without_a_quiet_setting_nothing_changes(rig: Rig) -> None:
    found = design_and_check(rig())
    assert found.settings == ()
    assert found.switching is None


def test_the_settings_share_the_column_of_the_speed(rig: Rig) -> None:
    gains = filter_gains(filter_model(rig(estimator=QUIETER)))
    np.testing.assert_array_equal(gains[OPEN][:, 1], gains[QUIET][:, 1])
    assert not np.allclose(gains[OPEN][:, 0], gains[QUIET][:, 0])


@pytest.mark.parametrize(("k_scale", "accepted"), [(1.0, True), (30.0, False)])
def test_a_family_of_other_mechanisms_than_the_files_counts_whole_for_a_waiver(
    rig: Rig, k_scale: float, accepted: bool
) -> None:
    """A plant thirty times as stiff is unstable with these gains; no waiver excuses that."""
    settings = rig(estimator=QUIETER, design={"ms_max": 1.01, "waiver": "more than the law can bear"})
    found = design_and_check(settings, Family("true", (member(settings, 20.0, k_scale),)))
    assert found.waiver is not None
    assert found.accepted == accepted
