"""The probe in the loop: the multisine's speed, what has answered it, and how far the stroke has gone unseen."""

from __future__ import annotations

import math

from rigctl.config.settings import RigSettings
from rigctl.control.excitation.margin_probe import Probe
from rigctl.control.excitation.probe_plan import JUDGEMENTS_PER_PERIOD, ProbePlan
from rigctl.control.excitation.sensor_probe import ProbeFinding, SensorProbe
from rigctl.control.findings import ProbeSeen
from rigctl.control.snapshot import Snapshot
from rigctl.control.watch.unseen_travel import UnseenTravel


class NoProbe:
    """Of a law that is none of ours: what it would make of a multisine is not known.

    ``found``: see `rigctl.control.excitation.sensor_probe`; ``seen`` has it from the next ``look`` on. The travel is
    the one of two that is nearer to its bound: since COMPENSATING began, or since the ramp before it.
    """

    def __init__(self, settings: RigSettings, detection_s: float = 0.0, step_s: float = 1.0) -> None:
        self.found = self._shown = ProbeFinding.NONE
        self._words = ""
        self._regulated = UnseenTravel(settings, detection_s, step_s)
        self._ramped = UnseenTravel(settings, detection_s, step_s)
        self._watches_ramp = settings.plant.mechanism_n_mm is None  # one that gives way bounces on the ramp
        self.seen = ProbeSeen(travel=self._regulated.seen)
        self.stiffness_n_mm = self._regulated.stiffness_n_mm
        self._judged = True  # nothing can be said of the cell: only the whole travel is bounded

    def look(
        self, snapshot: Snapshot, cosine: float, setpoint_n: float, *, ramping: bool, compensating: bool
    ) -> None:  # fmt: skip
        """One tick, before it is decided: the travel.

        Args:
            snapshot: of this tick.
            cosine: of the rope against the vertical.
            setpoint_n: of the rope: the one in force, while TENSIONING the largest up to the target.
            ramping: TENSIONING, on a tight rope.
            compensating: COMPENSATING.
        """
        watched = (
            (self._ramped, self._watches_ramp and (ramping or compensating), True),
            (self._regulated, compensating, self._judged),
        )
        for travel, on, judged in watched:
            if on:
                travel.look(
                    snapshot.stroke_mm, snapshot.speed_mm_s, snapshot.tension_n, cosine, setpoint_n, judged=judged
                )
            else:
                travel.end()
        ramped, regulated, seen = self._ramped.seen, self._regulated.seen, self.seen
        seen.travel, seen.words = ramped if ramped.excess_n > regulated.excess_n else regulated, self._words
        if self.found is not self._shown:
            self._shown = found = self.found
            seen.cell_frozen = found is ProbeFinding.CELL_FROZEN
            seen.encoder_stuck = found is ProbeFinding.ENCODER_STUCK
            seen.drive_motionless = found is ProbeFinding.DRIVE_MOTIONLESS
            seen.rope_changed = found is ProbeFinding.ROPE_CHANGED

    def found_stiffness(self, n_mm: float) -> None:
        """The sign check has found this stiffness."""
        self._regulated.found_stiffness(n_mm)
        self._ramped.found_stiffness(n_mm)
        self.stiffness_n_mm = self._regulated.stiffness_n_mm

    def speed_mm_s(
        self, _snapshot: Snapshot, _command_mm_s: float, _ticks: int, *, free: bool  # noqa: ARG002
    ) -> float:  # fmt: skip
        """None."""
        return 0.0


class LoopProbe(NoProbe):
    """The multisine, and who answers it."""

    def __init__(self, settings: RigSettings, plan: ProbePlan, quantum_mm: float) -> None:
        """``quantum_mm``: of the drive's position."""
        super().__init__(settings, plan.detection_s, plan.period_s / JUDGEMENTS_PER_PERIOD)
        self._least = plan.threshold(plan.spread, plan.windows(plan.spread))
        self._multisine = Probe(settings, plan.shape, plan.level)
        self._sensors = SensorProbe(settings, plan, quantum_mm)
        self._judged = False

    def speed_mm_s(self, snapshot: Snapshot, command_mm_s: float, ticks: int, *, free: bool) -> float:
        """Speed of this tick.

        Args:
            snapshot: of this tick.
            command_mm_s: sent in the tick before.
            ticks: since the last call.
            free: COMPENSATING without a trial, and the set-point is on the target.
        """
        multisine, sensors = self._multisine, self._sensors
        speed_mm_s = multisine.speed_mm_s(snapshot.vertical_error_n, free=free)
        self._judged = False
        if not multisine.whole:
            if sensors.sees:
                sensors.lose()
        else:
            if ticks > 1:
                sensors.skip()
            if sensors.see(multisine.place, snapshot.tension_n, snapshot.stroke_mm, command_mm_s):
                self._judged = sensors.found is ProbeFinding.WHOLE
                if sensors.found is ProbeFinding.ROPE_CHANGED:
                    self._words = f"{sensors.rope.now_n_mm:.3g} N/mm, {sensors.rope.before_n_mm:.3g} N/mm before"
                elif sensors.found > ProbeFinding.WHOLE and math.isfinite(sensors.share):
                    self._words = f"the cell shows {sensors.share:.2f} of it, limit {self._least:.2f}"
        self.found = sensors.found
        return speed_mm_s
