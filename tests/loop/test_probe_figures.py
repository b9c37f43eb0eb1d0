"""What the probe costs in rms error, and how often it would raise a false alarm: the same seeds with it and without."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import pytest

from hil.lockstep import Lockstep
from rigctl.config import rig_file as config
from rigctl.config.settings import RigSettings
from rigctl.control import loop
from rigctl.control.excitation.loop_probe import NoProbe
from rigctl.control.excitation.margin_probe import GROW_S, SETTLED_S
from rigctl.control.excitation.probe_plan import JUDGEMENTS_PER_PERIOD, OVERLAP, plan
from rigctl.control.excitation.sensor_probe import SensorProbe
from rigctl.design.gains import design
from rigctl.model.states import Mode
from tests.builders.excited import tensioned
from tests.builders.paths import ROOT

PAPER = config.load(ROOT / "config/paper_rig.yaml")
SEEDS = range(1, 9)
SECONDS = 20.0
GROWTH_MOST = 1.05
ALARMS_PER_HOUR_MOST = 1e-3

pytestmark = [pytest.mark.study, pytest.mark.long]


def drawn(seed: int) -> RigSettings:
    assert PAPER.simulation is not None
    return PAPER.model_copy(update={"simulation": PAPER.simulation.model_copy(update={"seed": seed})})


def squared_errors(settings: RigSettings) -> npt.NDArray[np.float64]:
    """Of the true tension, with the whole probe on."""
    with tensioned(settings, design(settings), Mode.COMPENSATING) as run:
        run.run(SETTLED_S + GROW_S)
        return np.array([_error_n(run) for _ in range(round(SECONDS * settings.loop.rate_hz))]) ** 2


def _error_n(run: Lockstep) -> float:
    run.loop.tick()
    assert run.loop.machine.mode is Mode.COMPENSATING
    return run.rig.plant.truth.tension_n - PAPER.tension.target_n


def test_the_error_grows_little_and_false_alarms_are_rare(monkeypatch: pytest.MonkeyPatch) -> None:
    """Answers of single windows are sums of thousands of samples of noise, so normal; their mean decides."""
    answers: list[float] = []
    look = SensorProbe._look

    def looks(self: SensorProbe, *values: object) -> None:
        look(self, *values)  # type: ignore[arg-type]
        answers.append(self._answers[-1])

    monkeypatch.setattr(SensorProbe, "_look", looks)
    probed = np.mean([squared_errors(drawn(seed)).mean() for seed in SEEDS])
    monkeypatch.setattr(loop, "LoopProbe", lambda settings, *_: NoProbe(settings))
    plain = np.mean([squared_errors(drawn(seed)).mean() for seed in SEEDS])
    assert 1.0 < math.sqrt(probed / plain) <= GROWTH_MOST
    planned = plan(PAPER, design(PAPER))
    windows = planned.windows(planned.spread)
    spread = float(np.std(answers, ddof=1))
    assert len(answers) > 15 * len(SEEDS)
    assert spread < 1.1 * planned.spread
    sigmas = (float(np.mean(answers)) - planned.threshold(planned.spread, windows)) / (
        spread * math.sqrt(OVERLAP / windows)
    )
    judgements_per_hour = 3600.0 * JUDGEMENTS_PER_PERIOD / planned.period_s
    assert judgements_per_hour * 0.5 * math.erfc(sigmas / math.sqrt(2.0)) <= ALARMS_PER_HOUR_MOST
