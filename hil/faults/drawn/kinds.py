"""What may be drawn: every kind of fault with the range of its size, by the part that has it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass

from hil.faults import in_controller, in_device, in_plant, on_bus
from hil.faults.in_device import CELL, SPEED, STROKE, both, reads, stuck
from hil.faults.stand import FaultPlace, Injector, Stand
from rigctl.devices import objects
from rigctl.model.device_states import DriveState
from rigctl.model.parts import Part

CELL_NOISE_N = 0.03
ROPE_MM = 40.0
"""Rope that slips out of its clamp at most."""
TICK_S = 0.001


@dataclass(frozen=True)
class DrawnKind:
    """A kind of fault; its size is drawn evenly in the logarithm, with either sign where ``signed``."""

    name: str
    part: str
    what: str
    """In words, with the size as ``{}``."""
    inject: Callable[[float], Injector]
    low: float = 1.0
    high: float = 1.0
    _: KW_ONLY
    signed: bool = False
    delays_s: float = 0.0
    """Age that it adds to what is received, by its size."""
    also: tuple[Part, ...] = ()
    """Parts that may be named for it beside those of its injector."""

    @property
    def states(self) -> tuple[Part, ...]:
        """The parts, any of which may be named for it."""
        return (*self.inject(self.low).part, *self.also)

    def shown_late_s(self, size: float) -> float:
        """Age in s that it adds to the statusword shown."""
        return size * self.delays_s


def _encoder_stuck(_: float) -> Injector:
    return both(stuck(STROKE), reads(SPEED, times=0.0))


def _drive_gain(share: float) -> Injector:
    def inject(stand: Stand) -> None:
        stand.drive.defect = lambda speed, braked: (speed * (1.0 + share), braked)

    return Injector(FaultPlace.DEVICE, (Part.DRIVE,), inject)


KINDS = (
    DrawnKind("cell_frozen", "cell", "the cell's noise goes on about the value it has, {:+.2g} N off",
         lambda n: reads(CELL, freezes=True, noise=CELL_NOISE_N, plus=n), 0.02, 3.0, signed=True),
    DrawnKind("cell_drifts", "cell", "the cell drifts by {:+.2g} N/s",
         lambda n_s: reads(CELL, drift_s=n_s), 0.02, 20.0, signed=True),
    DrawnKind("cell_gain", "cell", "the cell's gain changes by {:+.2g}",
         lambda share: reads(CELL, times=1.0 + share), 0.01, 0.1, signed=True),
    DrawnKind("cell_jumps", "cell", "the cell reads {:+.2g} N more", lambda n: reads(CELL, plus=n), 1.0, 100.0,
         signed=True),
    DrawnKind("cell_noisy", "cell", "the cell has {:.2g} N rms more noise", lambda n: reads(CELL, noise=n), 0.1, 30.0),
    DrawnKind("cell_stuck", "cell", "the cell repeats its last sample", lambda _: stuck(CELL)),
    DrawnKind("cell_silent", "cell", "the cell's samples stop", lambda _: on_bus.silent(on_bus.cell)),
    DrawnKind("encoder_stuck", "encoder", "position and speed stay as they are at rest", _encoder_stuck),
    DrawnKind("encoder_drifts", "encoder", "position and speed show {:+.2g} mm/s more than there is",
         lambda v: both(reads(STROKE, drift_s=v), reads(SPEED, plus=v)), 0.01, 5.0, signed=True),
    DrawnKind("position_drifts", "encoder", "the position drifts by {:+.2g} mm/s",
         lambda v: reads(STROKE, drift_s=v), 0.01, 5.0, signed=True),
    DrawnKind("encoder_gain", "encoder", "position and speed are {:+.2g} of their value too large",
         lambda share: both(reads(STROKE, times=1.0 + share), reads(SPEED, times=1.0 + share)), 0.01, 0.1, signed=True),
    DrawnKind("speed_stuck", "encoder", "the speed reads 0", lambda _: reads(SPEED, times=0.0)),
    DrawnKind("drive_creeps", "drive", "the motor turns {:+.2g} mm/s faster than commanded",
         in_device.creeps, 0.01, 10.0, signed=True),
    DrawnKind("drive_gain", "drive", "the motor turns by {:+.2g} of the command faster",
         _drive_gain, 0.01, 0.2, signed=True),
    DrawnKind("drive_ignores", "drive", "the motor stays at rest", lambda _: in_device.ignores_commands()),
    DrawnKind("drive_runs", "drive", "the motor turns at {:+.2g} mm/s by itself",
         in_device.runs_away, 0.3, 10.0, signed=True),
    DrawnKind("rpdo_ignored", "drive", "the drive does not act on its RPDO", lambda _: in_device.rpdo_ignored()),
    DrawnKind("rpdo_frozen", "drive", "the drive takes every RPDO for the first one",
         lambda _: in_device.rpdo_frozen()),
    DrawnKind("rpdo_late", "drive", "the drive acts on its RPDO {:.0f} ticks late",
         lambda ticks: in_device.rpdo_late(max(1, round(ticks))), 1.0, 100.0),
    DrawnKind("drive_trips", "drive", "the drive trips", lambda _: in_device.trips(0x2310)),
    DrawnKind("e_stop", "drive", "the emergency stop is pressed for {:.2g} s", in_device.e_stop, 0.05, 20.0),
    DrawnKind("drive_lies_off", "drive", "once it is commanded off, the drive reports so and keeps its power",
         lambda _: in_device.lies_off()),
    DrawnKind("drive_reports_off", "drive", "the drive reports SWITCH ON DISABLED, and goes on as it is commanded",
         lambda _: in_device.state_reported(DriveState.SWITCH_ON_DISABLED)),
    DrawnKind("sync_lost", "bus", "no device receives SYNC", lambda _: on_bus.sync_lost()),
    DrawnKind("sync_unheard", "bus", "the drive takes no frame for SYNC",
         lambda _: in_device.sync_unheard(on_bus.drive)),
    DrawnKind("sync_twice", "bus", "every SYNC arrives twice", lambda _: on_bus.sync_twice()),
    DrawnKind("frames_lost", "bus", "{:.2g} of all frames are lost", on_bus.lost, 0.001, 0.3),
    DrawnKind("frames_gone", "bus", "all frames are lost for {:.2g} s", on_bus.burst, 0.005, 0.5),
    DrawnKind("frames_late", "bus", "the devices' frames are {:.0f} ticks late",
         lambda ticks: on_bus.late(max(1, round(ticks))), 1.0, 30.0, delays_s=TICK_S),
    DrawnKind("drive_samples_frozen", "bus", "the drive's samples go on with frozen content",
         lambda _: on_bus.frozen(on_bus.drive)),
    DrawnKind("drive_silent", "bus", "the drive's samples stop", lambda _: on_bus.silent(on_bus.drive),
         also=(Part.BUS,)),
    DrawnKind("watch_lost", "bus", "the drive's watch over the heartbeat is switched off unseen",
         lambda _: in_device.setting_lost(objects.CONSUMER_HEARTBEAT, 1)),
    DrawnKind("brake_slips", "brake", "the closed brake gives way by {:.2g} mm/s", in_device.brake_slips, 0.02, 2.0),
    DrawnKind("brake_late", "brake", "the brake closes {:.0f} ms late",
         lambda ms: in_device.brake_closes_late(round(ms)), 10.0, 1000.0),
    DrawnKind("brake_drags", "brake", "the brake opens partly, with {:.2g} N of friction",
         in_device.brake_drags, 20.0, 400.0),
    DrawnKind("brake_open", "brake", "the brake does not hold", lambda _: in_device.brake_stays_open()),
    DrawnKind("brake_closed", "brake", "the brake has closed by itself", lambda _: in_device.brake_stays_closed()),
    DrawnKind("rope_slips", "rope", f"the rope slips at {{:.2g}} mm/s, at most {ROPE_MM:g} mm",
         lambda v: in_plant.rope_slips(v, ROPE_MM), 0.05, 30.0),
    DrawnKind("spring_changes", "rope", "the spring is {:.2g} times as stiff", in_plant.spring_stiffens, 0.7, 1.5),
    DrawnKind("backlash_grows", "rope", "the nut has {:.2g} times its play", in_plant.backlash, 2.0, 10.0),
    DrawnKind("loop_hangs", "process", "the loop is {:.2g} s late",
         lambda s: in_controller.hangs(round(s / TICK_S)), 0.003, 0.5, delays_s=1.0),
    DrawnKind("loop_skips", "process", "the loop misses 6 ticks every {:.2g} s",
         lambda s: in_controller.overruns(6, s), 0.03, 3.0),
)  # fmt: skip
BY_NAME = {kind.name: kind for kind in KINDS}
PARTS = tuple(dict.fromkeys(kind.part for kind in KINDS))
