"""Rows of the catalogue: rope, spring, payload, and the controller."""

from __future__ import annotations

from functools import partial

from hil.faults import in_controller, in_plant
from hil.faults.expected import ARMED, DRIVE_MS, DRIVE_STOPS, HOLD, LOST, PASSING, RIDE, Around, InjectedFault, Reaction
from rigctl.model.parts import Part
from rigctl.model.states import Mode
from rigctl.model.verbs import Verb

_load_lost = partial(InjectedFault, band_n=350, carried=False)
"""The load is off the rope."""
_stroke_end = partial(InjectedFault, part=(Part.ROPE,), band_n=60.0, latency_ms=220)
"""200 ms at an end of the stroke, and a tick or two."""

PLANT = (
    InjectedFault("backlash_doubled", "the nut has twice its play", in_plant.backlash(2.0), RIDE, band_n=3),
    InjectedFault(
        "spring_stiffens", "coils of the spring no longer work: 30 % stiffer", in_plant.spring_stiffens(1.3), RIDE
    ),
    _stroke_end(
        "stroke_end_high",
        "the payload goes up further than the stroke",
        in_plant.nothing(),
        {Mode.COMPENSATING: Reaction.HELD},
        seconds=2.5,
        part=(Part.PAYLOAD,),
        around=Around((("simulation.rope.slack_mm", 67.0),), in_plant.rising(8.0, 5.0)),
        why="200 ms at the end are no sensor's fault",
    ),
    _stroke_end(
        "stroke_end_tensioning",
        "the rope is longer than the stroke",
        in_plant.nothing(),
        {Mode.TENSIONING: Reaction.HELD},
        seconds=2.0,
        around=Around((("simulation.rope.slack_mm", 78.0),), preload_n=200.0),
    ),
    _stroke_end(
        "stroke_end_low",
        "the stroke ends before the rope is slack",
        in_plant.nothing(),
        {Mode.RELEASING: Reaction.HELD},
        seconds=3.0,
        around=Around((("cylinder.stroke_min_mm", 40.0),)),
    ),
    _load_lost("rope_breaks", "the rope breaks", in_plant.rope_breaks(), LOST, within_ms=60),
    InjectedFault("rope_slips_a_little", "the rope slips by 1 mm in its clamp", in_plant.rope_slips(50.0, 1.0), RIDE),
    _load_lost(
        "rope_slips_away",
        "the rope slips through its clamp at 30 mm/s",
        in_plant.rope_slips(30.0, 200.0),
        LOST,
        seconds=3.0,
    ),
    _load_lost(
        "spring_breaks", "the spring breaks, its chain hangs 20 mm longer", in_plant.spring_breaks(), LOST, within_ms=60
    ),
    InjectedFault(
        "payload_bumped", "a bump lifts the payload by 1 mm within 0.1 s", in_plant.payload_jolts(1.0, 0.1), RIDE
    ),
    InjectedFault(
        "payload_caught",
        "the payload is caught and pulled down at 30 mm/s",
        in_plant.payload_moves(-40.0, 30.0),
        {**HOLD, Mode.DISARMED: Reaction.LATCHED, Mode.TENSIONING: Reaction.EITHER},
        band_n=250,
        seconds=1.8,
        why="a ramp that starts low never gets to 400 N",
    ),
    _load_lost(
        "payload_lifted",
        "something lifts the payload off the rope at 40 mm/s",
        in_plant.payload_moves(80.0, 40.0),
        {mode: reaction for mode, reaction in LOST.items() if mode is not Mode.RELEASING},
        seconds=2.5,
        why="a rope that goes slack while it is being released is released",
    ),
)

CONTROLLER = (
    InjectedFault(
        "controller_hangs", "the loop stands still for 300 ms", in_controller.hangs(300), DRIVE_STOPS, band_n=9
    ),
    InjectedFault(
        "overrun_once", "5 ticks are missed at once", in_controller.hangs(5), RIDE, band_n=3, counter="skipped"
    ),
    InjectedFault(
        "overrun_bursts",
        "6 ticks are missed every 50 ms",
        in_controller.overruns(6, 0.05),
        PASSING,
        seconds=1.5,
        why="50 missed within a second is what the rig file allows",
        counter="skipped",
    ),
    InjectedFault(
        "arm_during_run_out",
        "an operator disarms, and arms again 10 ms later",
        in_controller.commanded(Verb.DISARM, Verb.ARM),
        {Mode.HOLD: Reaction.RIDDEN},
        band_n=1,
        part=(Part.E_STOP,),
        why="the drive has its power again after the brake has closed",
    ),
    InjectedFault(
        "reset_during_quick_stop",
        "an operator resets and arms 10 ms after a quick stop has begun",
        in_controller.quick_stop_then(Verb.RESET, Verb.ARM),
        dict.fromkeys(ARMED, Reaction.DRIVE_OFF),
        latency_ms=DRIVE_MS,
        why="refused until the stop has ended",
    ),
)
