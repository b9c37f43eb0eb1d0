"""One run of a study: its changes to the rig file and the prescribed motion."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from hil.plant.inputs import Track
from hil.plant.moves import leg, out_and_back
from rigctl.config.changed_settings import changed
from rigctl.config.settings import RigSettings

RAMP_S = 2.0
"""Time in which the mechanism reaches its speed, for every speed; the paper gives none."""
STIFFNESSES_N_MM = (6.0, 13.0, 20.0, 27.0, 34.0)
SPEED_DEG_S, TURN_DEG = 0.5, 13.0


@dataclass(frozen=True, kw_only=True)
class PlannedRun:
    """A run on the rig of the file, except for its changes."""

    name: str
    title: str
    tracks: Mapping[int, Track]
    seconds: float
    changes: Mapping[str, object] = field(default_factory=dict)
    """Values by dotted key of the rig file; those of ``simulation`` are known to the plant only."""

    def settings(self, rig: RigSettings, waiver: str | None = None) -> RigSettings:
        """The rig of this run; ``waiver`` lets a design run that misses ``design.ms_max``."""
        waived = {"design.waiver": waiver} if waiver is not None and rig.design.waiver is None else {}
        return changed(rig, {**self.changes, **waived})


def onwards(speed_deg_s: float, seconds: float) -> Track:
    """Rotation of the mechanism at constant speed to beyond the end of a run of ``seconds``."""
    top = math.radians(speed_deg_s)
    rows, _ = leg(0.0, 0.0, 2.0 * top * seconds, top, top / RAMP_S)
    return Track(segments=np.array(rows), end=seconds)


def turn_and_return() -> Track:
    """The mechanism's move of the paper's experiment, section 2.3: 13 deg out and back."""
    top = math.radians(SPEED_DEG_S)
    return out_and_back(math.radians(TURN_DEG), top, top / RAMP_S)
