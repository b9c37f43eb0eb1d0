"""The disturbances of a scenario file: one class per kind, in the order of docs/scenario.md."""

from __future__ import annotations

import itertools
from typing import Annotated, Literal

from pydantic import Field, model_validator

from rigctl.config.settings_base import Settings, require

LONGEST_S = 3600
HIGHEST_HZ = 500
"""Half the sampling rate of the truth: faster motion would alias."""

Start = Annotated[float, Field(ge=0, le=LONGEST_S, description="when it begins")]
Duration = Annotated[
    float | None,
    Field(gt=0, le=LONGEST_S, description="how long, fades included; null = past the run's end"),
]
Fade = Annotated[float, Field(gt=0, le=60, description="its amplitude rises, and falls before duration_s, over this")]
Frequency = Annotated[float, Field(gt=0, le=HIGHEST_HZ, description="frequency")]
Phase = Annotated[float, Field(ge=-360, le=360, description="phase of the sine when it begins")]
FloorAxis = Annotated[
    Literal["vertical", "radial", "tangential"],
    Field(description="radial, tangential: the mechanism's at its start"),
]
Level = Annotated[float, Field(ge=-100, le=100, description="level of the rail, positive up")]


class _Turn(Settings):
    """Speed as a trapezium, or a triangle where the way is short."""

    angle_deg: float = Field(ge=-360, le=360, description="by how much, positive = the way the angles count")
    speed_deg_s: float = Field(gt=0, le=90, description="cruising speed")
    acceleration_deg_s2: float = Field(gt=0, le=1000, description="of every ramp")
    start_s: Start = 0.0


class Rotate(_Turn):
    """The mechanism turns once and stays."""

    kind: Literal["rotate"]


class _Returning(Settings):
    """Out and back to where it was, once or several times."""

    dwell_s: float = Field(default=0.0, ge=0, le=LONGEST_S, description="rest before each way but the first")
    repeats: int = Field(default=1, ge=1, le=1000, description="how many times out and back")


class OutAndBack(_Turn, _Returning):
    """The mechanism turns out and back, the paper's section 2.3."""

    kind: Literal["out_and_back"]


class _Lift(Settings):
    """Speed as a trapezium, or a triangle where the way is short."""

    up_mm: float = Field(ge=-1000, le=1000, description="by how much, positive = up, which slackens the rope")
    speed_mm_s: float = Field(gt=0, le=1000, description="cruising speed")
    acceleration_mm_s2: float = Field(gt=0, le=100_000, description="of every ramp")
    start_s: Start = 0.0


class Lift(_Lift):
    """The mechanism moves up or down once and stays."""

    kind: Literal["move"]


class LiftAndBack(_Lift, _Returning):
    """The mechanism moves up or down and back."""

    kind: Literal["out_and_back"]


class _Passing(Settings):
    """A disturbance with soft beginning and end."""

    start_s: Start = 0.0
    duration_s: Duration = None
    fade_s: Fade = 0.5

    @model_validator(mode="after")
    def _has_time_to_fade(self) -> _Passing:
        long_enough = self.duration_s is None or self.duration_s >= 2.0 * self.fade_s
        require(long_enough, "duration_s", self.duration_s, f"at least twice fade_s ({2.0 * self.fade_s:g})")
        return self


class Heave(_Passing):
    """The mechanism moves up and down as a sine."""

    kind: Literal["sine"]
    amplitude_mm: float = Field(gt=0, le=1000, description="amplitude, half of peak to peak")
    frequency_hz: Frequency
    phase_deg: Phase = 0.0


class LevelPoint(Settings):
    """One point of a survey of the rail."""

    angle_deg: float = Field(ge=-720, le=720, description="angle of the rail from where it starts")
    level_mm: Level


class LevelTable(Settings):
    """Level of the rail through points: a cubic between neighbours that does not overshoot, flat outside them."""

    kind: Literal["table"]
    points: list[LevelPoint] = Field(min_length=2, max_length=1000, description="in ascending order of angle")

    @model_validator(mode="after")
    def _ascends(self) -> LevelTable:
        angles = [point.angle_deg for point in self.points]
        for i, (low, high) in enumerate(itertools.pairwise(angles), 1):
            require(low < high, f"points.{i}.angle_deg", high, f"above the one before it ({low:g})")
        return self


class LevelWave(Settings):
    """Level of the rail as a sine of the rail's angle."""

    kind: Literal["sine"]
    amplitude_mm: float = Field(gt=0, le=100, description="amplitude, half of peak to peak")
    period_deg: float = Field(ge=1, le=720, description="angle of one period; 360 = a shaft out of plumb")
    phase_deg: Phase = 0.0


class FloorTone(_Passing):
    """The gantry shakes against the mechanism's base, one frequency."""

    kind: Literal["tone"]
    axis: FloorAxis
    amplitude_mm: float = Field(gt=0, le=100, description="amplitude, half of peak to peak")
    frequency_hz: Frequency
    phase_deg: Phase = 0.0


class FloorNoise(_Passing):
    """The gantry shakes against the mechanism's base, a band of frequencies: 60 tones of random phase."""

    kind: Literal["noise"]
    axis: FloorAxis
    rms_mm: float = Field(gt=0, le=100, description="root mean square of the whole band")
    from_hz: float = Field(gt=0, le=HIGHEST_HZ, description="lower end of the band")
    to_hz: float = Field(gt=0, le=HIGHEST_HZ, description="upper end of the band")
    seed: int = Field(default=0, ge=0, le=2**31, description="the same seed is the same noise; each axis has its own")

    @model_validator(mode="after")
    def _is_a_band(self) -> FloorNoise:
        require(self.from_hz < self.to_hz, "from_hz", self.from_hz, f"below to_hz ({self.to_hz:g})")
        return self


class Impulse(Settings):
    """An impulse on the payload: half a sine of force. Needs a mechanism that gives way along that axis."""

    kind: Literal["impulse"]
    axis: Literal["tangential", "normal", "vertical"] = Field(
        description="the mechanism's, as it stands; outwards, up: +"
    )
    impulse_n_s: float = Field(ge=-1000, le=1000, description="force times time")
    duration_s: float = Field(default=0.01, ge=0.001, le=1, description="of the force")
    at_s: float = Field(ge=0, le=LONGEST_S, description="when it begins")


class Jolt(Settings):
    """The mechanism jolts up or down and stays there: velocity and acceleration without jumps."""

    kind: Literal["step"]
    height_mm: float = Field(ge=-1000, le=1000, description="how far, positive = up, which slackens the rope")
    rise_s: float = Field(default=0.1, ge=0.005, le=60, description="time it takes")
    at_s: float = Field(ge=0, le=LONGEST_S, description="when it begins")


class MassChange(Settings):
    """Payload is added or taken away. Needs a mechanism that gives way vertically."""

    change_kg: float = Field(ge=-1000, le=1000, description="by how much, positive = heavier")
    ramp_s: float = Field(default=0.0, ge=0, le=LONGEST_S, description="time it takes, 0 = at once")
    at_s: float = Field(ge=0, le=LONGEST_S, description="when it begins")


Rotation = Annotated[Rotate | OutAndBack, Field(discriminator="kind")]
Vertical = Annotated[Lift | LiftAndBack | Heave, Field(discriminator="kind")]
RunOut = Annotated[LevelTable | LevelWave, Field(discriminator="kind")]
Floor = Annotated[FloorTone | FloorNoise, Field(discriminator="kind")]
Impact = Annotated[Impulse | Jolt, Field(discriminator="kind")]


class Disturbances(Settings):
    """All disturbances of a scenario: each kind is a list, whose items add up."""

    mechanism: list[Rotation] = Field(default_factory=list, description="rotation of the mechanism")
    vertical: list[Vertical] = Field(default_factory=list, description="vertical motion of the mechanism")
    run_out: list[RunOut] = Field(default_factory=list, description="level of the rail against its angle")
    floor: list[Floor] = Field(default_factory=list, description="vibration of the gantry against the mechanism's base")
    impacts: list[Impact] = Field(default_factory=list, description="impulses and jolts")
    mass: list[MassChange] = Field(default_factory=list, description="changes of the payload's mass")
