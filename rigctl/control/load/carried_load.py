"""The witness of a load that the motor carries or lowers because its brake does not hold.

While encoder and cell agree, both show the load. Where one of them is in doubt, the other alone has to: an operator
names it, or the cause that is active does. A witness that does not follow the command shows a motor that does not.
"""

from __future__ import annotations

import math

from rigctl.config.settings import RigSettings
from rigctl.control.load.load_at_rest import STROKE_BITS
from rigctl.control.load.rope_memory import CONTRADICTED_BIT, RopeMemory
from rigctl.control.snapshot import Snapshot
from rigctl.model.faults import Fault, Trait, bits_of, having
from rigctl.model.states import Witness

LOWERS_MM_S = 2.0
"""By the encoder alone, which shows no tension."""
SPARE_MM = 5.0
"""Beyond the way after which the rope is slack by its last credible tension."""
FOLLOWS_MM, FOLLOWS_NS = 0.5, 300_000_000
"""How far, and for how long, the tension may be from what the commanded stroke makes of it."""
_ENDS_BITS = bits_of(having(Trait.STOPS_CARRYING))
_BY_CELL = Fault.TENSION_HIGH.bit
_BY_ENCODER = Fault.DRIVE_NOT_FOLLOWING.bit
WITNESS_TEXT = "the tension does not follow the commanded stroke"


def longest_lowering_s(settings: RigSettings) -> float:
    """Time in s to lower the largest load that a motor may carry: by the encoder alone, or by the tension's ramp."""
    load_n, tension = settings.safety.tension_high_n, settings.tension
    by_encoder_s = (load_n / settings.plant.slow_stiffness_n_mm + SPARE_MM) / LOWERS_MM_S
    by_tension_s = load_n / tension.ramp_n_s + SPARE_MM / min(tension.speed_max_mm_s, LOWERS_MM_S)
    return max(by_encoder_s, by_tension_s)


class CarriedLoad:
    """``named``: the witness that the operator has named; ``by``: that of now.

    ``corrects``: the encoder may correct a stroke that creeps; no more once it has contradicted the tension.
    ``strayed_mm``: how far the tension is from what the commanded stroke makes of it; 0 while it follows. It stays
    until a witness is named again or a fault is reset.
    """

    def __init__(self, settings: RigSettings, rope: RopeMemory) -> None:
        plant = settings.plant
        self._rope, self._stiffness = rope, plant.slow_stiffness_n_mm
        self._slack_n = settings.tension.slack_n
        self._dt = 1.0 / settings.loop.rate_hz
        self._share = self._dt / (plant.cylinder_lag_s + plant.command_delay_s + self._dt)
        self._begin(Witness.BOTH)

    def begin(self, named: Witness, standing: int, snapshot: Snapshot) -> None:
        """A CARRY or LOWER is accepted, with the witness that the operator has named."""
        self._begin(named)
        self.by = self.choose(standing, snapshot)

    def forget(self) -> None:
        """The fault that the motor carried the load in is reset."""
        self._begin(Witness.BOTH)

    def _begin(self, named: Witness) -> None:
        self.named = self.by = named
        self._lagged_mm_s = self._way_mm = self.strayed_mm = 0.0
        self._from_n = self._lowered_from_mm = self._lower_mm = math.nan
        self.corrects = True
        self._contradicted = False
        self._strays_ns: int | None = None
        self._slack_ns: int | None = None  # since when the cell alone shows a slack rope

    def choose(self, standing: int, snapshot: Snapshot) -> Witness:
        """The witness: the one named, else the one that is not in doubt; BOTH where neither or each is."""
        return self.suits(standing, snapshot) if self.named is Witness.BOTH else self.named

    def suits(self, standing: int, snapshot: Snapshot) -> Witness:
        """The witness that is not in doubt; BOTH where neither or each is."""
        cell = self._rope.cell_in_doubt(standing, snapshot)
        stroke = bool(standing & STROKE_BITS)
        return Witness.BOTH if cell is stroke else Witness.ENCODER if cell else Witness.CELL

    def stopped_by(self, standing: int) -> int:
        """The causes of these that stop the motor."""
        bits = standing & _ENDS_BITS
        if self.by is Witness.ENCODER:
            bits &= ~_BY_CELL
        return bits & ~_BY_ENCODER if self.by is Witness.CELL else bits

    def look(self, standing: int, snapshot: Snapshot, command_mm_s: float, ticks: int) -> None:
        """One tick in which the motor has the load, ``ticks`` after the last; ``command_mm_s``: the last command."""
        self.by = self.choose(standing, snapshot)
        self._contradicted |= bool(standing & CONTRADICTED_BIT)
        self.corrects = self.by is Witness.ENCODER or (self.by is Witness.BOTH and not self._contradicted)
        self._lagged_mm_s += (command_mm_s - self._lagged_mm_s) * min(1.0, self._share * ticks)
        slack = snapshot.tension_n < self._slack_n
        self._slack_ns = None if not slack else snapshot.t_ns if self._slack_ns is None else self._slack_ns
        if self.by is not Witness.CELL or not snapshot.drive_enabled or slack:
            self._from_n, self.strayed_mm, self._strays_ns = math.nan, 0.0, None
            return
        if math.isnan(self._from_n):
            self._from_n, self._way_mm = snapshot.tension_n, 0.0
        self._way_mm += self._lagged_mm_s * self._dt * ticks
        strays_mm = (snapshot.tension_n - self._from_n) / self._stiffness - self._way_mm
        if abs(strays_mm) <= FOLLOWS_MM:
            self._strays_ns = None
        elif self._strays_ns is None:
            self._strays_ns = snapshot.t_ns
        elif snapshot.t_ns - self._strays_ns >= FOLLOWS_NS:
            self.strayed_mm = strays_mm

    def lowering_mm_s(self, stroke_mm: float) -> float | None:
        """Speed at which the encoder alone has the load lowered; None where the tension has it."""
        if self.by is not Witness.ENCODER:
            self._lowered_from_mm = math.nan
            return None
        if math.isnan(self._lowered_from_mm):
            self._lowered_from_mm = stroke_mm
            left_n = self._rope.by_stroke_n(stroke_mm) - self._slack_n
            self._lower_mm = SPARE_MM + (math.inf if math.isnan(left_n) else max(0.0, left_n) / self._stiffness)
        return -LOWERS_MM_S

    def lowered(self, stroke_mm: float, t_ns: int) -> bool:
        """The rope is slack: by the way, where the encoder alone shows it, or by the tension where the cell does."""
        if self.by is Witness.CELL:
            return self._slack_ns is not None and t_ns - self._slack_ns >= FOLLOWS_NS
        return self._lowered_from_mm - stroke_mm >= self._lower_mm
