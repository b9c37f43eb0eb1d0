"""Machine, safety table and limits together, under any sequence of commands, signals, trips and time."""

from __future__ import annotations

from operator import attrgetter
from typing import Any

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from rigctl.config import rig_file as config
from rigctl.config.io_section import IoSettings
from rigctl.config.limits_section import LimitSettings
from rigctl.control.commands.situation import Situation
from rigctl.control.findings import DriveStatusSeen
from rigctl.control.power.stage import ARM_LIMIT_NS
from rigctl.control.snapshot import Snapshot
from rigctl.control.watch import limits
from rigctl.control.watch.safety import Trip
from rigctl.devices.drive import Power
from rigctl.model.faults import Fault
from rigctl.model.reactions import Action
from rigctl.model.states import Event, Mode
from rigctl.model.verbs import Refusal, Verb
from tests.builders.outcomes import MachineLog, WatchLog
from tests.builders.paths import ROOT
from tests.builders.snapshots import changed, put

MS = 1_000_000
ARMED: list[Any] = ["HOLD", "TENSIONING", "COMPENSATING", "RELEASING"]
LIMITS = [
    LimitSettings(signal="drive_temperature_c", high=85.0, persistence_ms=20, action="ramp_down", modes=ARMED),
    LimitSettings(signal="drive_current_a", high=9.0, persistence_ms=5, action="quick_stop", modes=ARMED),
    LimitSettings(signal="lateness_us", high=500.0, persistence_ms=2, action="log", modes=ARMED),
]
SETTINGS = config.load(ROOT / "config/paper_rig.yaml").model_copy(
    update={"limits": LIMITS, "io": IoSettings(e_stop_input=0)}
)
GOOD = Snapshot(
    tension_n=300.0, cell_age_ns=MS, cell_heard=True, inclination_age_ns=9 * MS, stroke_mm=50.0,
    drive_age_ns=MS, drive_heard=True, bus_age_ns=MS,
    drive_status=DriveStatusSeen(age_ns=MS, temperature_c=40.0, current_a=1.0), io_age_ns=MS,
)  # fmt: skip
BAD: dict[str, object] = {
    "cell_age_ns": 16 * MS, "inclination_age_ns": 101 * MS, "drive_age_ns": 16 * MS, "bus_age_ns": 16 * MS,
    "cell_quality": 1, "tension_n": 401.0, "e_stop": True, "plausibility.cell_repeats": 20,
    "plausibility.stroke_error_mm": 1.0,
    "io_age_ns": 101 * MS,
    "drive_status.temperature_c": 90.0, "drive_status.current_a": 10.0, "lateness_ns": 600_000, "stroke_limited": True,
    "plausibility.unexplained_mm": 11.0, "rejects": 20, "skipped_in_window": 50, "device_restarted": True,
    "drive_emergency": True,
}  # fmt: skip
MOVING = (Mode.TENSIONING, Mode.COMPENSATING, Mode.RELEASING)


class Rig(RuleBasedStateMachine):
    """Their interaction in the loop, tick by tick, with a drive that obeys until a rule makes it drop out."""

    def __init__(self) -> None:
        super().__init__()
        self.machine = MachineLog()
        self.rows = limits.rows(SETTINGS)
        self.watch = WatchLog(SETTINGS, self.rows)
        self.snapshot = changed(GOOD, {})
        self.t_ns = 0
        self.since: dict[tuple[Fault, str], int] = {}  # time at which each signal that is bad now became bad
        self.enabled = self.faulted = False
        self.slack = True
        self.asked = 0
        self.on_allowed = False  # an ARM was accepted since the drive last lost its power
        self.before = (Mode.DISARMED, Fault.NONE, Action.HOLD)
        self.reset_given = False

    @initialize()
    def begin(self) -> None:
        assert self.power() is Power.OFF

    # -- events -------------------------------------------------------------------------------------------------
    @rule(verb=st.sampled_from(Verb), value=st.floats(0.0, 400.0))
    def command(self, verb: Verb, value: float) -> None:
        self.give(verb, value)

    @rule()
    def arm(self) -> None:
        self.give(Verb.ARM, 0.0)
        self.follow(True)

    @rule(to=st.sampled_from([Mode.TENSIONING, Mode.COMPENSATING, Mode.RELEASING]))
    @precondition(lambda self: self.machine.mode is Mode.HOLD and self.enabled)
    def go_on(self, to: Mode) -> None:
        self.slack = False
        self.give(Verb.TENSION, 300.0)
        if to is not Mode.TENSIONING:
            self.machine.on(Event.TENSIONED)
        if to is Mode.RELEASING:
            self.give(Verb.RELEASE, 0.0)

    @rule(enabled=st.booleans())
    def follow(self, enabled: bool) -> None:
        """The drive obeys, or drops out."""
        self.enabled = enabled and self.power() is Power.ON
        self.drive_is_followed()

    @rule(off=st.booleans(), verb=st.sampled_from([Verb.DISARM, Verb.HOLD, Verb.RESET]))
    @precondition(lambda self: self.machine.mode is Mode.FAULT)
    def disarms_and_goes_on(self, off: bool, verb: Verb) -> None:
        """A command follows a DISARM whose drive is not off yet."""
        self.give(Verb.DISARM, 0.0)
        self.machine.follow_off(self.t_ns, off=False)
        self.give(verb, 0.0)
        self.machine.follow_off(self.t_ns, off=off)

    @rule(faulted=st.booleans())
    def drive_faults(self, faulted: bool) -> None:
        self.faulted = faulted
        self.enabled = self.enabled and not faulted

    @rule(slack=st.booleans())
    def rope(self, slack: bool) -> None:
        self.slack = slack

    @rule(event=st.sampled_from([Event.TENSIONED, Event.SLACK]))
    @precondition(lambda self: self.machine.mode in MOVING)
    def arrive(self, event: Event) -> None:
        self.machine.on(event)

    @rule(name=st.sampled_from(sorted(BAD)))
    def goes_bad(self, name: str) -> None:
        put(self.snapshot, {name: BAD[name]})

    @rule(name=st.sampled_from(sorted(BAD)))
    def is_good_again(self, name: str) -> None:
        put(self.snapshot, {name: attrgetter(name)(GOOD)})

    @rule()
    @precondition(lambda self: self.machine.fault is not Fault.NONE)
    def all_is_well_and_reset(self) -> None:
        self.snapshot = changed(GOOD, {})
        self.faulted = False
        self.drive_is_followed()
        if self.machine.fault is Fault.NONE:  # a RESET has waited for the drive
            return
        self.give(Verb.RESET, 0.0)
        machine = self.machine
        silent = machine.sequence.action is Action.SILENCE  # its fault is shown until the loop has ended
        kept = machine.sequence.ends or silent or machine.mode is not Mode.FAULT or machine.sequence.carry_until_ns
        assert machine.fault is Fault.NONE or kept

    @rule(action=st.sampled_from(list(Action)[1:]))
    def trips(self, action: Action) -> None:
        self.trip(Trip(Fault.LIMIT, 1.0, 0.0, action))

    @rule()
    @precondition(lambda self: self.machine.mode in (Mode.HOLD, Mode.FAULT))
    def parks(self) -> None:
        self.machine.park()
        assert self.power() is not Power.ON or self.machine.sequence.taking

    @rule(ticks=st.integers(1, 250))
    def time_passes(self, ticks: int) -> None:
        """Let ticks pass with a constant signal: a row acts at its persistence, to the tick."""
        for _ in range(ticks):
            self.tick()

    @rule()
    @precondition(lambda self: self.asked > 15)
    def stop(self) -> None:
        self.machine.stop()
        assert not (self.machine.sequence.pending is Verb.ARM or self.machine.sequence.disarming)
        assert self.machine.sequence.trial is None

    # -- helpers ----------------------------------------------------------------------------------------------
    def power(self) -> Power:
        return self.machine.power(self.t_ns, drive_enabled=self.enabled, drive_faulted=self.faulted)

    def give(self, verb: Verb, value: float) -> None:
        self.asked += 1
        machine, before, answers = self.machine, self.machine.mode, len(self.machine.answers)
        present = self.watch.present(self.snapshot)
        failing = bool(self.watch.beyond(self.snapshot, Mode.HOLD)) or self.faulted
        situation = Situation(
            failed_checks=int(failing), causes=int(present is not Fault.NONE),
            fault=machine.fault, armed=machine.sequence.armed,
            drive_faulted=self.faulted, slack=self.slack, unloaded=self.slack, wanted_n=value,
            measured_mm=value, carry_s=value, carried_s=float(machine.sequence.carry_until_ns > 0),
            needs_tight=bool(value), target_min_n=50.0, target_max_n=350.0,
        )  # fmt: skip
        machine.command(self.asked, verb, situation, self.t_ns)
        ours = [answer for answer in machine.answers[answers:] if answer.id == self.asked]
        if machine.sequence.pending is verb and not ours and not machine.sequence.resetting:
            assert verb is not Verb.ARM or (before is Mode.DISARMED and not failing)
            assert before is not Mode.DISARMED or verb is Verb.ARM
            self.on_allowed = True
            machine.prepared(self.t_ns)
        accepted = bool(ours) and ours[0].refusal is Refusal.NONE
        if verb is Verb.RESET and accepted:
            assert present is Fault.NONE
            self.reset_given = True
        if verb is Verb.TARGET and accepted:
            assert 50.0 <= value <= 350.0

    def trip(self, trip: Trip) -> None:
        """The strongest trip stands: a weaker one's action changes nothing afterwards."""
        machine = self.machine
        mode, fault, action, powered = machine.mode, machine.fault, machine.sequence.action, machine.sequence.motor
        changed = machine.trip(trip, self.t_ns, slack=self.slack)
        assert machine.fault is not Fault.NONE
        assert fault in (Fault.NONE, machine.fault)
        if fault is not Fault.NONE:
            assert machine.sequence.action >= action
        ramps = trip.action is Action.RAMP_DOWN and not self.slack and mode in (Mode.HOLD, *MOVING) and powered
        if changed:
            assert machine.mode is (Mode.RELEASING if ramps else Mode.FAULT)
            assert machine.sequence.pending is not Verb.ARM
            assert machine.sequence.trial is None
        if trip.action >= Action.QUICK_STOP:
            self.on_allowed = False
            assert self.power() is not Power.ON

    def tick(self) -> None:
        self.t_ns += MS
        self.snapshot.t_ns = self.t_ns
        self.snapshot.drive_enabled, self.snapshot.drive_faulted = self.enabled, self.faulted
        self.snapshot.drive_wanted = self.machine.sequence.motor
        self.snapshot.drive_off = not self.enabled
        mode = self.machine.mode
        found = self.watch.trips(self.snapshot, mode, self.t_ns)
        self.assert_persistence(mode, found)
        if found is not None:
            assert found.action is not Action.LOG
            self.trip(found)
        self.drive_is_followed()

    def drive_is_followed(self) -> None:
        machine, resetting = self.machine, self.machine.sequence.resetting
        cause = self.watch.present(self.snapshot) is not Fault.NONE
        if machine.follow_drive(self.enabled, self.t_ns, drive_faulted=self.faulted, cause_present=cause):
            assert resetting
            assert (machine.mode, machine.fault) == (Mode.FAULT, Fault.DRIVE_FAULT)
            self.reset_given = True
        if resetting and machine.mode is not Mode.FAULT:
            assert not cause
            self.reset_given = True

    def assert_persistence(self, mode: Mode, found: Trip | None) -> None:
        """The test's own clock of the rig file's rows: none trips before its time, the strongest not after it."""
        for row in self.rows:
            bad = mode in row.modes and row.value(self.snapshot) > row.limit
            name = row.fault, row.text
            since = self.since.setdefault(name, self.t_ns) if bad else self.since.pop(name, None)
            due = bad and since is not None and self.t_ns - since >= row.persistence_ns
            if row.action is Action.LOG:  # a row of the same fault may act in another mode
                continue
            if found is not None and (found.fault, found.text) == name:
                assert due
            if due:
                assert found is not None
                assert found.action >= row.action

    # -- invariants ---------------------------------------------------------------------------------------------
    @invariant()
    def a_fault_stays_latched_until_a_reset(self) -> None:
        mode, fault, action = self.before
        machine = self.machine
        if fault is not Fault.NONE and not self.reset_given:
            assert machine.fault is fault, "the first names it"
            eased = machine.sequence.taking or machine.sequence.carry_until_ns  # by CARRY or LOWER
            assert eased or machine.sequence.action >= action
            assert mode is not Mode.FAULT or machine.mode is (Mode.RELEASING if eased else Mode.FAULT) or eased
        self.before, self.reset_given = (machine.mode, machine.fault, machine.sequence.action), False

    @invariant()
    def what_is_latched_holds_or_ramps_down(self) -> None:
        machine = self.machine
        latched = machine.fault is not Fault.NONE
        assert latched == (machine.mode is Mode.FAULT or (machine.mode is Mode.RELEASING and latched))
        if latched and machine.mode is Mode.RELEASING:
            assert machine.sequence.action is Action.RAMP_DOWN

    @invariant()
    def only_arming_powers_the_drive(self) -> None:
        machine, power = self.machine, self.power()
        if machine.mode is Mode.DISARMED:
            assert not machine.sequence.motor
            assert power is not Power.ON or machine.sequence.pending is Verb.ARM
        if power is Power.ON:
            assert self.on_allowed
            assert machine.sequence.taking or self.enabled, "a drive that dropped out stays out"
        if machine.mode is Mode.FAULT and machine.sequence.action >= Action.QUICK_STOP:
            assert power in (Power.QUICK_STOP, Power.CUT, Power.RESET, Power.RESET_LOW)
        if power is Power.CUT:
            assert machine.sequence.action is Action.POWER_OFF
        if power in (Power.RESET, Power.RESET_LOW):
            assert self.faulted and (
                machine.sequence.resetting or (machine.sequence.taking and machine.sequence.carries)
            )

    @invariant()
    def every_change_of_mode_is_told(self) -> None:
        mode = Mode.DISARMED
        for change in self.machine.changes:
            assert change.before is mode is not change.after
            mode = change.after
        assert mode is self.machine.mode

    def teardown(self) -> None:
        """Every command has exactly one reply."""
        self.machine.end_trial(Refusal.ABORTED)
        self.machine.follow_drive(False, self.t_ns + 2 * ARM_LIMIT_NS)
        self.machine.follow_off(self.t_ns, off=True)
        assert not (self.machine.sequence.disarming or self.machine.sequence.pending)
        assert sorted(answer.id for answer in self.machine.answers) == list(range(1, self.asked + 1))


TestRig = Rig.TestCase
TestRig.settings = settings(max_examples=60, stateful_step_count=40, deadline=None)
