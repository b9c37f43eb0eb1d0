"""The ``limits`` section of a rig file: further rows of the safety table."""

from __future__ import annotations

from typing import Literal, NamedTuple

from pydantic import Field, model_validator

from rigctl.config.settings_base import Settings, require


class Signal(NamedTuple):
    """Unit and meaning of a signal that a limit may watch."""

    unit: str
    meaning: str


SIGNALS: dict[str, Signal] = {
    "tension_n": Signal("N", "tension of the rope, corrected"),
    "tension_rate_n_s": Signal("N/s", "its rate of change, low-passed by 5 ms, absolute"),
    "vertical_error_n": Signal("N", "vertical tension less its set-point, absolute; 0 where nothing is regulated"),
    "tangential_deg": Signal("deg", "inclination of the rope along the move"),
    "normal_deg": Signal("deg", "inclination of the rope along the rail"),
    "stroke_mm": Signal("mm", "stroke of the cylinder, positive = shorter rope"),
    "travel_mm": Signal("mm", "stroke since the target was reached, absolute; 0 unless COMPENSATING"),
    "speed_mm_s": Signal("mm/s", "speed the drive reports"),
    "disturbance_mm_s": Signal("mm/s", "speed of the rope's ends as the filter finds it, absolute"),
    "drive_temperature_c": Signal("deg C", "of the drive; a limit on it is a fault while it does not come"),
    "drive_current_a": Signal("A", "of the motor, absolute; a limit on it is a fault while it does not come"),
    "drive_warning": Signal("", "1 while the drive warns (statusword bit 7)"),
    "cell_age_ms": Signal("ms", "age of the newest tension sample"),
    "inclination_age_ms": Signal("ms", "age of the newest inclination"),
    "drive_age_ms": Signal("ms", "age of the newest word from the drive"),
    "rejects": Signal("samples", "consecutive samples of cell or drive that the innovation gate refused"),
    "cell_nis": Signal("", "running mean of the cell's normalised innovation squared: 1 for a filter that fits"),
    "lateness_us": Signal("us", "of the tick against its grid"),
    "skipped_ticks": Signal("ticks", "skipped within safety.overrun_window_ms"),
    "error_frames": Signal("frames", "CAN error frames within the last second"),
    "command_age_s": Signal("s", "since an operator gave the last command"),
}

OF_STATUS = frozenset({"drive_temperature_c", "drive_current_a"})
"""Signals that come only with the drive's status (``cylinder.status_rate_hz``)."""

ModeName = Literal["DISARMED", "HOLD", "TENSIONING", "COMPENSATING", "RELEASING", "FAULT"]
SignalName = Literal[
    "tension_n", "tension_rate_n_s", "vertical_error_n", "tangential_deg", "normal_deg", "stroke_mm", "travel_mm",
    "speed_mm_s", "disturbance_mm_s", "drive_temperature_c", "drive_current_a", "drive_warning", "cell_age_ms",
    "inclination_age_ms", "drive_age_ms", "rejects", "cell_nis", "lateness_us", "skipped_ticks", "error_frames",
    "command_age_s",
]  # fmt: skip


class LimitSettings(Settings):
    """One limit. All but ``log`` latch a fault; ``power_off`` stops first, if the drive obeys."""

    signal: SignalName
    low: float | None = Field(default=None, description="lowest value allowed")
    high: float | None = Field(default=None, description="highest value allowed")
    rate: float | None = Field(
        default=None, gt=0, description="highest rate of change, per second, low-passed by 20 ms"
    )
    persistence_ms: int = Field(default=0, ge=0, le=3_600_000, description="how long it must be passed")
    action: Literal["log", "ramp_down", "hold", "quick_stop", "power_off"]
    modes: list[ModeName] = Field(
        default=["HOLD", "TENSIONING", "COMPENSATING", "RELEASING"], min_length=1, description="where it is watched"
    )

    @model_validator(mode="after")
    def _bounds_agree(self) -> LimitSettings:
        bounded = any(bound is not None for bound in (self.low, self.high, self.rate))
        require(bounded, "signal", self.signal, "a limit with low, high or rate")
        if self.low is not None and self.high is not None:
            require(self.low < self.high, "low", self.low, f"below high ({self.high:g})")
        return self
