"""What the parts of the loop hold that no record shows: tests and studies read it here, and in no other place."""

from __future__ import annotations

from rigctl.control.excitation.loop_probe import LoopProbe
from rigctl.control.excitation.sensor_probe import ProbeFinding
from rigctl.control.excitation.trials import Trial
from rigctl.control.law.estimator import TensionFilter
from rigctl.control.loop import Loop
from rigctl.model.checks import Check
from rigctl.model.reactions import Action
from rigctl.model.verbs import Verb


class LoopView:
    """A loop as its newest tick has left it.

    `hil.lockstep.Lockstep.record` has what records show, and ``loop.machine`` the mode and the latched fault.
    """

    def __init__(self, loop: Loop) -> None:
        self._loop, self._machine, self._seen = loop, loop.machine, loop.observer.snapshot

    # -- commands under way --------------------------------------------------------------------------------------
    @property
    def pending(self) -> Verb | None:
        """The accepted command that waits for the drive."""
        return self._machine.sequence.pending

    @property
    def awaiting(self) -> bool:
        """It waits for read-back, standstill or brake test; the drive is not commanded on yet."""
        return self._machine.sequence.preparing

    @property
    def taking(self) -> bool:
        """The drive is commanded on, so that the motor takes the load from the brake."""
        return self._machine.sequence.taking

    @property
    def trial(self) -> Verb | None:
        """The trial under way."""
        return self._machine.sequence.trial

    @property
    def measurement(self) -> Trial | None:
        """What measures for it."""
        return self._loop._orders.trial

    @property
    def failed_checks(self) -> Check:
        """Checks that bar an ARM now."""
        return self._loop._orders.checks.failed()

    # -- drive, brake and load -----------------------------------------------------------------------------------
    @property
    def action(self) -> Action:
        """Reaction to the latched fault."""
        return self._machine.sequence.action

    @property
    def armed(self) -> bool:
        """By ARM, and neither disarmed nor taken off power since."""
        return self._machine.sequence.armed

    @property
    def drive_wanted(self) -> bool:
        """The motor has the load, so the drive has to be enabled."""
        return self._machine.sequence.motor

    @property
    def carries(self) -> bool:
        """The motor carries or lowers a load that the brake does not hold, or is being switched on to."""
        return self._machine.sequence.carries

    @property
    def carry_until_ns(self) -> int:
        """When the motor begins to lower such a load; 0: it has none."""
        return self._machine.sequence.carry_until_ns

    @property
    def starts_anew(self) -> bool:
        """The loop ends, so that start-up brings all devices up again."""
        return self._machine.sequence.anew

    @property
    def braked(self) -> bool:
        """The drive is seen to be off, its brake closed."""
        return self._seen.power.braked

    @property
    def drive_enabled(self) -> bool:
        """By its own report."""
        return self._seen.drive_enabled

    @property
    def off_ns(self) -> int:
        """Time since it began to report a state without power."""
        return self._seen.power.off_ns

    @property
    def slack(self) -> bool:
        """The rope does not pull."""
        return self._loop.observer.slack

    @property
    def latched_mm(self) -> float:
        """The stroke that is held; NaN: none."""
        return self._loop._load.stroke.reference_mm

    @property
    def shown_loss(self) -> float:
        """The largest of what shows that the held load is lost: mm stretched, N fallen, mm sunk on the brake."""
        held = self._seen.held_tension
        return max(abs(held.stretched_mm), held.fallen_n, self._loop._load.first_second.sank_mm)

    # -- what the safety table looks at --------------------------------------------------------------------------
    @property
    def taken_up_apart_n(self) -> float:
        """Rise of the rope's force by the motor's current, less that by the cell."""
        return self._seen.take_up.rise_n - self._seen.take_up.shown_n

    @property
    def e_stop(self) -> int:
        """Inputs on which the emergency stop reads as pressed, bits of `rigctl.control.snapshot.EStop`."""
        return self._seen.e_stop

    @property
    def master_age_ns(self) -> int:
        """Time since another controller was heard."""
        return self._seen.master_age_ns

    @property
    def lateness_ns(self) -> int:
        """Of the tick."""
        return self._seen.lateness_ns

    @property
    def travel_mm(self) -> float:
        """Of the stroke since COMPENSATING began, less what the set-point has moved."""
        return self._seen.travel_mm

    @property
    def rejects(self) -> int:
        """Samples in a row that the filter has refused."""
        return self._seen.rejects

    @property
    def error_frames(self) -> int:
        """In the last second."""
        return self._seen.error_frames

    @property
    def filter(self) -> TensionFilter:
        """The filter of tension and disturbance."""
        return self._loop.observer.filter

    @property
    def probe_found(self) -> ProbeFinding:
        """Verdict of the probe on cell, encoder, drive and rope."""
        return self._loop._probe.found

    @property
    def probe_share(self) -> float:
        """The sensors' answer to the probe, over the expected one.

        Raises:
            TypeError: the loop has no probe.
        """
        probe = self._loop._probe
        if not isinstance(probe, LoopProbe):
            raise TypeError("the loop has no probe")
        return probe._sensors.share
