"""What the detectors find, in groups that the snapshot holds: each has one owner, which alone changes it, in place.

A detector makes its group once, as ``seen``. It changes in the detector's ``look`` or ``watch`` of a tick and is read
after that; so what makes a detector begin anew later in the tick shows from the next tick on.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(slots=True)
class SinkingSeen:
    """The stroke on the closed brake, see `rigctl.control.sinking`; speed and distance are 0 elsewhere.

    ``speed_mm_s``: of the stroke, negative: the load sinks. ``apart_mm``: its motion in the last 5 s less that of the
    tension by stiffness, beyond what both may be wrong. ``left_mm``: how far it may sink until the rope is slack.
    """

    speed_mm_s: float = 0.0
    apart_mm: float = 0.0
    left_mm: float = 0.0
