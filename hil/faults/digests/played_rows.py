"""What is played for the digests: rows of the catalogue, a course of every command, rig files and parameter sets.

The drawn pairs of faults are in `hil.faults.digests.drawn_runs`.
"""

from __future__ import annotations

import pathlib
from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

from hil.faults import in_device, in_plant, on_bus
from hil.faults.catalogue import ROWS
from hil.faults.drawn.courses import Course, CourseStep, Operator
from hil.faults.expected import Around, InjectedFault, Reaction
from hil.faults.rows.at_several import in_turn
from hil.faults.rows.rows_io import FITTED
from hil.faults.rows.rows_parked import AT_ONCE
from hil.faults.stand import FaultPlace, Injector, Stand, Step
from hil.plant.inputs import Track
from hil.plant.layout import MECHANISM
from hil.scenario import disturbances, kinds
from hil.scenario.layered_rig import with_set
from rigctl.config import rig_file as config
from rigctl.config.settings import LearningSettings, RigSettings
from rigctl.model.states import Mode
from rigctl.model.verbs import Setting, Verb

GATE: tuple[tuple[str, Mode], ...] = (
    ("cell_silent", Mode.COMPENSATING),
    ("take_back_200_creeps", Mode.HOLD),
    ("cell_nan", Mode.RELEASING),
    ("cell_overload", Mode.DISARMED),
    ("slope_invalid", Mode.HOLD),
    ("frames_lost_1pct", Mode.COMPENSATING),
    ("burst_50ms", Mode.TENSIONING),
    ("length_wrong_1pct", Mode.HOLD),
    ("foreign_ids", Mode.COMPENSATING),
    ("bus_off", Mode.COMPENSATING),
    ("io_e_stop", Mode.COMPENSATING),
    ("io_silent", Mode.RELEASING),
    ("io_reboots", Mode.TENSIONING),
    ("foreign_abort_option", Mode.COMPENSATING),
    ("lost_heartbeat_watch", Mode.TENSIONING),
    ("sdo_silent", Mode.DISARMED),
    ("encoder_restarts", Mode.COMPENSATING),
    ("drive_trips", Mode.COMPENSATING),
    ("rope_breaks", Mode.COMPENSATING),
    ("payload_bumped", Mode.COMPENSATING),
    ("power_dip", Mode.HOLD),
    ("controller_hangs", Mode.COMPENSATING),
    ("sync_lost", Mode.COMPENSATING),
    ("rpdo_frozen", Mode.HOLD),
    ("sync_unheard_while_opening", Mode.DISARMED),
    ("drive_frozen_while_enabling", Mode.DISARMED),
    ("sync_twice", Mode.COMPENSATING),
    ("foreign_sync_id", Mode.TENSIONING),
    ("lost_polarity", Mode.COMPENSATING),
    ("rpdo_ignored", Mode.RELEASING),
    ("rpdo_late", Mode.TENSIONING),
    ("controlword_slow_stop", Mode.TENSIONING),
    ("switched_on_persists", Mode.HOLD),
    ("enabling_refused", Mode.HOLD),
    ("drive_boots", Mode.COMPENSATING),
    ("drive_refuses_start_while_opening", Mode.DISARMED),
    ("drive_back_in_error", Mode.TENSIONING),
    ("torque_late", Mode.HOLD),
    ("torque_lost", Mode.FAULT),
    ("drive_runs_blind", Mode.FAULT),
    ("torque_lost_free", Mode.COMPENSATING),
    ("cell_silent_parked", Mode.HOLD),
    ("drive_silent_parked", Mode.FAULT),
    ("second_force_silent_parked", Mode.HOLD),
    ("creep_down_450_parked", Mode.HOLD),
    ("brake_stuck_open_parked", Mode.HOLD),
    ("brake_closes_late", Mode.FAULT),
    ("encoder_stuck_brake_slips_reset_arm", Mode.HOLD),
    ("encoder_stuck_brake_slips_down_100_stiff", Mode.DISARMED),  # judged by its own spring
)
"""Rows of the catalogue, one of each kind, which the gate plays too."""

_BELOW_N, _BEGIN_S = 275.0, 0.3
Command = tuple[Mode, float, Verb | Setting, tuple[float, ...]]
"""Given once the loop has been in the mode for so many seconds, after the commands before it."""


class PlayedCourse(NamedTuple):
    """Commands from power-on, with what happens to the rig meanwhile."""

    id: str
    seconds: float
    commands: tuple[Command, ...]
    preload_n: float = 0.0
    change: tuple[tuple[str, Any], ...] = ()
    happens: tuple[tuple[float, Injector], ...] = ()
    """Each after so many seconds."""

    @property
    def row(self) -> InjectedFault:
        """As a row, so that the catalogue's bench plays it."""
        inject = in_turn((0.0, _operated(self.commands)), *self.happens)
        around = Around(preload_n=self.preload_n, change=self.change)
        return InjectedFault(
            self.id, "", inject, {Mode.DISARMED: Reaction.RIDDEN}, seconds=self.seconds, around=around
        )  # fmt: skip


def _operated(commands: tuple[Command, ...]) -> Injector:
    course = Course("", 0.0, 0.0, tuple(CourseStep(*command) for command in commands))

    def inject(stand: Stand) -> Step:
        operator = Operator(stand.lockstep, course)
        return lambda _: operator.step(stand.lockstep.clock.now())

    return Injector(FaultPlace.CONTROLLER, (), inject)


def _moved_by(motion: Callable[[], Mapping[int, Track]]) -> Injector:
    return Injector(FaultPlace.PLANT, (), lambda stand: stand.plant.start_motion(motion(), stand.plant.t_ns))


def _out_and_back_twice() -> dict[int, Track]:
    move = kinds.OutAndBack(
        kind="out_and_back", angle_deg=3.0, speed_deg_s=2.0, acceleration_deg_s2=4.0, start_s=0.5, dwell_s=1.5,
        repeats=2,
    )  # fmt: skip
    return {MECHANISM: disturbances.rotation(move)}


_NO: tuple[float, ...] = ()
_ARM: Command = (Mode.DISARMED, _BEGIN_S, Verb.ARM, _NO)
_TENSION: Command = (Mode.HOLD, _BEGIN_S, Verb.TENSION, _NO)
COURSES: tuple[PlayedCourse, ...] = (
    PlayedCourse(
        "cycle", 26.0,
        (
            _ARM, _TENSION, (Mode.COMPENSATING, 1.5, Verb.TARGET, (250.0,)), (Mode.COMPENSATING, 3.5, Verb.HOLD, _NO),
            (Mode.HOLD, 4.0, Verb.TENSION, _NO), (Mode.COMPENSATING, 1.0, Verb.RELEASE, _NO),
            (Mode.HOLD, 1.0, Verb.DISARM, _NO), (Mode.DISARMED, 1.0, Verb.CONFIRM_STROKE, (0.0,)),
        ),
        change=(AT_ONCE,),
    ),
    PlayedCourse(
        "brake_slips_carry_lower", 26.0,
        (
            _ARM, (Mode.FAULT, 1.0, Verb.RESET, _NO), (Mode.FAULT, 1.5, Verb.CARRY, (60.0,)),
            (Mode.FAULT, 4.0, Verb.LOWER, _NO), (Mode.FAULT, 4.0, Verb.RESET, _NO), _ARM,
        ),
        300.0, (AT_ONCE,), ((6.0, in_device.brake_slips(0.3)),),
    ),
    PlayedCourse(
        "brake_test", 30.0,
        (
            _ARM, (Mode.HOLD, 1.0, Verb.BRAKE_TEST, _NO), (Mode.HOLD, 14.0, Verb.RELEASE, _NO),
            (Mode.HOLD, 2.0, Verb.RELEASE, (0.5,)),
        ),
        300.0,
    ),
    PlayedCourse(
        "cell_settings", 18.0,
        (
            (Mode.DISARMED, _BEGIN_S, Verb.TARE, _NO), (Mode.DISARMED, 2.0, Setting.ZERO, (0.01,)), _ARM,
            (Mode.HOLD, _BEGIN_S, Setting.CREEP, (1e-4, 60.0, 0.0, 60.0, 10.0)), _TENSION,
            (Mode.COMPENSATING, 1.0, Verb.HOLD, _NO), (Mode.HOLD, 2.5, Verb.CALIBRATE, (300.0,)),
            (Mode.HOLD, 4.5, Setting.SCALE, (1.002, 0.0)), (Mode.HOLD, 4.6, Setting.OVERDUE, (1.0,)),
            (Mode.HOLD, 4.7, Setting.HOST_CHECKS, (0.0,)),
        ),
    ),
    PlayedCourse(
        "identify", 23.0,
        (
            _ARM, _TENSION, (Mode.COMPENSATING, 1.0, Verb.HOLD, _NO), (Mode.HOLD, 1.0, Verb.IDENTIFY, (1.0,)),
            (Mode.HOLD, 12.0, Verb.RESPONSE, (0.0,)), (Mode.HOLD, 16.0, Verb.HOLD, _NO),
        ),
        _BELOW_N,
    ),
    PlayedCourse(
        "response", 66.0, (_ARM, _TENSION, (Mode.COMPENSATING, 1.0, Verb.RESPONSE, (1.0,))), _BELOW_N,
    ),
    PlayedCourse(
        "gains", 8.0,
        (
            _ARM, _TENSION, (Mode.COMPENSATING, 1.0, Verb.GAINS, _NO),
            (Mode.COMPENSATING, 1.2, Setting.LAW_GAINS, (0.4, 0.2, 1.0)),
            (Mode.COMPENSATING, 2.0, Setting.MARGINS, (1.3, 0.05)),
            (Mode.COMPENSATING, 2.2, Setting.DIFFERS, (1.5, 1.3)),
            (Mode.COMPENSATING, 3.0, Verb.TARGET, (9999.0,)),
        ),
        _BELOW_N,
    ),
    PlayedCourse(
        "learned_moves", 18.0,
        (
            _ARM, _TENSION, (Mode.COMPENSATING, 2.0, Verb.MOVE, (1.0,)), (Mode.COMPENSATING, 8.5, Verb.MOVE, (1.0,)),
            (Mode.COMPENSATING, 15.0, Verb.MOVE, (0.0,)),
        ),
        _BELOW_N, (("learning", LearningSettings(move_s=4.5, cutoff_hz=2.0)),),
        ((4.5, _moved_by(_out_and_back_twice)),),
    ),
    PlayedCourse(
        "emergency_stop", 14.0,
        (
            _ARM, _TENSION, (Mode.FAULT, 0.5, Verb.RESET, _NO), (Mode.FAULT, 3.5, Verb.RESET, _NO), _ARM,
            (Mode.HOLD, 1.0, Verb.DISARM, _NO),
        ),
        _BELOW_N, FITTED.change, ((5.0, in_device.io_contact_opens(2.0)),),
    ),
    PlayedCourse(
        "silence_start_anew", 22.0,
        (
            _ARM, _TENSION, (Mode.FAULT, 9.0, Verb.RESET, _NO), (Mode.DISARMED, 3.0, Verb.ARM, _NO),
            (Mode.HOLD, 1.0, Verb.DISARM, _NO),
        ),
        _BELOW_N, (), ((5.0, on_bus.burst(8.0)),),
    ),
)  # fmt: skip
"""Every command, and what follows it."""

WORK = PlayedCourse("work", 20.0, (_ARM, _TENSION), happens=((9.0, _moved_by(in_plant.heaving)),))
"""20 s of a rig file or parameter set: armed, tensioned, heaved."""


class PlayedRow(NamedTuple):
    """One run: on which rig, what, in which mode."""

    rig: str
    """Name of a rig of `rigs`."""
    id: str
    mode: Mode

    @property
    def key(self) -> str:
        """Names the run in the file."""
        return f"{self.rig} {self.id} {self.mode.name}"


BASE = "rig"
"""The rig file of the command."""
_OWN = {course.id: course.row for course in (*COURSES, WORK)}


def row(id_: str) -> InjectedFault:
    """The row of an id: of the catalogue, or a course."""
    return _OWN.get(id_) or ROWS[id_]


def rigs(rig_file: pathlib.Path) -> dict[str, RigSettings]:
    """The rig file, the others of its folder that have a simulation, and each parameter set of it laid over it.

    Raises:
        ConfigError, ScenarioError: one is not valid.
    """
    found = {BASE: config.load(rig_file)}
    for file in sorted(rig_file.parent.glob("*.yaml")):
        if file != rig_file and (settings := config.load(file)).simulation is not None:
            found[file.stem] = settings
    for file in sorted((rig_file.parent / "sets").glob("*.yaml")):
        found[f"set {file.stem}"] = with_set(rig_file, file)
    return found


def default(names: Iterable[str]) -> list[PlayedRow]:
    """The rows that the gate plays, every course, and every rig of these names at work."""
    work = [PlayedRow(name, WORK.id, Mode.DISARMED) for name in names]
    courses = [PlayedRow(BASE, course.id, Mode.DISARMED) for course in COURSES]
    return [*courses, *work, *(PlayedRow(BASE, *one) for one in GATE)]


def every(names: Iterable[str]) -> list[PlayedRow]:
    """The default set, and the catalogue's other rows that play in lockstep, in all their modes."""
    catalogue = (PlayedRow(BASE, fault.id, mode) for fault in ROWS.values() for mode in fault.modes)
    return list(dict.fromkeys((*default(names), *catalogue)))
