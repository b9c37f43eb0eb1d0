"""The sampled plants are the P(s) of the domain notes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from rigctl.config.settings import RigSettings
from rigctl.control.estimator import filter_model
from rigctl.design.plant_family import MECHANISM_DAMPING, family, member

Rig = Callable[..., RigSettings]


@pytest.mark.parametrize("k_m", [None, 1000.0, 60.0, 6.0, 2.0])
@pytest.mark.parametrize("delay_scale", [1, 2])
def test_response_is_the_small_signal_plant(rig: Rig, k_m: float | None, delay_scale: int) -> None:
    settings = rig(loop={"rate_hz": 4000})
    dt, hz = 1.0 / 4000, np.array([0.1, 1.0, 3.0, 7.5, 20.0])
    s, k, m = 2j * np.pi * hz, settings.plant.stiffness_n_mm * 1.2, 0.030  # 30 kg is 0.03 N s^2/mm
    flexible = 1.0 if k_m is None else 0.0
    if k_m is not None:
        own = m * s**2 + 2 * MECHANISM_DAMPING * np.sqrt(k_m * m) * s + k_m
        flexible = own / (own + k)
    top = k / s * flexible
    delay = np.exp(-s * (delay_scale * 0.002 + dt / 2))  # the held command adds half a period of delay
    tension, speed, disturbance = member(settings, k_m, 1.2, delay_scale).response(np.exp(s * dt))
    # The remaining difference is of the order (omega dt)^2 = 1e-3 at 20 Hz.
    assert np.allclose(tension, top * delay / (0.02 * s + 1), rtol=2e-3)
    assert np.allclose(speed, delay / (0.02 * s + 1), rtol=2e-3)
    assert np.allclose(disturbance, top * np.exp(-s * dt / 2), rtol=2e-3)


def test_rigid_member_is_the_model_the_filter_believes_in(rig: Rig) -> None:
    settings = rig()
    model, plant = filter_model(settings), member(settings, None)
    assert np.allclose(plant.a, model.f[:2, :2], rtol=1e-12)
    assert np.allclose(plant.b_command, model.b[:2, 0], rtol=1e-12)
    assert np.allclose(plant.b_disturbance, model.f[:2, 2], rtol=1e-12)
    assert plant.delay_ticks == model.delay_ticks


def test_family_has_every_combination_and_the_mechanism_in_the_file(rig: Rig) -> None:
    assert len({(p.k_m, p.k_scale, p.delay_scale) for p in family(rig())}) == 5 * 3 * 2
    own = family(rig(plant={"mechanism_n_mm": 45.0}))
    assert len(own) == 6 * 3 * 2
    assert 45.0 in {plant.k_m for plant in own}


def test_mechanism_resonates_where_the_domain_notes_say(rig: Rig) -> None:
    assert member(rig(), 60.0).resonances_hz == pytest.approx((7.1, 7.5), abs=0.05)
