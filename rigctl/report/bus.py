"""Figures of the CAN bus in a recording."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from rigctl.config.settings import RigSettings
from rigctl.devices import busload
from rigctl.metrics import tension_error as metrics
from rigctl.metrics.timing import grown

Array = npt.NDArray[Any]


@dataclass(frozen=True)
class Bus:
    """Frames over the recording, and the worst-case load by the settings."""

    sent: int
    received: int
    lost: int
    refused: int
    unsent: int
    error_frames: int
    load: float | None
    """Fraction of the bit rate; None without a bit rate, or if the settings cannot be read."""
    load_limit: float


def bus(records: Array, settings: RigSettings | None) -> Bus:
    """Figures of ``RECORD`` slots, at least one."""
    tail = records["frames_lost"][-metrics.IN_FLIGHT_TICKS :].astype(np.int64)
    late = int(tail[-1] - np.min(tail)) if int(records["tick"][-1]) >= len(tail) else 0
    try:
        load = busload.bus_load(settings) if settings is not None else None
    except ValueError:
        load = None  # the frames are in a DBC file, which the recording does not have
    return Bus(
        sent=grown(records, "frames_sent"),
        received=grown(records, "frames_received"),
        lost=max(0, grown(records, "frames_lost") - late),
        refused=grown(records, "frames_refused"),
        unsent=grown(records, "send_failures"),
        error_frames=grown(records, "error_frames"),
        load=load,
        load_limit=busload.LIMIT,
    )
