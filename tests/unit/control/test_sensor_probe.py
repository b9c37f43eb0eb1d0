"""Who answers the probe, on signals made by the plan's own answers: each missing one has its name, within the time."""

from __future__ import annotations

import math

import numpy as np
import pytest

from rigctl.config import rig_file as config
from rigctl.control.excitation.probe_plan import ProbePlan, plan
from rigctl.control.excitation.sensor_probe import ProbeFinding, SensorProbe
from rigctl.design.gains import design
from tests.builders.paths import ROOT

PAPER = config.load(ROOT / "config/paper_rig.yaml")
QUANTUM_MM = 1e-5
RATE = PAPER.loop.rate_hz


def planned() -> ProbePlan:
    return plan(PAPER, design(PAPER))


class Signals:
    """Tension, stroke and command of each tick; a cell, an encoder or a drive may have stopped."""

    def __init__(self, seed: int, quantum_mm: float = QUANTUM_MM) -> None:
        self.plan, self.random = planned(), np.random.default_rng(seed)
        self.probe = SensorProbe(PAPER, self.plan, quantum_mm)
        ticks, shape = self.plan.shape.ticks, np.array(self.plan.shape.stroke_mm)
        turns = np.exp(2j * np.pi * np.outer(np.arange(ticks), self.plan.lines) / ticks)
        self.tension_n = (turns @ np.array(self.plan.answers)).real
        speeds = self.plan.level * RATE * (np.roll(shape, -1) - shape)
        omega = 2.0 * np.pi * np.fft.fftfreq(ticks, 1.0 / RATE)
        held_s = PAPER.plant.command_delay_s + 2.0 / RATE
        drive = np.exp(-1j * omega * held_s) / (1.0 + 1j * omega * PAPER.plant.cylinder_lag_s)
        integral = np.divide(1.0, 1j * omega, out=np.zeros(ticks, complex), where=omega != 0.0)
        self.speeds, self.stroke_mm = speeds, np.fft.ifft(np.fft.fft(speeds) * drive * integral).real
        self.tick = 0

    def play(self, seconds: float, *, cell: bool = True, encoder: bool = True) -> float:
        """Play until a fault is found, at most so long; the time taken in s."""
        scale_n = PAPER.tension_cell.noise_n * (self.plan.spread / self.plan.silent if cell else 1.0)  # the loop's part
        noise_n = self.random.normal(0.0, scale_n, round(seconds * RATE))
        for tick, noise in enumerate(noise_n):
            self.see(noise, cell=cell, encoder=encoder)
            if self.probe.found > ProbeFinding.WHOLE:
                return (tick + 1) / RATE
        return math.inf

    def see(self, noise_n: float = 0.0, *, cell: bool = True, encoder: bool = True) -> bool:
        """One tick; whether a window has ended in it."""
        place = self.tick % len(self.speeds)
        tension_n = cell * self.tension_n[place] + noise_n
        self.tick += 1
        return self.probe.see(place, tension_n, encoder * self.stroke_mm[place], self.speeds[place - 1])


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize(
    ("cell", "encoder", "named"),
    [
        (False, True, ProbeFinding.CELL_FROZEN),
        (True, False, ProbeFinding.ENCODER_STUCK),
        (False, False, ProbeFinding.DRIVE_MOTIONLESS),
    ],
)
def test_a_missing_answer_is_named_in_the_time_computed(
    seed: int, cell: bool, encoder: bool, named: ProbeFinding
) -> None:
    signals = Signals(seed)
    before_s = signals.plan.detection_s + 4.3
    assert signals.play(before_s) == math.inf
    assert signals.probe.found is ProbeFinding.WHOLE
    assert signals.play(signals.plan.detection_s, cell=cell, encoder=encoder) <= signals.plan.detection_s
    assert signals.probe.found is named


def test_a_probe_that_was_off_is_judged_anew() -> None:
    signals = Signals(1)
    signals.play(signals.plan.detection_s + 2.0)
    signals.probe.lose()
    assert signals.probe.found is ProbeFinding.NONE
    assert signals.play(signals.plan.detection_s - 3.0) == math.inf
    assert signals.probe.found is ProbeFinding.NONE


@pytest.mark.parametrize(("quanta", "named"), [(4.0, ProbeFinding.ENCODER_STUCK), (2.0, ProbeFinding.WHOLE)])
def test_an_encoder_is_judged_where_the_probe_moves_it_by_several_counts(quanta: float, named: ProbeFinding) -> None:
    moved_mm = float(np.ptp(Signals(1).stroke_mm))
    signals = Signals(1, moved_mm / quanta)
    signals.play(2.0 * signals.plan.detection_s, encoder=False)
    assert signals.probe.found is named


def test_the_first_judgement_comes_with_the_window_that_completes_its_number() -> None:
    signals = Signals(1)
    plan, windows = signals.plan, 0
    while signals.probe.found is ProbeFinding.NONE:
        windows += signals.see()
    assert windows == plan.windows(plan.spread)
