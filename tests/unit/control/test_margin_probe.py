"""The multisine of the measured margins: when it is on, how large it is."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from rigctl.config import rig_file as config
from rigctl.config.margins_section import MarginsSettings
from rigctl.config.settings import RigSettings
from rigctl.control.excitation.margin_probe import GROW_S, SETTLED_S, SPEED_SHARE, Probe, level, signal
from tests.builders.paths import ROOT

PAPER = config.load(ROOT / "config/paper_rig.yaml")
RATE = PAPER.loop.rate_hz


def with_margins(settings: RigSettings = PAPER, **values: float) -> RigSettings:
    return settings.model_copy(update={"margins": MarginsSettings(**values)})  # type: ignore[arg-type]


def run(
    probe: Probe, seconds: float, *, error_n: float = 0.0, free: bool = True
) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    return np.array([probe.speed_mm_s(error_n, free=free) for _ in range(round(seconds * RATE))])


def measuring() -> Probe:
    return Probe(with_margins(), signal(PAPER), level(with_margins()))


def test_it_grows_once_the_tension_is_near_its_set_point_and_then_repeats() -> None:
    probe, settings = measuring(), with_margins()
    before = run(probe, SETTLED_S)
    assert not before.any()
    assert not probe.whole
    growing = run(probe, GROW_S)
    period = signal(settings).ticks
    steady = run(probe, 12.0)
    assert probe.whole
    assert np.abs(growing[:RATE]).max() < 0.5 * np.abs(steady).max()
    assert np.array_equal(steady[:period], steady[period : 2 * period])
    assert np.abs(steady).max() == pytest.approx(level(settings) * signal(settings).peak_mm_s)
    assert abs(steady[:period].sum()) < 1e-6  # the stroke ends where it began


@pytest.mark.parametrize("case", [{"free": False}, {"error_n": 3.1}, {"error_n": -3.1}, {"error_n": float("nan")}])
def test_it_is_off_at_once_and_begins_anew(case: dict[str, float]) -> None:
    probe = measuring()
    assert run(probe, 8.0)[-1] != 0.0
    assert not run(probe, 0.01, **case).any()  # type: ignore[arg-type]
    assert not run(probe, SETTLED_S).any()
    assert np.abs(run(probe, 0.1)).max() < 0.1


def test_stiffness_speed_and_acceleration_bound_it() -> None:
    def peak_mm_s(stiffness: float, probe_n: float, speed_max: float = 10.0) -> float:
        plant = PAPER.plant.model_copy(update={"spring_n_mm": stiffness})
        tension = PAPER.tension.model_copy(update={"speed_max_mm_s": speed_max})
        settings = with_margins(PAPER.model_copy(update={"plant": plant, "tension": tension}), probe_n=probe_n)
        return level(settings) * signal(settings).peak_mm_s

    assert peak_mm_s(6.0, 0.1) == pytest.approx(0.5 * peak_mm_s(6.0, 0.2))
    assert peak_mm_s(34.0, 0.2) < 0.25 * peak_mm_s(6.0, 0.2)
    assert peak_mm_s(1.0, 5.0, 2.0) <= SPEED_SHARE * 2.0 * 1.001


def test_a_probe_near_the_rigs_own_limit_of_the_error_is_refused() -> None:
    plain = PAPER.model_dump()
    assert RigSettings.model_validate(plain | {"margins": {"probe_n": 0.5}}).margins is not None
    with pytest.raises(ValidationError, match=r"at most 0\.5: 1 % of target_min_n"):
        RigSettings.model_validate(plain | {"margins": {"probe_n": 0.6}})  # 1 % of the lowest target
    tight = [{"signal": "vertical_error_n", "high": 0.3, "action": "log", "modes": ["COMPENSATING"]}]
    with pytest.raises(ValidationError, match=r"at most 0\.15"):
        RigSettings.model_validate(plain | {"margins": {"probe_n": 0.2}, "limits": tight})
