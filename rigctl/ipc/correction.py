"""From the cell's reading to tension: a zero and a scale, both bounded and on record in the ledger."""

from __future__ import annotations

import math
from dataclasses import dataclass

from rigctl.config.settings import RigSettings

SCALE_BOUND = 0.02  # a cell with a larger error needs repair, not a factor


@dataclass(frozen=True)
class Correction:
    """``tension = (reading - zero_n) * scale``; ``overdue``: no valid calibration and no waiver, which bars arming."""

    zero_n: float = 0.0
    scale: float = 1.0
    overdue: bool = False

    def applied(self, reading_n: float) -> float:
        """Tension in N."""
        return (reading_n - self.zero_n) * self.scale

    def fits(self, settings: RigSettings) -> bool:
        """Within the bounds: a correction may shift the tension a little, never hide a load or a lost rope."""
        limit = tare_limit_n(settings)
        return (
            math.isfinite(self.zero_n + self.scale)
            and abs(self.zero_n) <= limit
            and abs(self.scale - 1.0) <= SCALE_BOUND
        )


def tare_limit_n(settings: RigSettings) -> float:
    """Largest zero; none without a calibration section."""
    return settings.calibration.tare_limit_n if settings.calibration is not None else 0.0
