"""What the detectors find, in groups that the snapshot holds: each has one owner, which alone changes it, in place.

A detector makes its group once, as ``seen``. It changes in the detector's ``look`` or ``watch`` of a tick and is read
after that; so what makes a detector begin anew later in the tick shows from the next tick on.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field


@dataclass(slots=True)
class SinkingSeen:
    """The stroke on the closed brake, see `rigctl.control.load.sinking`; speed and distance are 0 elsewhere.

    ``speed_mm_s``: of the stroke, negative: the load sinks. ``apart_mm``: its motion in the last 5 s less that of the
    tension by stiffness, beyond what both may be wrong. ``left_mm``: how far it may sink until the rope is slack.
    """

    speed_mm_s: float = 0.0
    apart_mm: float = 0.0
    left_mm: float = 0.0


@dataclass(slots=True)
class PlausibilitySeen:
    """Comparisons that no single signal shows, see `rigctl.control.watch.plausibility`.

    ``runaway_mm_s``: by how much the drive's speed is beyond any command, while that grows from sample to sample.
    ``speed_error_mm_s``: drive's speed against the model of the drive (lag and delay of the plant) under the commands
    sent. ``stroke_error_mm``: the same, of the position. ``contradiction_mm``: position against the speed reported
    beside it. ``unexplained_mm``: stretch by the tension that the stroke does not explain. ``cell_repeats``: samples in
    a row with the very same value. ``cell_unrest_n``: mean step from sample to sample over 100 ms, in which a single
    step counts little. ``cell_step_n``: see `rigctl.control.bus.cell_step`. ``tension_rate_n_s``: low-passed by 5 ms.
    """

    runaway_mm_s: float = 0.0
    speed_error_mm_s: float = 0.0
    stroke_error_mm: float = 0.0
    contradiction_mm: float = 0.0
    unexplained_mm: float = 0.0
    cell_repeats: int = 0
    cell_unrest_n: float = 0.0
    cell_step_n: float = 0.0
    tension_rate_n_s: float = 0.0


@dataclass(slots=True)
class HeldTensionSeen:
    """The tension of a held stroke against its latch, see `rigctl.control.load.held_tension`.

    ``stretched_mm``: disagreement of encoder and tension while the motor holds, if it is a share of the load;
    ``growing_mm``: the same while it grows. ``fallen_n``: from the highest tension that has lasted, on the brake, if it
    is a share of that; ``sinks_n``: the same fall while it goes on. All are 0 where they do not apply, and where the
    cell is silent, invalid or repeats itself.
    """

    stretched_mm: float = 0.0
    growing_mm: float = 0.0
    fallen_n: float = 0.0
    sinks_n: float = 0.0


@dataclass(slots=True)
class StrokeHoldSeen:
    """A held stroke, see `rigctl.control.load.stroke_hold`: as it was found before this tick's correction.

    ``excursion_mm``: stroke from the latch, 0 while nothing is latched. ``corrected_mm``: sum of the correction since
    the latch.
    """

    excursion_mm: float = 0.0
    corrected_mm: float = 0.0


@dataclass(slots=True)
class TakeUpSeen:
    """The rope's force by the motor's current while it is tensioned, see `rigctl.control.load.take_up`.

    ``rise_n``, ``shown_n``: rise of that force, and that of the tension. ``limit_n``: of their difference.
    ``excess_n``: beyond it, negative within it, 0 until it is known.
    """

    rise_n: float = 0.0
    shown_n: float = 0.0
    limit_n: float = 0.0
    excess_n: float = 0.0


@dataclass(slots=True)
class TravelSeen:
    """How far the stroke has moved the load unseen by the cell, see `rigctl.control.watch.unseen_travel`.

    ``unseen_n`` against ``bound_n``, of the two bounds the one that is nearer. ``excess_n``: beyond it, negative
    within.
    """

    unseen_n: float = 0.0
    bound_n: float = 0.0
    excess_n: float = 0.0


@dataclass(slots=True)
class ProbeSeen:
    """Whether cell, encoder, drive and rope answer the probe, see `rigctl.control.excitation.sensor_probe`.

    ``words``: of the newest finding. ``travel``: of the two that are watched the one that is nearer to its bound.
    """

    cell_frozen: bool = False
    encoder_stuck: bool = False
    drive_motionless: bool = False
    rope_changed: bool = False
    words: str = ""
    travel: TravelSeen = field(default_factory=TravelSeen)


@dataclass(slots=True)
class SignsSeen:
    """What the newest tick of the sign checks has found, see `rigctl.control.watch.signs`.

    ``words``: of a stiffness beyond the family, until the next TENSIONING.
    """

    drive_reversed: bool = False
    cell_reversed: bool = False
    words: str = ""


@dataclass(slots=True)
class ReadbackSeen:
    """Settings of the devices that are lost, see `rigctl.control.bus.readback`.

    ``lost``: objects that changed or gave no answer. ``disobeys``: the drive does not do as commanded without one that
    changed. ``unsupervised``: objects of the drive that were found with another value, so that it may not stop by
    itself any more; 0 where its quick stop is among them: it would stop on an unknown ramp, and has to be commanded to.
    ``words``: the first lost object.
    """

    lost: int = 0
    disobeys: bool = False
    unsupervised: int = 0
    words: str = ""


@dataclass(slots=True)
class DriveStatusSeen:
    """The drive's current, temperature and inputs, where its status is configured, see
    `rigctl.control.power.drive_status`.

    ``age_ns``: of the newest. ``temperature_c``, ``current_a``: NaN while they are not known. ``flows``: there is more
    current than a motor without power has; ``lasts``: for so long that the motor has power, though the drive reports
    that it is off. ``e_stop_unseen``: the drive has the input, but its state is stale.
    """

    age_ns: int = 1 << 62
    temperature_c: float = math.nan
    current_a: float = math.nan
    flows: bool = False
    lasts: bool = False
    e_stop_unseen: bool = False
