"""Margins against textbook loops and python-control; the verdict against its limit."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import control
import numpy as np
import pytest

from rigctl.config.rig_file import load
from rigctl.config.settings import RigSettings
from rigctl.control.law.estimator import filter_model
from rigctl.control.law.tension import Gains
from rigctl.design import identified, plant_family
from rigctl.design.closed_loop import Controller, closed_loop, controller
from rigctl.design.gains import design, filter_gain, filter_gains
from rigctl.design.identified import Identified, Uncertain
from rigctl.design.margins import (
    classical_margins,
    design_and_check,
    frequency_grid,
    judge,
    margins_over,
    predicted_band,
    responses,
)
from rigctl.design.plant_family import ComplexArray, Family, Member, member
from tests.builders.paths import ROOT

Rig = Callable[..., RigSettings]
CONFIG = ROOT / "config"
WAIVER = "rigid mechanism, checked by hand"


@pytest.mark.parametrize("zeta", [0.3, 0.5, 0.7])
def test_second_order_loop_has_the_textbook_sensitivity_and_phase_margin(rig: Rig, zeta: float) -> None:
    # L = K k / (s (tau s + 1)): zeta = 1 / (2 sqrt(K k tau)). Formulas: Astrom and Murray, Feedback Systems.
    tau = 1.0
    settings = rig(loop={"rate_hz": 4000}, plant={"cylinder_lag_s": tau, "command_delay_s": 0.0})
    gain = 1.0 / (4.0 * zeta**2 * tau * settings.plant.stiffness_n_mm)
    model = filter_model(settings)
    # The integral and the disturbance's estimate get a little feedback (1e-3 rad/s), or they would drift.
    trusting = np.array([[1.0, 0.0], [0.0, 1.0], [1e-3, 0.0]])
    law = controller(model, Gains(gain, 0.0, 1e-3 * gain), trusting)
    plant = plant_family.member(settings, None)
    (found,) = margins_over([plant], law, frequency_grid([plant], model.period_s), model.period_s)
    root = math.sqrt(8 * zeta**2 + 1)
    ms = math.sqrt((8 * zeta**2 + 1 + (4 * zeta**2 + 1) * root) / (8 * zeta**2 + 1 + (4 * zeta**2 - 1) * root))
    slow = math.sqrt(math.sqrt(1 + 4 * zeta**4) - 2 * zeta**2)
    # Those 1e-3 rad/s and 1.5 ticks of latency and hold turn the loop by some 5e-3 rad near its crossover at 1 rad/s.
    assert found.ms == pytest.approx(ms, rel=0.01)
    assert found.ms_output == pytest.approx(ms, rel=0.01)
    assert found.pm_deg == pytest.approx(math.degrees(math.atan(2 * zeta / slow)), abs=0.5)
    assert found.dm_ms == pytest.approx(1000 * math.radians(found.pm_deg) / (slow / (2 * zeta * tau)), rel=0.01)


def test_gain_margin_of_a_third_order_loop_is_two() -> None:
    omega = np.logspace(-2, 2, 2000)
    s: ComplexArray = (1j * omega).astype(np.complex128)
    loop: ComplexArray = 1 / (s * (s + 1) ** 2)
    gm_db, pm_deg, _ = classical_margins(loop, omega)
    known = control.margin(control.tf([1], [1, 2, 1, 0]))
    assert gm_db == pytest.approx(20 * math.log10(2), abs=1e-3)
    assert pm_deg == pytest.approx(known[1], abs=1e-2)


def test_gain_margin_at_nyquist_counts() -> None:
    # L = 0.5 / (z - 1): real at z = -1, where it is -1/4.
    omega = np.pi * np.logspace(-4, 0, 500)
    z: ComplexArray = np.exp(1j * omega)
    loop: ComplexArray = 0.5 / (z - 1)
    gm_db, _, _ = classical_margins(loop, omega)
    assert gm_db == pytest.approx(20 * math.log10(4), abs=1e-9)


FOUND = Identified(
    when="2026-10-30T12:00:00+00:00", entries=(), tension_n=300.0, believed_n_mm=5.96,
    stiffness_n_mm=Uncertain(6.0, 0.01), lag_s=Uncertain(0.02, 1e-4), delay_s=Uncertain(0.0023, 1e-4),
    mechanism_n_mm=Uncertain(60.0, 1.0), damping_n_s_mm=Uncertain(0.05, 0.001),
)  # fmt: skip
BETWEEN = {
    "assumed": {"quiet_disturbance_walk_mm_s": 0.3, "quiet_tension_walk_n": 0.3},
    "identified": {"quiet_disturbance_walk_mm_s": 4.0, "quiet_tension_walk_n": 0.1},
}
"""Filters with two settings, of which the worst level is between the two with that family."""


def _sensitivities(law: Controller, plant: Member, period_s: float) -> tuple[Any, Any]:
    """S at the plant's input and at the tension, closed by python-control from the state spaces."""
    out = control.ss(law.a, law.b, law.c[None, :], np.zeros((1, 2)), period_s)
    late = control.ss(control.tf([1], [1, *[0] * plant.delay_ticks], period_s))
    system = control.ss(plant.a, plant.b_command[:, None], np.eye(2, len(plant.a)), np.zeros((2, 1)), period_s)
    delayed, one = control.series(late, system), control.ss([], [], [], [[1.0]], period_s)
    speed_closed = control.feedback(one, delayed[1, 0] * out[0, 1], sign=1)
    return (
        control.feedback(one, control.series(delayed, out), sign=1),
        control.feedback(one, delayed[0, 0] * speed_closed * out[0, 0], sign=1),
    )


def _families(settings: RigSettings) -> dict[str, Family]:
    return {"assumed": plant_family.assumed(settings), "identified": identified.family(settings, FOUND)}


@pytest.mark.parametrize("name", ["assumed", "identified"])
def test_responses_are_those_of_python_control(rig: Rig, name: str) -> None:
    """Of every plant, at both places and for the disturbance.

    Gate and search have arrays, because python-control takes 25 times as long for a family.
    """
    settings = rig()
    model, family = filter_model(settings), _families(settings)[name]
    law, members = controller(model, design(settings), filter_gain(model)), [*family.members, *family.reported]
    grid = frequency_grid(members, model.period_s)[::40]
    z = np.exp(2j * np.pi * grid * model.period_s)
    assert len(members) > 30
    for plant, found in zip(members, responses(members, law, grid, model.period_s), strict=True):
        at_input, at_output = _sensitivities(law, plant, model.period_s)
        np.testing.assert_allclose(found.s_input, at_input(z), rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(found.s_output, at_output(z), rtol=1e-9, atol=1e-9)
        feed = [[plant.loss_n_s_mm]]
        disturbed = control.ss(plant.a, plant.b_disturbance[:, None], plant.tension[None, :], feed, model.period_s)
        np.testing.assert_allclose(found.disturbance, disturbed(z), rtol=1e-9)


@pytest.mark.parametrize("settings_of_filter", [1, 2])
@pytest.mark.parametrize("name", ["assumed", "identified"])
def test_ms_of_the_gate_is_the_peak_that_python_control_finds(rig: Rig, name: str, settings_of_filter: int) -> None:
    """Of the worst plant, at the filter's worst level."""
    settings = rig(estimator=BETWEEN[name] if settings_of_filter == 2 else {})
    model, gains, family = filter_model(settings), design(settings), _families(settings)[name]
    found, of_setting = judge(settings, gains, family), filter_gains(model)
    assert (0.1 < found.worst_level < 0.9) == (settings_of_filter == 2)
    opened = of_setting["open"]
    quiet = of_setting.get("quiet", opened)
    grid = frequency_grid([*family.members, *family.reported], model.period_s)
    z = np.exp(2j * np.pi * grid * model.period_s)
    worst = max(range(len(family.members)), key=lambda at: found.margins[at].ms_worst)

    def peaks_at(level: float) -> list[float]:
        law = controller(model, gains, quiet + level * (opened - quiet))
        return [float(np.abs(one(z)).max()) for one in _sensitivities(law, family.members[worst], model.period_s)]

    peaks = peaks_at(found.worst_level)
    assert found.ms_max == pytest.approx(max(peaks), rel=1e-9)
    if settings_of_filter == 1:
        assert [found.margins[worst].ms, found.margins[worst].ms_output] == pytest.approx(peaks, rel=1e-9)
    else:
        assert max(*peaks_at(found.worst_level - 0.02), *peaks_at(found.worst_level + 0.02)) < found.ms_max


def _at_input(settings: RigSettings, gains: Gains, plant: Member) -> Any:
    """Loop at the plant's input, built with python-control from the state spaces."""
    model = filter_model(settings)
    law = controller(model, gains, filter_gain(model))
    out = control.ss(law.a, law.b, law.c[None, :], np.zeros((1, 2)), model.period_s)
    late = control.ss(control.tf([1], [1, *[0] * plant.delay_ticks], model.period_s))
    rows = np.eye(2, len(plant.a))
    system = control.ss(plant.a, plant.b_command[:, None], rows, np.zeros((2, 1)), model.period_s)
    return -control.series(late, system, out)


@pytest.mark.parametrize("stretch_weight", [10.0, 50.0, 400.0])
@pytest.mark.parametrize(
    ("k_m", "k_scale", "delay_scale"),
    [(None, 0.8, 1), (None, 1.0, 2), (1000.0, 1.2, 2), (60.0, 1.2, 2), (20.0, 0.8, 1), (6.0, 1.0, 2), (2.0, 0.8, 2)],
)
def test_every_margin_is_python_controls(
    rig: Rig, k_m: float | None, k_scale: float, delay_scale: int, stretch_weight: float
) -> None:
    settings = rig(design={"stretch_weight": stretch_weight})
    gains, model = design(settings), filter_model(settings)
    plant = plant_family.member(settings, k_m, k_scale, delay_scale)
    grid = frequency_grid([plant], model.period_s)
    law = controller(model, gains, filter_gain(model))
    (found,) = margins_over([plant], law, grid, model.period_s)
    omega = 2 * np.pi * grid[:-1]  # python-control refuses Nyquist for a chain of delays
    loop = _at_input(settings, gains, plant)
    gm, pm, sm, _, crossover, _ = control.stability_margins(control.frd(loop, omega), returnall=True)
    # 1e-3: both interpolate between samples, one the modulus and the phase, the other real and imaginary part.
    # At a sharp resonance (K_m = 2) that makes up to 0.03 dB of gain and 0.3 % of a peak of 2.
    near = 5e-3 if k_m == 2.0 else 1e-3
    assert found.gm_db == pytest.approx(np.abs(20 * np.log10(gm)).min(), abs=0.05)
    assert found.pm_deg == pytest.approx(np.abs(pm).min(), rel=1e-3)
    assert found.dm_ms == pytest.approx((1000 * np.radians(pm % 360) / crossover).min(), rel=1e-3)
    assert found.ms == pytest.approx(1 / sm.min(), rel=near)
    # The disk margin of skew 1 is the distance to -1; the largest disks' gain and phase lie within the classical ones.
    distance, _, _ = control.disk_margins(loop, omega, skew=1.0)
    assert found.ms == pytest.approx(1 / distance, rel=near)
    _, disk_db, disk_deg = control.disk_margins(loop, omega, skew=0.0)
    assert found.gm_db >= disk_db * (1 - near)
    assert found.pm_deg >= disk_deg * (1 - near)


@pytest.mark.parametrize("k_m", [None, 60.0, 6.0])
def test_margins_are_where_stability_ends(rig: Rig, k_m: float | None) -> None:
    # By eigenvalues, not by a frequency response: more delay than dm_ms or more gain than gm_db is unstable.
    settings = rig()
    gains, model = design(settings), filter_model(settings)
    law = controller(model, gains, filter_gain(model))
    plant = plant_family.member(settings, k_m)
    (found,) = margins_over([plant], law, frequency_grid([plant], model.period_s), model.period_s)
    spare = int(found.dm_ms / (1000 * model.period_s))
    for more, stable in ((spare, True), (spare + 1, False)):
        late = replace(plant, delay_ticks=plant.delay_ticks + more)
        assert (closed_loop(late, law).spectral_radius < 1.0) == stable
    for factor, stable in ((10 ** (found.gm_db / 20) * 0.999, True), (10 ** (found.gm_db / 20) * 1.001, False)):
        assert (closed_loop(replace(plant, b_command=factor * plant.b_command), law).spectral_radius < 1.0) == stable


def test_grid_is_fine_enough_for_the_peaks(rig: Rig) -> None:
    settings = rig()
    model = filter_model(settings)
    law = controller(model, design(settings), filter_gain(model))
    members = plant_family.family(settings)
    fine = np.geomspace(0.01, 500.0, 20_000)
    coarse = margins_over(members, law, frequency_grid(members, model.period_s), model.period_s)
    for one, other in zip(coarse, margins_over(members, law, fine, model.period_s), strict=True):
        assert one.ms == pytest.approx(other.ms, rel=1e-3)
        assert one.ms_output == pytest.approx(other.ms_output, rel=1e-3)


@pytest.mark.parametrize("name", ["paper_rig.yaml", "rig.yaml"])
def test_shipped_rigs_are_accepted_and_do_what_they_promise(name: str) -> None:
    found = design_and_check(load(CONFIG / name))
    assert found.accepted
    assert found.waiver is None
    assert len(found.margins) == 30
    assert found.ms_max <= 1.6
    assert found.performance is not None
    # Promise: 0.04 % of 300 N for 10 mm at 0.1 Hz with 3 sigma of noise, 0.7 and 1.3 x locked, 0.5 mm/s at rest.
    assert found.performance.vertical_error_n + 3 * found.performance.tension_noise_n < 0.12
    assert found.performance.sensitivity_3hz < 0.7
    assert found.performance.sensitivity_8hz < 1.3
    assert found.performance.command_noise_mm_s < 0.5


@pytest.mark.parametrize("spring_n_mm", [13.0, 20.0, 27.0, 34.0])
def test_same_weights_carry_over_to_every_spring_of_the_paper(rig: Rig, spring_n_mm: float) -> None:
    assert design_and_check(rig(plant={"spring_n_mm": spring_n_mm})).accepted


@pytest.mark.parametrize(("rate_hz", "tension_walk_n"), [(4000, 0.01), (2000, 0.01), (200, 30.0), (100, 30.0)])
def test_other_loop_rates_are_accepted_the_slow_ones_calmer(rig: Rig, rate_hz: int, tension_walk_n: float) -> None:
    settings = rig(loop={"rate_hz": rate_hz}, estimator={"tension_walk_n": tension_walk_n})
    assert design_and_check(settings).accepted


def test_limit_refuses_and_words_waive(rig: Rig) -> None:
    refused = design_and_check(rig(design={"ms_max": 1.3}))
    assert not refused.accepted
    waived = design_and_check(rig(design={"ms_max": 1.3, "waiver": WAIVER}))
    assert waived.accepted
    assert waived.waiver == WAIVER
    unneeded = design_and_check(rig(design={"waiver": WAIVER}))
    assert unneeded.waiver is None


def test_waiver_excuses_other_mechanisms_but_not_the_one_in_the_file(rig: Rig) -> None:
    # Without the spring a compliant mechanism is unstable; the paper's rigid one is not.
    no_spring = {"spring_n_mm": 1e4}
    rigid = design_and_check(rig(plant=no_spring, design={"waiver": WAIVER}))
    assert math.isinf(rigid.ms_max)
    assert rigid.accepted
    soft = design_and_check(rig(plant={**no_spring, "mechanism_n_mm": 6.0}, design={"waiver": WAIVER}))
    assert not soft.accepted
    assert soft.performance is None


def test_verdict_is_plain_json_with_rigid_and_infinite_as_null(rig: Rig) -> None:
    found = design_and_check(rig())
    text = json.dumps(replace(found, ms_max=math.inf).as_dict(), allow_nan=False)
    read = json.loads(text)
    assert read["ms_max"] is None
    assert read["margins"][0]["k_m"] is None
    assert set(read["margins"][0]) >= {"k_m", "k_scale", "delay_scale", "ms", "gm_db", "pm_deg", "dm_ms"}


@pytest.mark.parametrize("estimator", [{}, {"quiet_disturbance_walk_mm_s": 0.3, "quiet_tension_walk_n": 0.3}])
def test_the_band_holds_every_member_at_every_level(rig: Rig, estimator: dict[str, float]) -> None:
    settings = rig(estimator=estimator)
    model, gains, hz = filter_model(settings), design(settings), np.geomspace(1.0, 100.0, 15)
    members = (member(settings, None, 1.2, 2), member(settings, 60.0, 0.8, 1))
    low, high = predicted_band(settings, gains, Family("two", members), hz)
    of_setting = filter_gains(model)
    opened = of_setting["open"]
    quiet = of_setting.get("quiet", opened)
    moduli = [
        np.abs(answer.s_input)
        for level in np.linspace(0.0, 1.0, 41) ** 3
        for answer in responses(
            list(members), controller(model, gains, quiet + level * (opened - quiet)), hz, model.period_s
        )
    ]
    assert (np.max(moduli, axis=0) <= high + 1e-9).all(), "exact: no level is beyond it"
    np.testing.assert_allclose(np.max(moduli, axis=0), high, rtol=2e-3)
    np.testing.assert_allclose(np.min(moduli, axis=0), low, rtol=1e-2)
