"""Rows of the catalogue: the I/O node that mirrors the emergency stop, on a rig that has one."""

from __future__ import annotations

import math

from hil.faults import in_device, in_plant, on_bus
from hil.faults.expected import ARMED, DRIVE_MS, MOVING, PRESSED, RIDE, Around, InjectedFault, Reaction
from hil.faults.rows.bus_devices import IO_NODE
from rigctl.config.io_section import IoSettings
from rigctl.config.rail_sections import RailEncoderSettings
from rigctl.model.states import Mode

FITTED = IO_NODE.around
WIRED = Around(change=(("io", IoSettings(e_stop_input=0, drive_enable_output=0, drive_off_input=1)),))
"""With the drive's hard-wired enable."""
RAIL = Around(change=(("rail_encoder", RailEncoderSettings(counts_per_turn=1 << 20, rate_hz=500)),))
RAIL_ENCODER = (
    InjectedFault(
        "rail_silent",
        "the rail encoder's angle stops coming",
        on_bus.silent(on_bus.rail),
        RIDE,
        band_n=3,
        around=RAIL,
        why="only feed-forward depends on it, and ends with it; an event says so",
    ),
    InjectedFault(
        "rail_no_heartbeat",
        "the rail encoder sends no heartbeat any more, its angle goes on",
        in_device.no_heartbeat(on_bus.rail),
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
        why="longer than inhibit_ms, so that it is sent; pressed is pressed",
    ),
    IO_NODE.silent("the I/O node's inputs stop coming"),
    IO_NODE.reboots(),
    IO_NODE.nmt_stopped(),
    IO_NODE.nmt_preop(),
    IO_NODE.no_heartbeat(),
    IO_NODE.emergency("an emergency message of the I/O node, its inputs go on"),
    IO_NODE.length_wrong("every frame of the I/O node has a byte too few"),
    InjectedFault(
        "drive_hangs",
        "the drive goes on at its last speed, whatever it is commanded and whatever it misses",
        in_device.hangs(),
        dict.fromkeys(MOVING, Reaction.DRIVE_OFF),
        seconds=2.0,
        band_n=15,
        latency_ms=400,
        around=Around(change=WIRED.change, motion=in_plant.heaving),
        why="neither NMT stop nor silence stops it: the hard-wired enable does",
    ),
    InjectedFault(
        "io_dies",
        "the I/O node loses its power",
        in_device.io_without_power(),
        {**dict.fromkeys(ARMED, Reaction.DRIVE_OFF), Mode.DISARMED: Reaction.REFUSED, Mode.FAULT: Reaction.KEPT},
        around=WIRED,
        why="the drive's enable drops with it",
    ),
    InjectedFault(
        "enable_welded",
        "the relay of the drive's enable does not open any more",
        in_device.enable_welded(),
        {**RIDE, Mode.HOLD: Reaction.DRIVE_OFF},
        seconds=2.0,
        latency_ms=math.inf,
        around=Around(change=(*WIRED.change, ("hold.park_s", 0.5))),
        why="found when it should have opened; the rig does not move again before it is mended",
    ),
)
