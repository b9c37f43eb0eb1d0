"""Rows of the catalogue: the bus."""

from __future__ import annotations

from functools import partial

from hil.faults import in_plant, on_bus
from hil.faults.expected import EITHER, HOLD, PASSING, RIDE, Around, InjectedFault
from hil.faults.rows.bus_devices import CYLINDER_DRIVE
from rigctl.model.parts import Part

_stops_the_rig = partial(InjectedFault, expected=HOLD, within_ms=20)
"""Seen within a tick or two."""
_harmless = partial(InjectedFault, expected=RIDE, band_n=3)
"""Must not even disturb the tension."""

BUS = (
    _harmless("frames_lost_1pct", "1 % of all frames is lost", on_bus.lost(0.01), seconds=2.0, counter="frames_lost"),
    InjectedFault(
        "frames_lost_10pct",
        "10 % of all frames are lost",
        on_bus.lost(0.1),
        EITHER,
        seconds=3.0,
        counter="frames_lost",
        why="once in 20 s three heartbeats in a row are among them, and the drive stops by itself",
    ),
    _harmless("burst_8ms", "no frame for 8 ms", on_bus.burst(0.008), why="less than the rig calls silence"),
    InjectedFault("burst_50ms", "no frame for 50 ms", on_bus.burst(0.05), PASSING, within_ms=20),
    InjectedFault(
        "bus_stalled",
        "the devices' frames are kept for 60 ms and then come at once",
        on_bus.stalled(0.06),
        PASSING,
        within_ms=20,
        why="a computer that stands still keeps frames, a cable does not",
    ),
    _stops_the_rig("bus_cut", "no frame any more", on_bus.burst(60.0)),
    _harmless("frames_twice", "every frame comes twice", on_bus.twice(), counter="frames_received"),
    _harmless("frames_late_1ms", "the devices' frames come 1 ms late", on_bus.late(1)),
    InjectedFault(
        "frames_late_3ms",
        "the devices' frames come 3 ms late",
        on_bus.late(3),
        RIDE,
        around=Around(motion=in_plant.heaving),
    ),
    InjectedFault(
        "frames_late_20ms",
        "the devices' frames come 20 ms late",
        on_bus.late(20),
        PASSING,
        within_ms=20,
        shown_late_ms=20,
    ),
    _harmless("frames_reordered", "neighbouring frames swap places", on_bus.reordered()),
    _harmless(
        "length_wrong_1pct",
        "1 % of the cell's samples have a byte too few",
        on_bus.cut(on_bus.cell, 0.01),
        part=(Part.BUS,),
        seconds=2.0,
        counter="frames_refused",
    ),
    CYLINDER_DRIVE.length_wrong("every sample of the drive has a byte too few"),
    _stops_the_rig(
        "rival_commands",
        "another controller sends the drive a speed of 5 mm/s",
        on_bus.rival(),
        why="who commands the drive must not be a question",
    ),
    _harmless(
        "foreign_ids", "five frames a millisecond that are nobody's here", on_bus.foreign(5), counter="frames_received"
    ),
    _harmless(
        "babble_quiet", "a node sends all it can, with the lowest priority", on_bus.babble(), counter="frames_received"
    ),
    _stops_the_rig("babble_loud", "a node sends all it can, with the highest priority", on_bus.babble_loud()),
    InjectedFault(
        "impostor",
        "a foreign node sends samples of its own under the cell's identifier",
        on_bus.impostor(),
        PASSING,
        band_n=15,
        within_ms=200,
    ),
    _harmless(
        "error_passive", "the controller reports itself error-passive", on_bus.error_frames(), counter="error_frames"
    ),
    _stops_the_rig("bus_off", "the controller is off the bus: nothing can be sent", on_bus.bus_off()),
    _stops_the_rig("nmt_all_stopped", "another master stops all nodes", on_bus.nmt(on_bus.NMT_STOP)),
    _stops_the_rig("nmt_all_reset", "another master resets all nodes", on_bus.nmt(on_bus.NMT_RESET)),
    CYLINDER_DRIVE.nmt_stopped(),
    CYLINDER_DRIVE.nmt_preop(),
)
