"""Rows of the catalogue: the bus."""

from __future__ import annotations

from hil.faults import in_plant, on_bus
from hil.faults.expected import EITHER, HOLD, PASSING, RIDE, Around, InjectedFault

BUS = (
    InjectedFault(
        "frames_lost_1pct",
        "1 % of all frames is lost",
        on_bus.lost(0.01),
        RIDE,
        seconds=2.0,
        band_n=3,
        counter="frames_lost",
    ),
    InjectedFault(
        "frames_lost_10pct",
        "10 % of all frames are lost",
        on_bus.lost(0.1),
        EITHER,
        seconds=3.0,
        counter="frames_lost",
        why="once in 20 s three heartbeats in a row are among them, and the drive stops by itself",
    ),
    InjectedFault(
        "burst_8ms", "no frame for 8 ms", on_bus.burst(0.008), RIDE, band_n=3, why="less than the rig calls silence"
    ),
    InjectedFault("burst_50ms", "no frame for 50 ms", on_bus.burst(0.05), PASSING, within_ms=20),
    InjectedFault("bus_cut", "no frame any more", on_bus.burst(60.0), HOLD, within_ms=20),
    InjectedFault("frames_twice", "every frame comes twice", on_bus.twice(), RIDE, band_n=3, counter="frames_received"),
    InjectedFault("frames_late_1ms", "the devices' frames come 1 ms late", on_bus.late(1), RIDE, band_n=3),
    InjectedFault(
        "frames_late_3ms",
        "the devices' frames come 3 ms late",
        on_bus.late(3),
        RIDE,
        around=Around(motion=in_plant.heaving),
    ),
    InjectedFault("frames_late_20ms", "the devices' frames come 20 ms late", on_bus.late(20), PASSING, within_ms=20),
    InjectedFault("frames_reordered", "neighbouring frames swap places", on_bus.reordered(), RIDE, band_n=3),
    InjectedFault(
        "length_wrong_1pct",
        "1 % of the cell's samples have a byte too few",
        on_bus.cut(on_bus.cell, 0.01),
        RIDE,
        band_n=3,
        seconds=2.0,
        counter="frames_refused",
    ),
    InjectedFault(
        "drive_length_wrong",
        "every sample of the drive has a byte too few",
        on_bus.cut(on_bus.drive, 1.0),
        HOLD,
        within_ms=20,
        counter="frames_refused",
    ),
    InjectedFault(
        "rival_commands",
        "another controller sends the drive a speed of 5 mm/s",
        on_bus.rival(),
        HOLD,
        within_ms=20,
        why="who commands the drive must not be a question",
    ),
    InjectedFault(
        "foreign_ids",
        "five frames a millisecond that are nobody's here",
        on_bus.foreign(5),
        RIDE,
        band_n=3,
        counter="frames_received",
    ),
    InjectedFault(
        "babble_quiet",
        "a node sends all it can, with the lowest priority",
        on_bus.babble(),
        RIDE,
        band_n=3,
        counter="frames_received",
    ),
    InjectedFault(
        "babble_loud", "a node sends all it can, with the highest priority", on_bus.babble_loud(), HOLD, within_ms=20
    ),
    InjectedFault(
        "impostor",
        "a foreign node sends samples of its own under the cell's identifier",
        on_bus.impostor(),
        PASSING,
        band_n=15,
        within_ms=200,
    ),
    InjectedFault(
        "error_passive",
        "the controller reports itself error-passive",
        on_bus.error_frames(),
        RIDE,
        band_n=3,
        counter="error_frames",
    ),
    InjectedFault(
        "bus_off", "the controller is off the bus: nothing can be sent", on_bus.bus_off(), HOLD, within_ms=20
    ),
    InjectedFault(
        "nmt_all_stopped", "another master stops all nodes", on_bus.nmt(0x02, on_bus.everybody), HOLD, within_ms=20
    ),
    InjectedFault(
        "nmt_all_reset", "another master resets all nodes", on_bus.nmt(0x81, on_bus.everybody), HOLD, within_ms=20
    ),
    InjectedFault(
        "drive_nmt_stopped",
        "another master stops the drive",
        on_bus.nmt(0x02, lambda s: s.drive.id),
        HOLD,
        within_ms=20,
    ),
    InjectedFault(
        "drive_nmt_preop",
        "another master takes the drive to pre-operational",
        on_bus.nmt(0x80, lambda s: s.drive.id),
        HOLD,
        within_ms=20,
    ),
)
