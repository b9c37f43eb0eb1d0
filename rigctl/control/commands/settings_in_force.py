"""Settings that the gateway sends once they are on record: checks, correction of the cell, gains, measured margins."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

from rigctl.config.settings import RigSettings
from rigctl.control.bus.cell_correction import CellHistory
from rigctl.control.law.tension import Gains, TensionLaw
from rigctl.control.logbook import Logbook
from rigctl.control.observer import Observer
from rigctl.control.power.machine import Machine
from rigctl.ipc.correction import Correction, CreepTerm, creep_share, creep_text
from rigctl.model.checks import HOST_CHECKS, Check
from rigctl.model.events import Kind
from rigctl.model.states import Mode
from rigctl.model.unmeasured import Unmeasured
from rigctl.model.verbs import Refusal, Setting

MS_MOST = 1000.0  # a sensitivity peak above it is no measurement
_Values = Mapping[str, float]  # by the names in `rigctl.model.verbs.VALUES`


class SettingsInForce:
    """Puts settings in force, within their bounds.

    ``host_checks``: bits of HOST_CHECKS that fail. ``overdue``: the calibration is. ``gains_ordered``: gains have come
    as an order since the start.
    """

    def __init__(self, settings: RigSettings, observer: Observer, law: TensionLaw, logbook: Logbook) -> None:
        self._settings, self._observer, self._law, self._logbook = settings, observer, law, logbook
        self.host_checks, self.overdue, self.gains_ordered = 0, False, False
        self._unmeasured = math.nan  # why there are no margins, as it was last in an event

    def start(
        self, host_checks: int, correction: Correction | None, history: CellHistory | None, t_ns: int
    ) -> None:  # fmt: skip
        """Begin with what start-up has found; ``correction``: of the ledger, None: there is none."""
        self.host_checks = host_checks
        if correction is not None:
            self.overdue = correction.overdue
            self.correct(correction, t_ns, history=history)

    def put(self, setting: Setting, values: _Values, t_ns: int, machine: Machine) -> Refusal:
        """Put a setting in force; returns its refusal."""
        match setting:
            case Setting.OVERDUE:
                self.overdue = values["overdue"] != 0.0
            case Setting.HOST_CHECKS:
                return self._set_host_checks(values["host_checks"])
            case Setting.MARGINS:
                return self._set_margins(
                    t_ns, machine.mode, values["sensitivity_peak"], values["sensitivity_peak_error"]
                )
            case Setting.DIFFERS:
                self._logbook.event(
                    t_ns, Kind.MARGINS_DIFFER, value=values["sensitivity_peak"], limit=values["sensitivity_peak_error"]
                )
            case Setting.LAW_GAINS:
                return self._set_gains(Gains(**values), t_ns)
            case Setting.CREEP:
                return self._set_creep(values, t_ns, machine)
            case _:
                return self._set_correction(values, t_ns, machine)
        return Refusal.NONE

    def _set_correction(self, values: _Values, t_ns: int, machine: Machine) -> Refusal:
        """Put zero or scale of the cell in force; the reading jumps, so only in DISARMED or HOLD."""
        inbox = self._observer.inbox
        if not machine.mode.reading_may_jump or machine.sequence.ends:
            return Refusal.WRONG_MODE
        if "zero_n" in values and not abs(inbox.cell.reading_n) <= self._settings.tare_limit_n:
            return Refusal.LOADED
        now, overdue = inbox.cell_correction.correction, values.get("overdue", math.nan)
        wanted = replace(now, scale=values.get("scale", now.scale))
        second_scale, second_zero_n = values.get("second_scale", math.nan), values.get("second_zero_n", math.nan)
        if not math.isnan(second_scale):
            wanted = replace(wanted, second_scale=second_scale)
        if "zero_n" in values:
            zero_c, zero_n_k = values["zero_c"], values["zero_n_k"]
            wanted = replace(
                wanted,
                zero_n=values["zero_n"],
                zero_c=None if math.isnan(zero_c) else zero_c,
                zero_n_k=now.zero_n_k if math.isnan(zero_n_k) else zero_n_k,
                second_zero_n=now.second_zero_n if math.isnan(second_zero_n) else second_zero_n,
            )
        if not wanted.fits(self._settings):
            return Refusal.OUT_OF_RANGE
        if not math.isnan(overdue):
            self.overdue = overdue != 0.0
        self.correct(wanted, t_ns)
        return Refusal.NONE

    def _set_creep(self, values: _Values, t_ns: int, machine: Machine) -> Refusal:
        """Put the cell's creep in force, or none; the reading jumps a little, so only in DISARMED or HOLD."""
        if not machine.mode.reading_may_jump or machine.sequence.ends:
            return Refusal.WRONG_MODE
        terms = (
            CreepTerm(values["creep_1"], values["creep_1_s"]),
            CreepTerm(values["creep_2"], values["creep_2_s"]),
        )
        now = self._observer.inbox.cell_correction.correction
        wanted = replace(now, creep=terms if any(term.share for term in terms) else ())
        if not wanted.fits(self._settings):
            return Refusal.OUT_OF_RANGE
        self.correct(wanted, t_ns, held_s=values["creep_held_s"])
        return Refusal.NONE

    def _set_host_checks(self, bits: float) -> Refusal:
        """Take the failing bits of the checks that the loop cannot make itself."""
        known = bits >= 0.0 and bits.is_integer() and not int(bits) & ~int(HOST_CHECKS)
        self.host_checks = int(bits) if known else int(Check.HOST)
        return Refusal.NONE if known else Refusal.OUT_OF_RANGE

    def _set_margins(self, t_ns: int, mode: Mode, ms: float, error: float) -> Refusal:
        """Take the sensitivity peak measured in this COMPENSATING; NaN: there is none, ``error`` says why."""
        if mode is not Mode.COMPENSATING:
            return Refusal.WRONG_MODE
        if math.isnan(ms) and error in list(Unmeasured):
            if error != self._unmeasured:
                self._logbook.event(t_ns, Kind.NO_MARGINS, int(error))
            self._unmeasured = error
            self._observer.take_margins(math.nan, math.nan)
            return Refusal.NONE
        if not (1.0 <= ms <= MS_MOST and 0.0 <= error <= MS_MOST):
            return Refusal.OUT_OF_RANGE
        self._observer.take_margins(ms, error)
        self._unmeasured = math.nan
        return Refusal.NONE

    def _set_gains(self, gains: Gains, t_ns: int) -> Refusal:
        """Put a set of gains in force, in any mode, bumpless."""
        if not all(math.isfinite(gain) and gain >= 0.0 for gain in gains.in_order):
            return Refusal.OUT_OF_RANGE
        self._law.change_gains(gains)
        self.gains_ordered = True
        self._logbook.event(t_ns, Kind.GAINS, text=gains.text)
        return Refusal.NONE

    def correct(
        self, correction: Correction, t_ns: int, *, held_s: float = math.nan, history: CellHistory | None = None
    ) -> None:
        """Put zero, scale and creep of the cell in force; for ``held_s`` and ``history`` see `CellCorrection.put`."""
        cell = self._observer.inbox.cell_correction
        creep, creeps = cell.correction.creep, cell.creeps
        self._observer.correct(correction, held_s=held_s, history=history)
        self._logbook.event(t_ns, Kind.CORRECTION, value=correction.zero_n, limit=correction.scale)
        if correction.second_zero_n is not None:
            zero_n, scale = correction.second_zero_n, correction.second_scale
            self._logbook.event(t_ns, Kind.SECOND_FORCE, value=zero_n, limit=scale)
        if correction.creep != creep and (creeps or cell.creeps):
            text = creep_text(correction.creep).encode()
            known = history is not None or not math.isnan(held_s)
            self._logbook.event(t_ns, Kind.CREEP, int(known), value=creep_share(correction.creep), text=text)
