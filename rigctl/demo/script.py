"""The demo's script, the same for real time and lockstep: arm, tension, the paper's move, release, disarm."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

from hil.operated_rig import OperatedRig, arm_and_tension
from rigctl.config.settings import DemoSettings
from rigctl.model.states import Mode
from rigctl.model.verbs import Verb

SETTLE_S = 5.0
REST_S = 3.0


class DemoError(RuntimeError):
    """The demo could not be played to its end; ``str()`` is one line."""


class PausedError(DemoError):
    """This computer stopped the loop or the simulated rig for longer than the rig tolerates."""


@dataclass(frozen=True)
class Moment:
    """The values shown of one moment."""

    t_s: float  # since the start of the demo
    mode: Mode
    vertical_n: float
    target_n: float
    stroke_mm: float
    tangential_deg: float
    lateness_p99_us: float


Show = Callable[[Moment, str], None]


class Stage(OperatedRig):
    """The rig of the script: real processes, or lockstep. A moment of each second that it runs is shown."""

    show: Show
    step = "tensioning"
    """What the script does, in words."""

    @abstractmethod
    def do(self, verb: Verb, *values: float) -> None:
        """Give a command; raises `DemoError` if it is refused."""

    @abstractmethod
    def start_move(self) -> None:
        """Start the mechanism's move."""

    @abstractmethod
    def moving(self) -> bool:
        """Whether the mechanism moves."""

    @abstractmethod
    def moment(self) -> Moment:
        """The present values."""

    @abstractmethod
    def pass_time(self, seconds: float) -> None:
        """Let time pass; nothing is shown."""

    def run(self, seconds: float) -> None:
        """Let time pass; raises as `until`."""
        end = self.moment().t_s + seconds
        self.until(lambda: self.moment().t_s >= end - 0.5, seconds + 5)

    def run_until(self, mode: Mode, limit_s: float) -> None:
        """Let time pass until the loop is in ``mode``; raises as `until`."""
        self.until(lambda: self.moment().mode is mode, limit_s)

    def until(self, done: Callable[[], bool], limit_s: float) -> None:
        """Let time pass until something is done.

        Raises:
            DemoError: the rig tripped, or the step took too long.
        """
        for _ in range(round(limit_s)):
            if done():
                return
            self.pass_time(1.0)
            moment = self.moment()
            self.show(moment, self.step)
            if moment.mode is Mode.FAULT:
                raise DemoError(f"the rig tripped while {self.step}")
        raise DemoError(f"{self.step} took longer than {limit_s:.0f} s")


def play(stage: Stage, demo: DemoSettings, show: Show) -> None:
    """Play the script to its end; ``show`` gets a moment each second.

    Raises:
        DemoError: a command was refused, the rig tripped, or a step took too long.
    """
    stage.show = show
    arm_and_tension(stage, limit_s=60)
    stage.step = "settling"
    stage.run(SETTLE_S)
    stage.step = f"moving {demo.angle_deg:g} deg out and back"
    stage.start_move()
    one_way = demo.angle_deg / demo.speed_deg_s + demo.speed_deg_s / demo.acceleration_deg_s2
    stage.until(lambda: not stage.moving(), 2 * one_way + 20)
    stage.step = "resting"
    stage.run(REST_S)
    stage.step = "releasing"
    stage.do(Verb.RELEASE)
    stage.run_until(Mode.HOLD, 60)
    stage.do(Verb.DISARM)
    stage.pass_time(0.5)
