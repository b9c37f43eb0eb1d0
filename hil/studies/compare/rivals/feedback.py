"""The interface of every rival, and its place in our law."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import NamedTuple, Protocol

from rigctl.config.settings import RigSettings
from rigctl.control.law.tension import Estimate, Gains, TensionLaw


class Sample(NamedTuple):
    """Input of a rival in one tick: the newest measurements, unfiltered, and the set-point on its ramp."""

    tension_n: float  # along the rope, the cell's sample
    speed_mm_s: float  # the drive's own
    setpoint_n: float  # along the rope
    slope_n_s: float  # of the set-point
    tangential_rad: float
    normal_rad: float


@dataclass(frozen=True)
class Model:
    """The plant a rival is tuned for: tension per velocity command ``k / s * e^(-delay s) / (lag s + 1)``.

    ``delay_s`` is the drive's transport delay, what the cell's low-pass is late by, the tick between sample and
    command, and half a tick for the command held over each.
    """

    stiffness_n_mm: float
    lag_s: float
    delay_s: float
    period_s: float
    command_delay_ticks: int
    """The sample read in a tick shows the commands up to the one sent so many ticks before."""

    @classmethod
    def of(cls, settings: RigSettings) -> Model:
        """The plant by the rig file; the rig as built may differ."""
        plant, period_s = settings.plant, 1.0 / settings.loop.rate_hz
        return cls(
            plant.stiffness_n_mm,
            plant.cylinder_lag_s,
            plant.command_delay_s + settings.tension_cell.late_s + 1.5 * period_s,
            period_s,
            round(plant.command_delay_s / period_s) + 1,
        )


class Feedback(ABC):
    """A feedback law without limits: these are the same for all and are part of `TensionLaw`."""

    @abstractmethod
    def start(self, sample: Sample) -> None:
        """Begin from rest or from a steady pull, with no memory of earlier ticks."""

    @abstractmethod
    def wanted(self, sample: Sample) -> float:
        """Speed to command beside the ramp's own, mm/s; positive shortens the rope."""

    def sent(self, command_mm_s: float) -> None:  # noqa: B027 - some keep no state
        """Receive the command after the limits, the ramp's own speed included."""

    def integrate(self, error_n: float) -> None:  # noqa: B027 - some have no integral
        """Integrate this tick's error (set-point less tension); not called while it would wind up."""


class NewestTension(Protocol):
    """The cell's channel in the loop's inbox, as a rival reads it."""

    tension_n: float


class NewestSpeed(Protocol):
    """The drive's channel."""

    speed_mm_s: float


class NewestSlope(Protocol):
    """The inclinometer's channel."""

    tangential_rad: float
    normal_rad: float


class Newest(NamedTuple):
    """Where the newest measurements are."""

    cell: NewestTension
    drive: NewestSpeed
    slope: NewestSlope


class Rival(TensionLaw):
    """A feedback law in the place of ours: ramps, set-point, limits and modes are those of `TensionLaw`."""

    def __init__(self, settings: RigSettings, gains: Gains, newest: Newest, feedback: Feedback) -> None:
        super().__init__(settings, gains)
        self._newest = newest
        self._feedback = feedback
        self._fresh = True

    def start_ramp(self, vertical_n: float, speed_mm_s: float) -> None:
        """See `TensionLaw`; the feedback loses its memory."""
        super().start_ramp(vertical_n, speed_mm_s)
        self._fresh = True

    def _closed(self, estimate: Estimate, cosine: float, slope_n_s: float, added_mm_s: float) -> float:  # noqa: ARG002
        newest = self._newest
        self.rope_setpoint_n = self.setpoint_n / cosine
        sample = Sample(
            newest.cell.tension_n,
            newest.drive.speed_mm_s,
            self.rope_setpoint_n,
            slope_n_s,
            newest.slope.tangential_rad,
            newest.slope.normal_rad,
        )
        if self._fresh:
            self._feedback.start(sample)
            self._fresh = False
        ramp_mm_s = slope_n_s / self._stiffness
        wanted = ramp_mm_s + self._feedback.wanted(sample)
        command = self.limited(wanted, estimate.stroke_mm)
        self._feedback.sent(command)
        error_n = sample.setpoint_n - sample.tension_n
        if command == wanted or (command - wanted) * error_n > 0.0:  # the anti-windup of our law
            self._feedback.integrate(error_n)
        return command
