"""Whether the filter fits the rig that ran: NIS and whiteness of the innovations on record.

NIS is the mean of the squared innovation over its variance: 1 where sensor noise and model are as the filter assumes,
above it where the rig does more. White innovations have no correlation from sample to sample, so that 5 % of the lags
are beyond ``1.96 / sqrt(n)`` (Bar-Shalom, Li, Kirubarajan: Estimation with Applications to Tracking, section 5.4).
A filter that is deliberately quiet or slow is not white: the correlation is how much of a disturbance it leaves.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from rigctl.metrics.phases import JudgedPhase

USED = 1  # `rigctl.model.samples.Verdict`
LAGS = 50  # a twentieth of a second at 1 kHz
BEYOND = 1.96
SENSORS = (
    ("tension", "innovation_n", "innovation_n2", "tension_verdict"),
    ("speed", "speed_innovation_mm_s", "speed_innovation_mm2_s2", "speed_verdict"),
)
Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class InnovationStatistics:
    """Innovations of one sensor over the judged time."""

    sensor: str
    samples: int
    nis: float
    beyond: float  # share of LAGS whose correlation is beyond the 95 % limit of white noise
    largest: float  # correlation of the largest of them, signed
    largest_lag: int  # in samples
    refused: int  # by the gate

    def nis_words(self) -> str:
        """``NIS 1.03 (0.99 to 1.01 for a filter that fits)``: 95 % for white innovations."""
        half = BEYOND * math.sqrt(2.0 / self.samples)
        return f"{self.nis:.3g} ({1.0 - half:.3g} to {1.0 + half:.3g} for a filter that fits)"

    def white_words(self) -> str:
        """``4 % of 50 lags beyond 95 %, largest 0.02 at 12``."""
        return f"{100 * self.beyond:.0f} % of {LAGS} lags beyond 95 %, largest {self.largest:.2g} at {self.largest_lag}"


def innovation_statistics(records: npt.NDArray[Any], phases: Iterable[JudgedPhase]) -> list[InnovationStatistics]:
    """Of each sensor whose innovations are on record and were used in the judged time."""
    names, found = records.dtype.names or (), []
    parts = [records[phase.judged] for phase in phases]
    for sensor, innovation, variance, verdict in SENSORS:
        if not {innovation, variance, verdict} <= set(names):
            continue
        normal, refused = [], 0
        for part in parts:
            used = (part[verdict] == USED) & (part[variance] > 0.0)
            refused += int(np.count_nonzero(part[verdict] == USED + 1))
            normal.append(part[innovation][used] / np.sqrt(part[variance][used]))
        statistics = _statistics(sensor, normal, refused)
        if statistics is not None:
            found.append(statistics)
    return found


def _statistics(sensor: str, parts: list[Floats], refused: int) -> InnovationStatistics | None:
    long = [part for part in parts if len(part) > 2 * LAGS]
    samples = sum(map(len, long))
    power = sum(float(part @ part) for part in long)
    if not power > 0.0:
        return None
    sums = np.zeros(LAGS)
    for part in long:
        spectrum = np.fft.rfft(part, 2 * len(part))
        sums += np.fft.irfft(np.abs(spectrum) ** 2)[1 : LAGS + 1]
    correlation = sums / power
    at = int(np.argmax(np.abs(correlation)))
    beyond = float(np.mean(np.abs(correlation) > BEYOND / math.sqrt(samples)))
    return InnovationStatistics(sensor, samples, power / samples, beyond, float(correlation[at]), at + 1, refused)
