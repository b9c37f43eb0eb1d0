"""Rows of the catalogue: the I/O node that mirrors the emergency stop, on a rig that has one."""

from __future__ import annotations

from hil.faults import in_device, on_bus
from hil.faults.expected import DRIVE_MS, HOLD, NO_HEARTBEAT_MS, PRESSED, RIDE, Around, InjectedFault
from rigctl.config.io_section import IoSettings
from rigctl.config.settings import RailEncoderSettings
from rigctl.devices.objects import EmcyCode

FITTED = Around(change=(("io", IoSettings(e_stop_input=0)),))
_SILENT_MS = 120.0
"""100 ms without the I/O node's inputs, and a tick or two."""

RAIL = Around(change=(("rail_encoder", RailEncoderSettings(counts_per_turn=1 << 20, rate_hz=500)),))
RAIL_ENCODER = (
    InjectedFault(
        "rail_silent",
        "the rail encoder's angle stops coming",
        on_bus.silent(on_bus.rail),
        RIDE,
        band_n=3,
        around=RAIL,
        why="only feed-forward hangs on it, and ends with it; the operator is told",
    ),
    InjectedFault(
        "rail_no_heartbeat",
        "the rail encoder sends no heartbeat any more, its angle goes on",
        in_device.no_heartbeat(lambda s: s.rail),
        RIDE,
        band_n=3,
        around=RAIL,
    ),
)

IO = (
    InjectedFault(
        "io_e_stop",
        "the emergency stop's contact opens at the I/O node alone",
        in_device.io_contact_opens(),
        PRESSED,
        latency_ms=DRIVE_MS,
        around=FITTED,
        why="the drive sees nothing of it: it is the loop that has it stop and close its brake",
    ),
    InjectedFault(
        "io_e_stop_bounces",
        "the same contact opens for 10 ms",
        in_device.io_contact_opens(0.01),
        PRESSED,
        latency_ms=DRIVE_MS,
        around=FITTED,
        why="longer than inhibit_ms, so that it is told; pressed is pressed",
    ),
    InjectedFault(
        "io_silent",
        "the I/O node's inputs stop coming",
        on_bus.silent(on_bus.io),
        HOLD,
        within_ms=_SILENT_MS,
        around=FITTED,
    ),
    InjectedFault(
        "io_reboots", "the I/O node starts anew", in_device.reboots(lambda s: s.io), HOLD, within_ms=20, around=FITTED
    ),
    InjectedFault(
        "io_nmt_stopped",
        "another master stops the I/O node",
        on_bus.nmt(0x02, lambda s: s.io.id),
        HOLD,
        within_ms=_SILENT_MS,
        around=FITTED,
    ),
    InjectedFault(
        "io_nmt_preop",
        "another master takes the I/O node to pre-operational",
        on_bus.nmt(0x80, lambda s: s.io.id),
        HOLD,
        within_ms=_SILENT_MS,
        around=FITTED,
    ),
    InjectedFault(
        "io_no_heartbeat",
        "the I/O node sends no heartbeat any more, its inputs go on",
        in_device.no_heartbeat(lambda s: s.io),
        HOLD,
        within_ms=NO_HEARTBEAT_MS,
        around=FITTED,
    ),
    InjectedFault(
        "io_emergency",
        "an emergency message of the I/O node, its inputs go on",
        on_bus.emergency(lambda s: s.io.id, EmcyCode.SENSOR_INVALID),
        HOLD,
        within_ms=10,
        around=FITTED,
    ),
    InjectedFault(
        "io_length_wrong",
        "every frame of the I/O node has a byte too few",
        on_bus.cut(on_bus.io, 1.0),
        HOLD,
        within_ms=_SILENT_MS,
        counter="frames_refused",
        around=FITTED,
    ),
)
