"""The demo's script, the same for real time and lockstep: arm, tension, the paper's move, release, disarm."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

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


class Stage(Protocol):
    """The rig of the script: real processes, or lockstep."""

    def command(self, verb: Verb) -> None:
        """Give a command; raises `DemoError` if it is refused."""

    def start_move(self) -> None:
        """Start the mechanism's move."""

    def moving(self) -> bool:
        """Whether the mechanism moves."""

    def moment(self) -> Moment:
        """The present values."""

    def pass_time(self, seconds: float) -> None:
        """Let time pass."""


def play(stage: Stage, demo: DemoSettings, show: Show) -> None:
    """Play the script to its end; ``show`` gets a moment each second.

    Raises:
        DemoError: a command was refused, the rig tripped, or a step took too long.
    """

    def until(done: Callable[[], bool], limit_s: float, step: str) -> None:
        for _ in range(round(limit_s)):
            if done():
                return
            stage.pass_time(1.0)
            moment = stage.moment()
            show(moment, step)
            if moment.mode is Mode.FAULT:
                raise DemoError(f"the rig tripped while {step}")
        raise DemoError(f"{step} took longer than {limit_s:.0f} s")

    def wait(seconds: float, step: str) -> None:
        end = stage.moment().t_s + seconds
        until(lambda: stage.moment().t_s >= end - 0.5, seconds + 5, step)

    stage.command(Verb.ARM)
    stage.command(Verb.TENSION)
    until(lambda: stage.moment().mode is Mode.COMPENSATING, 60, "tensioning")
    wait(SETTLE_S, "settling")
    stage.start_move()
    one_way = demo.angle_deg / demo.speed_deg_s + demo.speed_deg_s / demo.acceleration_deg_s2
    until(lambda: not stage.moving(), 2 * one_way + 20, f"moving {demo.angle_deg:g} deg out and back")
    wait(REST_S, "resting")
    stage.command(Verb.RELEASE)
    until(lambda: stage.moment().mode is Mode.HOLD, 60, "releasing")
    stage.command(Verb.DISARM)
    stage.pass_time(0.5)
