"""What moves the stroke in a tick: the law of the mode, and what is added to its command."""

from __future__ import annotations

from collections.abc import Sequence

from rigctl.config.settings import RigSettings
from rigctl.control.commands.orders import Orders
from rigctl.control.excitation.loop_probe import NoProbe
from rigctl.control.law.gain_table import GainTable
from rigctl.control.law.move_learning import MoveLearning
from rigctl.control.law.tension import Estimate, TensionLaw
from rigctl.control.load.held_load import HeldLoad
from rigctl.control.logbook import Logbook
from rigctl.control.observer import Observer
from rigctl.control.power.machine import Change, Machine
from rigctl.control.watch.signs import SignCheck
from rigctl.model.events import Kind
from rigctl.model.states import Event, Mode


class StrokeMotion:
    """Chooses the stroke's speed, and begins and ends the modes that move it.

    ``added_mm_s``: by a trial or the probe, to the law's command; ``learned_mm_s``: by a move that was learnt.
    ``travel_from``: stroke in mm and set-point in N at the begin of COMPENSATING.
    """

    def __init__(
        self, settings: RigSettings, machine: Machine, observer: Observer, law: TensionLaw, logbook: Logbook,
        orders: Orders, load: HeldLoad, signs: SignCheck, probe: NoProbe, learning: MoveLearning | None,
        table: GainTable | None,
    ) -> None:  # fmt: skip
        """``table``: gains by operating point; ``learning``: of the mechanism's moves; None: the rig has none."""
        self._machine, self._observer, self._law, self._logbook = machine, observer, law, logbook
        self._orders, self._load, self._signs, self._probe = orders, load, signs, probe
        self._learning, self._table = learning, table
        self._stiffness_n_mm = settings.plant.stiffness_n_mm
        self.travel_from = 0.0, 0.0
        self.added_mm_s = self.learned_mm_s = 0.0

    def end_mode(self, estimate: Estimate) -> None:
        """Take the event that ends TENSIONING or RELEASING."""
        machine, signs = self._machine, self._signs
        if machine.mode is Mode.RELEASING:
            if self._load.lowered(estimate):
                machine.on(Event.SLACK)
        elif self._law.tensioned(estimate):
            if signs.passed:
                machine.on(Event.UNTESTED if self._load.brake.wants_test else Event.TENSIONED)
            elif not signs.probe_mm_s:
                signs.feel(estimate.stroke_mm, self._observer.tension_n)

    def begin_modes(self, changes: Sequence[Change], estimate: Estimate) -> None:
        """Start what a change of mode needs: ramp, sign check, travel, a new latch of the stroke."""
        law = self._law
        for change in changes:
            self._orders.look_again()
            if change.before is Mode.FAULT:
                self._load.latch_anew()
                self._observer.forget_sinking()
            if change.after is Mode.COMPENSATING:
                self.travel_from = estimate.stroke_mm, law.setpoint_n
            if change.after in (Mode.TENSIONING, Mode.RELEASING):
                self._load.brake.follow()
                law.begin(estimate.tension_n * self._observer.cosine, estimate.speed_mm_s)
                self._signs.begin(estimate.stroke_mm, self._observer.tension_n, estimate.speed_mm_s)
            if change.event is Event.PAY_OUT:
                law.pay_out(estimate.stroke_mm, self._orders.length_mm)

    def speed_mm_s(self, estimate: Estimate) -> float:
        """Speed to command in this tick; the filter gets it as well."""
        law, mode, trial, snapshot = self._law, self._machine.mode, self._orders.trial, self._observer.snapshot
        regulates, ticks = mode is Mode.COMPENSATING, 1 + self._observer.just_skipped
        free = regulates and trial is None and law.setpoint_n == law.target_n
        added_mm_s = self._probe.speed_mm_s(snapshot, law.command_mm_s, ticks, free=free)
        if trial is not None and trial.moves:
            added_mm_s = trial.wanted_mm_s
        self.added_mm_s = added_mm_s
        unfiltered_mm_s = 0.0  # added where the filter is to see its effect only, as that of a disturbance
        if self._learning is not None:
            self.learned_mm_s = self._learned(self._learning, mode)
        whole_mm_s = added_mm_s + self.learned_mm_s
        if not snapshot.drive_enabled:
            law.follow_speed(0.0)
            law.hold(estimate, self._load.correction(powered=False))
            speed_mm_s = 0.0
        elif regulates:
            speed_mm_s, unfiltered_mm_s = law.compensating(estimate, self._observer.cosine, whole_mm_s), added_mm_s
        else:
            speed_mm_s = self._unregulated(estimate, whole_mm_s, added_mm_s)
        self._observer.filter.command(speed_mm_s - unfiltered_mm_s)
        if self._table is not None and mode.moves_stroke:
            self._follow_table(self._table, estimate.stroke_mm)
        return speed_mm_s

    def _unregulated(self, estimate: Estimate, whole_mm_s: float, added_mm_s: float) -> float:
        """Speed of an enabled drive in the other modes.

        ``added_mm_s``: by a trial or the probe. ``whole_mm_s``: with that by a move that was learnt.
        """
        law, mode, cosine, trial = self._law, self._machine.mode, self._observer.cosine, self._orders.trial
        if mode is Mode.TENSIONING:
            return law.tensioning(estimate, cosine, self._signs.probe_mm_s, whole_mm_s)
        if mode is Mode.RELEASING:
            return self._load.releasing(estimate, cosine, whole_mm_s)
        if mode is Mode.HOLD and trial is not None and trial.moves:
            return law.limited(added_mm_s, estimate.stroke_mm)
        powered = self._machine.sequence.motor and (self._load.carried.corrects or not self._load.on_motor)
        return law.hold(estimate, self._load.correction(powered=powered))

    def _follow_table(self, table: GainTable, stroke_mm: float) -> None:
        """Put the entry of the table for this operating point in force."""
        if self._orders.settings.gains_ordered:  # they replace the table
            self._table = None
            return
        observer, law = self._observer, self._law
        entry = table.look(law.rope_setpoint_n, stroke_mm, observer.filter)
        if entry is not None:
            observer.change_filter(entry.filter)
            law.change_gains(entry.gains, entry.stiffness_n_mm)
            self._logbook.event(observer.snapshot.t_ns, Kind.GAINS, text=entry.gains.text)

    def _learned(self, learning: MoveLearning, mode: Mode) -> float:
        observer, (tangential, _, normal, _) = self._observer, self._observer.inclination.state
        ticks, stroke_mm = 1 + observer.just_skipped, observer.snapshot.stroke_mm
        return learning.step(mode, ticks, observer.tension_n, stroke_mm, tangential, normal)

    def check_signs(self, now_ns: int) -> None:
        """Compare the signs of command, stroke and tension in the first motion."""
        signs, inbox = self._signs, self._observer.inbox
        signs.see(self._law.command_mm_s, inbox.drive.stroke_mm, inbox.cell.tension_n)
        if signs.passed:
            self._load.found_stiffness(signs.slope_n_mm)
            self._probe.found_stiffness(signs.slope_n_mm)
            stiffness = self._stiffness_n_mm
            self._logbook.event(now_ns, Kind.SIGNS, int(signs.warns), value=signs.slope_n_mm, limit=stiffness)
