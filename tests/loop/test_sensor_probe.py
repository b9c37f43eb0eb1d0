"""A sensor that has stopped measuring while COMPENSATING, judged by the plant's truth, on soft and stiff springs."""

from __future__ import annotations

import pytest

from hil.faults.in_device import CELL, STROKE, ignores_commands, reads, stuck
from hil.faults.stand import Injector, Stand
from hil.lockstep import Lockstep
from rigctl.config import rig_file as config
from rigctl.config.settings import RigSettings
from rigctl.control.excitation.margin_probe import GROW_S, SETTLED_S
from rigctl.control.excitation.probe_plan import ProbePlan, plan
from rigctl.design.gains import design
from rigctl.model.faults import Fault
from rigctl.model.states import Mode
from tests.builders.excited import tensioned
from tests.builders.paths import ROOT

PAPER = config.load(ROOT / "config/paper_rig.yaml")
CELL_NOISE_N = 0.03
UNSEEN = 0.1  # of the target: what no frame shows


def rig(spring_n_mm: float = 6.0, *, limits: bool = True) -> RigSettings:
    plant = PAPER.plant.model_copy(update={"spring_n_mm": spring_n_mm})
    return PAPER.model_copy(update={"plant": plant, "limits": PAPER.limits if limits else []})


def planned(settings: RigSettings) -> ProbePlan:
    return plan(settings, design(settings))


def verified_s(settings: RigSettings) -> float:
    """Until the probe has judged the sensors for the first time."""
    return SETTLED_S + GROW_S + planned(settings).detection_s + 2.0


class Watched:
    """A run under a fault: the largest distance of the true tension from 300 N, and the time of the trip."""

    def __init__(self, run: Lockstep, *faults: Injector) -> None:
        self.run, self.worst_n, self.tripped_s = run, 0.0, float("nan")
        self._steps = [step for fault in faults if (step := fault(Stand(run, "seed")))]

    def play(self, seconds: float, after_s: float = 1.0) -> Watched:
        rate = self.run.settings.loop.rate_hz
        for tick in range(round(seconds * rate)):
            for step in self._steps:
                step(tick / rate)
            self.run.loop.tick()
            self.worst_n = max(self.worst_n, abs(self.run.rig.plant.truth.tension_n - 300.0))
            if self.run.loop.machine.mode is Mode.FAULT and not self.tripped_s <= seconds:
                self.tripped_s = tick / rate
            if tick / rate > self.tripped_s + after_s:
                break
        return self

    @property
    def fault(self) -> Fault:
        return self.run.loop.machine.fault


@pytest.mark.gate("0.05-34.0")
@pytest.mark.parametrize("spring_n_mm", [6.0, 34.0])
@pytest.mark.parametrize("offset_n", [0.05, -0.05])
def test_a_cell_frozen_with_its_noise_and_an_offset_moves_the_load_by_a_tenth_at_most(
    spring_n_mm: float, offset_n: float
) -> None:
    """Without `limits` too: the built-in bound is in newtons, whatever the spring."""
    settings = rig(spring_n_mm, limits=False)
    with tensioned(settings, design(settings), Mode.COMPENSATING) as run:
        found = Watched(run, reads(CELL, plus=offset_n, noise=CELL_NOISE_N, freezes=True)).play(30.0)
        assert found.fault is Fault.LOAD_UNSEEN
        assert found.worst_n < UNSEEN * 300.0
        assert abs(run.loop.inbox.cell.tension_n - 300.0) < 1.0  # nothing of it was shown


@pytest.mark.study
@pytest.mark.parametrize("drift_n_s", [-6.0, 2.0])
def test_a_cell_that_drifts_moves_the_load_by_a_tenth_at_most(drift_n_s: float) -> None:
    settings = rig()
    with tensioned(settings, design(settings), Mode.COMPENSATING) as run:
        found = Watched(run, reads(CELL, drift_s=drift_n_s)).play(25.0)
        assert found.fault is Fault.LOAD_UNSEEN
        assert found.worst_n < UNSEEN * 300.0


@pytest.mark.study
@pytest.mark.parametrize("spring_n_mm", [6.0, pytest.param(34.0, marks=pytest.mark.long)])
def test_a_cell_frozen_on_the_set_point_is_found_in_the_time_computed(spring_n_mm: float) -> None:
    settings = rig(spring_n_mm)
    with tensioned(settings, design(settings), Mode.COMPENSATING) as run:
        run.run(verified_s(settings))
        found = Watched(run, reads(CELL, times=0.0, plus=300.0, noise=CELL_NOISE_N))
        found.play(planned(settings).detection_s + 1.0)
        assert found.fault in {Fault.CELL_FROZEN, Fault.LOAD_UNSEEN}
        assert found.tripped_s <= planned(settings).detection_s
        assert found.worst_n < UNSEEN * 300.0


@pytest.mark.study
@pytest.mark.parametrize(
    ("faults", "named"),
    [
        ((stuck(STROKE),), {Fault.ENCODER_STUCK}),
        pytest.param(
            (ignores_commands(),),
            {Fault.DRIVE_MOTIONLESS, Fault.DRIVE_NOT_FOLLOWING},  # or a command has grown by then
            marks=pytest.mark.long,
        ),
    ],
    ids=["stuck encoder", "motionless drive"],
)
def test_it_is_named_in_the_time_computed(faults: tuple[Injector, ...], named: set[Fault]) -> None:
    settings = rig()
    with tensioned(settings, design(settings), Mode.COMPENSATING) as run:
        run.run(verified_s(settings))
        found = Watched(run, *faults).play(planned(settings).detection_s + 1.0)
        assert found.fault in named
        assert found.tripped_s <= planned(settings).detection_s
        assert found.worst_n < 3.0
