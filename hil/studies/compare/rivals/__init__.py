"""The compared laws: their names, tuning rules and constructors."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from hil.studies.compare.rivals.adrc import Adrc
from hil.studies.compare.rivals.disturbance_observer import DisturbanceObserver
from hil.studies.compare.rivals.feedback import Feedback, Model, Newest, Rival
from hil.studies.compare.rivals.lqi import Lqi
from hil.studies.compare.rivals.pid import PidFeedForward
from hil.studies.compare.rivals.proportional import Proportional, ProportionalIntegral
from rigctl.config.settings import RigSettings
from rigctl.control.bus.inbox import Inbox
from rigctl.control.law.tension import Gains, TensionLaw

OURS, PASSIVE = "ours", "passive"


class ComparedLaw(NamedTuple):
    """One column of the table."""

    name: str
    title: str
    rule: str
    """The tuning rule and its author."""
    make: Callable[[RigSettings], Feedback] | None
    """None where there is nothing to make: the cylinder locked, or our own law."""

    def law(self, settings: RigSettings, gains: Gains, inbox: Inbox) -> TensionLaw:
        """The law in the form that `rigctl.control.loop.Loop` takes."""
        if self.make is None:
            return TensionLaw(settings, gains)
        return Rival(settings, gains, Newest(inbox.cell, inbox.drive, inbox.slope), self.make(settings))


def _pid(settings: RigSettings) -> Feedback:
    return PidFeedForward(Model.of(settings), settings.tension.speed_max_mm_s, settings.plant.rope_length_mm)


_LAWS = (
    ComparedLaw(PASSIVE, "passive", "cylinder locked: the spring alone, as in the paper", None),
    ComparedLaw(
        "p", "P", "half the ultimate gain (Ziegler, Nichols 1942)", lambda settings: Proportional(Model.of(settings))
    ),
    ComparedLaw(
        "pi",
        "PI",
        "SIMC for an integrating process, tau_c = theta, half rule (Skogestad 2003)",
        lambda settings: ProportionalIntegral(Model.of(settings)),
    ),
    ComparedLaw(
        "pid_ff",
        "PID+ff",
        "SIMC-PID in series form, tau_D = lag, tau_c = theta (Skogestad 2003), measurement filter tau_D / 3; library "
        "simple-pid; the inclined rope's stretch fed forward",
        _pid,
    ),
    ComparedLaw(
        "lqi",
        "LQI",
        "Bryson's rule (Bryson, Ho 1975): 0.05 mm of stretch for 0.1 s against the speed limit; Kalman filter of "
        "tension and speed, the disturbance white noise to it",
        Lqi,
    ),
    ComparedLaw(
        "pi_dob",
        "PI+DOB",
        "disturbance observer (Ohnishi 1987; Sariyildiz et al. 2020), Q of second order at 1 / (3 delay); SIMC-PI with "
        "a crossover of a fifth of that",
        lambda settings: DisturbanceObserver(Model.of(settings)),
    ),
    ComparedLaw(
        "adrc",
        "ADRC",
        "bandwidth parametrisation (Gao 2003), second order, omega_c = 0.12 / delay, omega_o = 4 omega_c; input of "
        "the observer delayed (Zhao, Gao 2014)",
        lambda settings: Adrc(Model.of(settings)),
    ),
    ComparedLaw(
        OURS,
        "ours",
        "linear-quadratic gains and Kalman filter with disturbance state, weights of the rig file, Ms at most 1.6 over "
        "every plant of the family",
        None,
    ),
)
LAWS = {law.name: law for law in _LAWS}
"""In the table's order: from the simplest on, ours last."""
