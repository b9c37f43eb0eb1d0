"""Rows of the catalogue: the drive's reports and motion."""

from __future__ import annotations

from functools import partial

from hil.faults import in_device, in_plant, on_bus
from hil.faults.expected import (
    DRIVE_MS,
    EITHER,
    HOLD,
    POWER_OFF,
    RIDE,
    WHEN_MOVING,
    Around,
    Expected,
    InjectedFault,
    Reaction,
)
from hil.faults.in_device import SPEED, STATUS, STROKE, both, reads, says, stuck
from hil.faults.rows.bus_devices import CYLINDER_DRIVE
from rigctl.devices import objects
from rigctl.model.states import Mode

STATUS_SILENT_MS = 310.0
"""Five periods of 50 ms, up to one since the last message, and a tick or two."""
_SEEN_AT_REST: Expected = {**HOLD, Mode.DISARMED: Reaction.LATCHED}
"""Feedback that shows a stroke moving on a closed brake."""
_while_heaving = partial(
    InjectedFault, expected=WHEN_MOVING, band_n=15, latency_ms=DRIVE_MS, around=Around(motion=in_plant.heaving)
)
"""Shows only where the cylinder has to move."""
_runs_away = partial(InjectedFault, expected=POWER_OFF, band_n=15, latency_ms=DRIVE_MS)
"""The motor moves by itself."""
_beside_lag = partial(InjectedFault, latency_ms=DRIVE_MS)
"""Must differ from the drive's lag to be seen."""

DRIVE_FEEDBACK = (
    CYLINDER_DRIVE.silent(),
    InjectedFault(
        "status_silent",
        "the drive's current, temperature and inputs stop coming, its position and speed go on",
        on_bus.silent(on_bus.drive, objects.DRIVE_TPDO2.cob_base),
        HOLD,
        within_ms=STATUS_SILENT_MS,
        why="neither the emergency stop's input nor the temperature is seen without them",
    ),
    _while_heaving("stroke_stuck", "its position stands still, its speed does not", stuck(STROKE), seconds=1.5),
    _beside_lag(
        "stroke_jump",
        "its position is 10 mm further from one sample to the next",
        reads(STROKE, plus=10.0),
        HOLD,
        within_ms=120,
    ),
    _beside_lag(
        "stroke_drift",
        "its position creeps by 5 mm/s, its speed says nothing of it",
        reads(STROKE, drift_s=5.0),
        _SEEN_AT_REST,
        seconds=2.0,
    ),
    _beside_lag("stroke_unit", "a tenth of the position's unit", reads(STROKE, times=10.0), HOLD, within_ms=120),
    _while_heaving("speed_stuck", "its speed stands at 0", reads(SPEED, times=0.0)),
    _while_heaving("speed_sign", "its speed has the wrong sign", reads(SPEED, times=-1.0)),
    _beside_lag("speed_noisy", "noise of 5 mm/s rms on its speed", reads(SPEED, noise=5.0), EITHER),
    InjectedFault("status_garbled", "its statusword reads 0", says(STATUS, 0), HOLD, within_ms=40),
)

_BIT_MS = 40.0
"""Reaction to a change of state that takes longer than 20 ms, and a tick or two."""
OWN_STOP = (
    ("heartbeat_watch", "its watch over the controller's heartbeat (0x1016:01)", objects.CONSUMER_HEARTBEAT, 1, 4),
    ("command_deadline", "its deadline of commands (0x1400:05)", objects.RPDO1_COMMUNICATION, 5, 2),
    ("abort_option", "what it does when the connection is lost (0x6007)", objects.ABORT_CONNECTION_OPTION, 0, 2),
    ("quick_stop_option", "how it stops quickly (0x605A)", objects.QUICK_STOP_OPTION, 0, 2),
    ("fault_option", "how it reacts to a fault (0x605E)", objects.FAULT_REACTION_OPTION, 0, 2),
    ("mode_of_operation", "its mode of operation (0x6060)", objects.MODE_OF_OPERATION, 0, 1),
    ("transmission", "when it takes commands over (0x1400:02)", objects.RPDO1_COMMUNICATION, 2, 1),
)
"""The drive's objects that safety depends on: name, in words, index, sub-index, size in bytes."""
ROTATION_MS = 600.0
"""Time in which every object is read once: 46 objects, one in 10 ms, and a reserve for other rigs."""
OWN_ANSWER_MS = 21.0
"""So long an answer may be a repeated one to the loop's own last two requests, 10 ms each."""
SUPERVISION = (
    *(
        InjectedFault(
            f"foreign_{name}",
            f"another master writes 0 to {what} of the drive",
            on_bus.sdo_write(index, sub, size),
            HOLD,
            within_ms=10,
            why="the request is heard; what it wrote is refused at the next arm",
        )
        for name, what, index, sub, size in OWN_STOP
    ),
    InjectedFault(
        "foreign_sdo_read", "another master reads the drive's temperature", on_bus.sdo_read(), HOLD, within_ms=10
    ),
    InjectedFault(
        "foreign_sdo_answers",
        "the drive answers a master that is not heard",
        on_bus.sdo_answers(),
        HOLD,
        within_ms=OWN_ANSWER_MS,
        why="an answer about the object that the loop itself is reading is not told from its own",
    ),
    *(
        InjectedFault(
            f"lost_{name}",
            f"{what} of the drive reads 0: its own service connection wrote it",
            in_device.setting_lost(index, sub),
            HOLD,
            within_ms=ROTATION_MS,
            seconds=1.5,
        )
        for name, what, index, sub, _ in OWN_STOP
    ),
    InjectedFault(
        "lost_quick_stop_ramp",
        "its quick stop ramp (0x6085) reads 1 mm/s2: its own service connection wrote it",
        in_device.setting_lost(objects.QUICK_STOP_DECELERATION, 0, 1_000),
        HOLD,
        within_ms=ROTATION_MS,
        seconds=1.5,
        why="it is stopped by commands: a quick stop would take place on that ramp",
    ),
    InjectedFault(
        "sdo_silent",
        "the drive's SDO server does not answer any more",
        on_bus.silent(on_bus.drive, objects.SDO_TX_BASE),
        HOLD,
        within_ms=1_500,
        seconds=2.5,
        why="what it would do without us is not known any more",
    ),
    InjectedFault(
        "encoder_restarts",
        "its encoder counts from a new zero",
        in_device.encoder_restarts(),
        HOLD,
        within_ms=10,
        why="where the stroke's ends are is not known any more: an operator has to confirm it",
    ),
)

OVERCURRENT, OVERHEATED = 0x2310, 0x4310
DRIVE = (
    InjectedFault(
        "drive_trips",
        "the drive finds an overcurrent: it stops, its brake closes",
        in_device.trips(OVERCURRENT),
        HOLD,
        within_ms=10,
    ),
    CYLINDER_DRIVE.emergency("the drive reports that it is too hot, and goes on", code=OVERHEATED),
    CYLINDER_DRIVE.emergency_vendor("and it goes on"),
    CYLINDER_DRIVE.emergency_none(),
    CYLINDER_DRIVE.emergency(
        "an emergency message says that one error is over, its register that others are active (0x0000, register 0x09)",
        "emergency_remains",
        0,
        0x09,
    ),
    CYLINDER_DRIVE.reboots(),
    _beside_lag(
        "drive_tool",
        "a service tool at the drive has it enabled and winds up at 5 mm/s; quick stop and disable voltage still work",
        in_device.tool_takes_over(5.0),
        {**POWER_OFF, Mode.DISARMED: Reaction.REFUSED},
        band_n=15,
        why="while DISARMED every command takes the power off, which it obeys; who commands the drive bars arming",
    ),
    _beside_lag(
        "drive_tool_unsaid",
        "the same, and the drive's statusword says nothing of the tool",
        in_device.tool_takes_over(5.0, shows_remote=True),
        {**POWER_OFF, Mode.DISARMED: Reaction.RIDDEN},
        band_n=15,
    ),
    _beside_lag(
        "drive_tool_at_rest",
        "a service tool has the drive enabled and does not move it; quick stop and disable voltage still work",
        in_device.tool_takes_over(0.0),
        HOLD,
    ),
    _beside_lag(
        "drive_tool_deaf",
        "a service tool moves the drive by 1 mm/s, and no command on the bus stops it",
        in_device.tool_takes_over(1.0, deaf=True),
        {Mode.DISARMED: Reaction.LATCHED},
        why="what does not obey its command is stopped by NMT, then left to its own supervision",
    ),
    _beside_lag(
        "drive_remote_lost",
        "its statusword says that it takes no commands from the bus (bit 9 off)",
        in_device.status_bit(objects.STATUS_REMOTE, on=False),
        HOLD,
        within_ms=_BIT_MS,
    ),
    _beside_lag(
        "drive_internal_limit",
        "its statusword says that a limit of its own is active (bit 11)",
        in_device.status_bit(objects.STATUS_INTERNAL_LIMIT, on=True),
        HOLD,
        within_ms=DRIVE_MS,
    ),
    _beside_lag(
        "drive_not_following",
        "its statusword says that it does not follow the target velocity (bit 12 off)",
        in_device.status_bit(objects.STATUS_FOLLOWS, on=False),
        {**POWER_OFF, Mode.DISARMED: Reaction.RIDDEN},
        why="the bit means something only while the drive is enabled",
    ),
    CYLINDER_DRIVE.no_heartbeat(),
    _while_heaving("drive_ignores", "the motor stands still whatever is commanded", in_device.ignores_commands()),
    _runs_away("drive_runs_up", "the motor winds up at 10 mm/s by itself", in_device.runs_away(10.0)),
    _runs_away("drive_runs_down", "the motor pays out at 10 mm/s by itself", in_device.runs_away(-10.0)),
    _runs_away("drive_runs_slowly", "the motor pays out at 1 mm/s by itself", in_device.runs_away(-1.0), seconds=4.0),
    _runs_away(
        "drive_runs_blind",
        "the motor pays out at 5 mm/s, its encoder says it stands still",
        both(in_device.runs_away(-5.0), stuck(STROKE), reads(SPEED, times=0.0)),
        seconds=2.0,
        why="tension changes, and no stroke is seen",
    ),
    InjectedFault(
        "drive_lies_off",
        "once it is commanded off, the drive reports that it is off, and its motor keeps its power",
        in_device.lies_off(),
        {Mode.HOLD: Reaction.DRIVE_OFF},
        within_ms=3_500,
        latency_ms=1_100,
        seconds=5.0,
        why="half a second after the parking the motor's current shows it",
    ),
    _while_heaving("brake_stuck_closed", "the brake has closed by itself", in_device.brake_stays_closed()),
    InjectedFault(
        "brake_stuck_open",
        "the brake does not hold: a motor without power gives way by 0.5 mm/s",
        in_device.brake_stays_open(),
        {**RIDE, Mode.DISARMED: Reaction.MOVES, Mode.HOLD: Reaction.HELD},
        latency_ms=220,
        seconds=3.0,
        why="after a parking the motor takes the load back; later nothing may switch it on by itself",
    ),
    InjectedFault(
        "brake_weak",
        "the closed brake gives way by 0.06 mm/s: less than any limit sees",
        in_device.brake_slips(0.06),
        {Mode.DISARMED: Reaction.REFUSED},
        around=Around(change=(("cylinder.brake_test", True),)),
        why="the brake test of the arming finds it",
    ),
    InjectedFault(
        "power_dip", "all devices are without power for 100 ms", in_device.power_dip(0.1), HOLD, within_ms=20
    ),
)
