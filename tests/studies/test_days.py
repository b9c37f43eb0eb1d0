"""A day of use, played in minutes: nothing trips and nothing warns.

A day is `CYCLES` cycles of some 6 s. With one seed the five rigs play 200 of them, in 20 min of simulated time. In a
cycle TENSION takes the load, the mechanism turns out and back while a TARGET drawn from 60 N to 350 N is on its ramp of
50 N/s, and HOLD follows: where the ramp has ended, or in one cycle of four as soon as the mechanism rests. HOLD is left
after 0.1 s, after 1 s, within the first second after the parking, or later. Every `RELEASED` cycles the rope is
released and the rig disarmed, so that the next cycle begins with ARM and a slack rope. Once a day the rig compensates
until the probe has judged the sensors, before the TARGET comes. The first TARGET is 220 N. All draws follow from the
seed, which is that of the simulated rig too.
"""

from __future__ import annotations

import random

import pytest

from hil.lockstep import Lockstep, lockstep
from hil.plant.layout import MECHANISM
from hil.scenario.disturbances import rotation
from hil.scenario.kinds import OutAndBack
from hil.scenario.layered_rig import with_set
from rigctl.config import rig_file as config
from rigctl.config.changed_settings import changed
from rigctl.config.settings import RigSettings
from rigctl.design.margins import design_and_check
from rigctl.model.states import Mode
from rigctl.model.verbs import Refusal, Verb
from tests.builders.loop_frames import worded_events
from tests.builders.paths import ROOT

RIGS = ("paper_rig", "plain_rig")
SETS = ("air_bearing", "increments", "yielding_motor")
CYCLES, RELEASED, UNDISTURBED = 40, 5, 12
PROBED_S = 22.0
"""The probe begins after 2 s, grows for 4 s and judges within 14 s."""
LIMIT_S = 20.0


def rig_of(name: str, seed: int) -> RigSettings:
    """A rig file, or the paper's with a parameter set laid over it."""
    if name in RIGS:
        settings = config.load(ROOT / f"config/{name}.yaml")
    else:
        settings = with_set(ROOT / "config/paper_rig.yaml", ROOT / f"config/sets/{name}.yaml")
    return changed(settings, {"simulation.seed": seed})


class Day:
    """Cycles on a rig; ``found``: what was no information, each with its cycle and the time in s."""

    def __init__(self, rig: Lockstep, seed: int) -> None:
        self.rig, self.found = rig, list[str]()
        self._random = random.Random(seed)
        self._number, self._target_n = 0, 220.0

    def cycle(self) -> None:
        """Play one cycle."""
        rig, draw, number = self.rig, self._random, self._number
        if number % RELEASED == 0:
            self._command(Verb.ARM)
        self._command(Verb.TENSION)
        rig.run_until(Mode.COMPENSATING, LIMIT_S)
        rig.run(PROBED_S if number % CYCLES == UNDISTURBED else draw.uniform(0.2, 0.8))
        turn = OutAndBack(
            kind="out_and_back", angle_deg=draw.uniform(0.2, 0.8), speed_deg_s=0.5, acceleration_deg_s2=2.0,
            dwell_s=0.25, repeats=1,
        )  # fmt: skip
        track = rotation(turn)
        rig.rig.plant.start_motion({MECHANISM: track}, rig.rig.plant.t_ns)
        self._command(Verb.TARGET, self._target_n)
        rig.run(track.end)
        if draw.random() < 0.75:
            self._await_target()
        self._command(Verb.HOLD)
        park_s = rig.settings.hold.park_s
        rig.run(draw.choice((0.1, 1.0, park_s + 0.3, park_s + 1.5)))
        if number % RELEASED == RELEASED - 1:
            self._command(Verb.RELEASE)
            rig.run_until(Mode.HOLD, LIMIT_S)
            self._command(Verb.DISARM)
            rig.run_until(Mode.DISARMED, LIMIT_S)
        self._read()
        self._number, self._target_n = number + 1, draw.uniform(60.0, 350.0)

    def _command(self, verb: Verb, *values: float) -> None:
        refusal = self.rig.command(verb, *values)
        if refusal is not Refusal.NONE:
            self.found.append(f"cycle {self._number}: {verb.name} refused: {refusal.name}")

    def _await_target(self) -> None:
        law, rate = self.rig.loop.law, self.rig.settings.loop.rate_hz
        for _ in range(round(LIMIT_S * rate)):
            if law.setpoint_n == law.target_n or self.rig.loop.machine.mode is not Mode.COMPENSATING:
                break
            self.rig.tick()
        self.rig.run(0.3)

    def _read(self) -> None:
        now_s = self.rig.clock.now() * 1e-9
        for _, event in worded_events(self.rig):
            if event.severity != "info":
                self.found.append(f"cycle {self._number}, until {now_s:.1f} s: {event.severity}: {event.text}")


@pytest.mark.gate("paper_rig-1-3")
@pytest.mark.parametrize(
    ("name", "seed", "cycles"),
    [("paper_rig", 1, 3), *((name, seed, CYCLES) for seed in (1, 2) for name in (*RIGS, *SETS))],
    ids=str,
)
def test_a_day_of_use_has_no_trip_and_no_warning(name: str, seed: int, cycles: int) -> None:
    settings = rig_of(name, seed)
    with lockstep(settings, design_and_check(settings).gains) as rig:
        rig.run(0.2)
        day = Day(rig, seed)
        for _ in range(cycles):
            day.cycle()
            assert not day.found, day.found
        print(name, seed, "s", rig.clock.now() * 1e-9)
