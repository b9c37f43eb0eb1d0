"""Faults of the devices: sensor readings, the drive's response to commands, and power."""

from __future__ import annotations

import itertools
import math
from collections import deque
from functools import partial

from hil.faults.stand import FaultPlace, FindNode, Injector, NoDeviceError, Stand, Step, needs_of, parts_of
from hil.nodes.cylinder_drive import CylinderDrive, ServiceTool
from hil.nodes.node import GENERIC_ERROR, Node
from rigctl.config.simulation_section import DevicesSettings
from rigctl.devices import objects
from rigctl.devices.objects import AiStatus
from rigctl.model.device_states import STATUSWORD, DriveState
from rigctl.model.parts import Part

Address = tuple[int, int]
CELL = (objects.AI_PROCESS_VALUE, 1)
CELL_STATUS = (objects.AI_STATUS, 1)
LONG, LATERAL = (objects.SLOPE_LONG, 0), (objects.SLOPE_LATERAL, 0)
STATUS = (STATUSWORD, 0)
STROKE, SPEED = (objects.POSITION_ACTUAL, 0), (objects.VELOCITY_ACTUAL_16, 0)
_UNITS = {CELL: objects.N_PER_CELL_UNIT, LONG: 0.01, LATERAL: 0.01, STROKE: 1e-3, SPEED: 1e-2}
"""N, deg, mm, mm/s in one unit of the object."""
_INT16, _INT32 = (-(1 << 15) + 1, (1 << 15) - 1), (-(1 << 31) + 1, (1 << 31) - 1)
_RANGES = {CELL: _INT32, STROKE: _INT32, LONG: _INT16, LATERAL: _INT16, SPEED: _INT16}
_of = partial(Injector, FaultPlace.DEVICE)
_CELL = (Part.CELL, Part.AMPLIFIER)
"""Of a reading that is wrong: cell, cable and amplifier have one output."""
_DRIVE, _ENCODER, _BRAKE = (Part.DRIVE,), (Part.ENCODER,), (Part.BRAKE,)
_IO_NODE, _E_STOP = (Part.IO_NODE,), (Part.E_STOP,)
_PARTS = {
    **dict.fromkeys((CELL, CELL_STATUS), _CELL), **dict.fromkeys((LONG, LATERAL), (Part.INCLINOMETER,)), STATUS: _DRIVE,
    **dict.fromkeys((STROKE, SPEED), _ENCODER),
}  # fmt: skip
NOT_A_NUMBER = -(1 << 31)
SPIKE_EVERY_MS = 200
FREE_KG = 50.0
"""Rotor and screw as seen by the rope, where nothing but their mass and the screw's friction resists the load."""
_ANEW_NS = 5_000_000
_WORD_BYTES = 2  # the controlword is the first object of the command PDO
_ENABLES = 0x0008  # bit of the controlword
_DISABLED = DriveState.SWITCH_ON_DISABLED.value


def reads(
    address: Address,
    *,
    times: float = 1.0,
    plus: float = 0.0,
    drift_s: float = 0.0,
    noise: float = 0.0,
    freezes: bool = False,
    spikes: float = 0.0,
) -> Injector:
    """A sensor that measures wrongly without reporting it.

    In N, deg, mm or mm/s: a factor, then an offset, a drift per second, noise (rms) and, every 200 ms, a spike of one
    sample. ``freezes``: the measured quantity stays at its value.
    """

    def inject(stand: Stand) -> Step:
        unit, (least, most) = _UNITS[address], _RANGES[address]
        since = [0.0]
        first: list[float] = []

        def distorted(raw: int) -> int:
            if not first:
                first.append(raw * unit)
            value = times * (first[0] if freezes else raw * unit) + plus + drift_s * since[0]
            value += stand.random.gauss(0.0, noise) if noise else 0.0
            value += spikes if round(since[0] * 1e3) % SPIKE_EVERY_MS == 0 else 0.0
            return min(max(round(value / unit), least), most)

        def step(t_s: float) -> None:
            since[0] = t_s

        _device(stand, address).distort(*address, distorted)
        return step

    return _of(_PARTS[address], inject)


def stuck(address: Address) -> Injector:
    """A sensor that repeats its last value, to the last bit."""

    def inject(stand: Stand) -> None:
        first: list[int] = []

        def held(raw: int) -> int:
            if not first:
                first.append(raw)
            return first[0]

        _device(stand, address).distort(*address, held)

    return _of((Part.AMPLIFIER,) if address == CELL else _PARTS[address], inject)  # a cell has noise


def says(address: Address, raw: int) -> Injector:
    """An object that always reads as this number."""
    return _of(_PARTS[address], lambda stand: _device(stand, address).distort(*address, lambda _: raw))


def overloaded() -> Injector:
    """An amplifier at the end of its range that reports overload."""

    def inject(stand: Stand) -> None:
        most = round(stand.settings.tension_cell.range_n / objects.N_PER_CELL_UNIT)
        stand.cell.distort(*CELL, lambda _: most)
        stand.cell.distort(*CELL_STATUS, lambda _: int(AiStatus.POSITIVE_OVERLOAD))

    return _of(_CELL, inject)


def both(*parts: Injector) -> Injector:
    """Several faults at once."""

    def inject(stand: Stand) -> Step:
        steps = [step for part in parts if (step := part(stand)) is not None]

        def step_all(t_s: float) -> None:
            for step in steps:
                step(t_s)

        return step_all

    return _of(parts_of(parts), inject, needs_of(parts))


def reboots(find: FindNode) -> Injector:
    """A device that reboots and, as after power-on, waits to be configured."""
    return _of(find.part, lambda stand: find(stand).reset_node())


def power_dip(seconds: float) -> Injector:
    """All devices lose power for a moment: they are silent, the brake closes; then they reboot."""

    def inject(stand: Stand) -> Step:
        connect = stand.intercept(lambda _, __: ())
        stand.drive.reset_node()

        def back() -> None:
            connect()
            for node in stand.rig.rig.nodes:
                node.reset_node()

        return stand.ends_after(seconds, back)

    return _of((Part.BUS,), inject)


def trips(code: int) -> Injector:
    """The drive reports a fault of its own."""
    return _of(_DRIVE, lambda stand: stand.drive.trip(code))


def e_stop(seconds: float = math.inf) -> Injector:
    """The drive's emergency stop is pressed, and released later."""

    def inject(stand: Stand) -> Step:
        stand.drive.press_e_stop(True)
        return stand.ends_after(seconds, lambda: stand.drive.press_e_stop(False))

    return _of(_E_STOP, inject)


def io_contact_opens(seconds: float = math.inf) -> Injector:
    """The emergency stop's contact at the I/O node opens, for a while or permanently; the drive's stays closed."""

    def inject(stand: Stand) -> Step:
        stand.io.press_e_stop(True)
        return stand.ends_after(seconds, lambda: stand.io.press_e_stop(False))

    return _of(_E_STOP, inject)


def second_force_off(newtons: float) -> Injector:
    """The second force path reads so much too high from now on."""

    def inject(stand: Stand) -> None:
        stand.second.fault_n = newtons

    return _of((Part.SECOND_FORCE, Part.CELL), inject)


def setting_lost(index: int, sub: int, value: int = 0) -> Injector:
    """An object of the drive is written through its own service connection: no frame on the bus shows it."""

    def inject(stand: Stand) -> None:
        entry = stand.drive.device.sdo[index]
        (entry[sub] if sub else entry).raw = value

    return _of(_DRIVE, inject)


def sync_unheard(find: FindNode) -> Injector:
    """A device takes no frame as SYNC any more; its object 0x1005 reads as before."""
    return _of(find.part, lambda stand: find(stand).listen_to_sync(None))


def rpdo_ignored() -> Injector:
    """The drive receives its RPDO, which keeps its deadline, and does not act on it."""

    def inject(stand: Stand) -> None:
        stand.drive.rpdo_defect = lambda _: None

    return _of(_DRIVE, inject)


def rpdo_frozen() -> Injector:
    """The drive takes the content of the first RPDO from now on for that of every one."""

    def inject(stand: Stand) -> None:
        first: list[bytes] = []

        def repeated(data: bytes) -> bytes:
            if not first:
                first.append(data)
            return first[0]

        stand.drive.rpdo_defect = repeated

    return _of(_DRIVE, inject)


def rpdo_late(ticks: int) -> Injector:
    """The drive acts on each RPDO as many ticks after it has come."""

    def inject(stand: Stand) -> None:
        waiting = deque[bytes]()

        def delayed(data: bytes) -> bytes | None:
            waiting.append(data)
            return waiting.popleft() if len(waiting) > ticks else None

        stand.drive.rpdo_defect = delayed

    return _of(_DRIVE, inject)


def controlword_every(ticks: int) -> Injector:
    """The drive takes its controlword from one RPDO in ``ticks``, and the target velocity from each."""

    def inject(stand: Stand) -> None:
        count, word = itertools.count(), [b""]

        def sampled(data: bytes) -> bytes:
            if next(count) % ticks == 0:
                word[0] = data[:_WORD_BYTES]
            return word[0] + data[_WORD_BYTES:]

        stand.drive.rpdo_defect = sampled

    return _of(_DRIVE, inject)


def state_persists(state: DriveState) -> Injector:
    """Every commanded stop of the drive ends in this state, its motor carrying; disable voltage alone ends it."""

    def inject(stand: Stand) -> None:
        stand.drive.control.persists = state

    return _of(_DRIVE, inject)


def state_reported(state: DriveState) -> Injector:
    """The drive reports this state whatever state it is in, and otherwise does as before."""
    mask = objects.DRIVE_STATE_MASK
    return _of(_DRIVE, lambda stand: stand.drive.distort(*STATUS, lambda raw: raw & ~mask | state & mask))


def enabling_refused() -> Injector:
    """The drive takes every command and does not switch its motor on."""

    def inject(stand: Stand) -> None:
        stand.drive.control.refuses = True

    return _of(_DRIVE, inject)


def torque_lost(*, free: bool, after_s: float = 0.0) -> Injector:
    """The motor has no torque any more: the load turns it, against its shorted windings, or freely.

    ``free``: the load accelerates `FREE_KG` against the friction of the screw; else it sinks at the speed of a motor
    without power. ``after_s``: only for so long after each opening of the brake, as a current that comes late; 0: for
    good.
    """

    def inject(stand: Stand) -> None:
        drive = stand.settings.simulation.drive if stand.settings.simulation is not None else None
        if drive is None:
            raise NoDeviceError("this rig has no simulated drive")
        speed_mm_s, at_ns, open_ns = 0.0, 0, 0
        if not stand.drive.brake.closed:
            at_ns = stand.plant.t_ns

        def turned(load_n: float, t_ns: int) -> float | None:
            nonlocal speed_mm_s, at_ns, open_ns
            if t_ns - at_ns > _ANEW_NS:  # the brake was closed meanwhile
                speed_mm_s, open_ns = 0.0, t_ns
            elif free:
                gained = (load_n - drive.friction_n) / FREE_KG * 1e3 * (t_ns - at_ns) * 1e-9
                speed_mm_s = min(0.0, speed_mm_s - gained)
            at_ns = t_ns
            if after_s and t_ns - open_ns >= after_s * 1e9:
                return None
            return speed_mm_s if free else -load_n / drive.creep_n_s_mm

        stand.drive.torque_defect = turned

    return _of(_DRIVE, inject)


def boots_slowly(find: FindNode, seconds: float) -> Injector:
    """A device starts anew, and its boot-up takes so long; it is silent meanwhile."""

    def inject(stand: Stand) -> None:
        node = find(stand)
        node.behave(DevicesSettings(boot_s=seconds))
        node.reset_node()

    return _of(find.part, inject)


def start_refused(find: FindNode) -> Injector:
    """A device resets its communication, and takes no NMT start any more."""

    def inject(stand: Stand) -> None:
        node = find(stand)
        node.refuses_start = True
        node.reset_communication()

    return _of(find.part, inject)


def back_in_error(find: FindNode, code: int) -> Injector:
    """A device starts anew and comes back with an error that persists."""

    def inject(stand: Stand) -> None:
        node = find(stand)
        node.reset_node()
        if isinstance(node, CylinderDrive):
            node.trip(code)
        else:
            node.raise_error(code, GENERIC_ERROR)

    return _of(find.part, inject)


def hangs() -> Injector:
    """The drive's motor goes on at its last speed: no command, NMT stop or silence changes that."""

    def inject(stand: Stand) -> None:
        stand.drive.hung = True

    return _of(_DRIVE, inject)


def lies_off() -> Injector:
    """Once it is commanded off, the drive reports that it is off, and its motor keeps its power."""

    def inject(stand: Stand) -> None:
        off: list[bool] = [False]

        def taken(data: bytes) -> bytes | None:
            off[0] = not int.from_bytes(data[:_WORD_BYTES], "little") & _ENABLES
            return None if off[0] else data

        stand.drive.rpdo_defect = taken
        stand.drive.distort(*STATUS, lambda word: word & ~objects.DRIVE_STATE_MASK | _DISABLED if off[0] else word)

    return _of(_DRIVE, inject)


def io_without_power() -> Injector:
    """The I/O node loses its own power: it is silent, and its relays open."""
    return _of(_IO_NODE, lambda stand: stand.io.switch_off())


def enable_welded() -> Injector:
    """The relay of the drive's enable does not open any more."""

    def inject(stand: Stand) -> None:
        stand.io.welded = True

    return _of(_IO_NODE, inject)


def encoder_restarts(at_mm: float = 0.0) -> Injector:
    """The drive's encoder counts from a new zero: at the present stroke it reads ``at_mm``."""

    def inject(stand: Stand) -> None:
        now_mm = stand.plant.truth.stroke_mm
        stand.drive.distort(*STROKE, lambda raw: raw - round((now_mm - at_mm) / _UNITS[STROKE]))

    return _of(_ENCODER, inject)


def tool_takes_over(speed_mm_s: float, *, deaf: bool = False, shows_remote: bool = False) -> Injector:
    """A service tool at the drive's own port enables and moves the drive; see `ServiceTool`."""
    return _of(
        (Part.MASTER, Part.DRIVE), lambda stand: stand.drive.take_over(ServiceTool(speed_mm_s, deaf, shows_remote))
    )


def status_bit(bit: int, on: bool) -> Injector:
    """A bit of the drive's statusword is stuck."""
    return _of(_DRIVE, lambda stand: stand.drive.distort(*STATUS, lambda raw: raw | bit if on else raw & ~bit))


def no_heartbeat(find: FindNode) -> Injector:
    """A device stops sending its heartbeat; its samples go on."""
    return _of(find.part, lambda stand: find(stand)._set_heartbeat(0))


def ignores_commands() -> Injector:
    """The motor stands still whatever its command; brake and states go on as usual."""

    def inject(stand: Stand) -> None:
        stand.drive.defect = lambda _, braked: (0.0, braked)

    return _of(_DRIVE, inject)


def runs_away(speed_mm_s: float) -> Injector:
    """The motor turns at a speed of its own while it has power."""

    def inject(stand: Stand) -> None:
        stand.drive.defect = lambda _, braked: (0.0 if stand.drive.stopping else speed_mm_s, braked)

    return _of(_DRIVE, inject)


def creeps(speed_mm_s: float) -> Injector:
    """While it has current, the motor turns faster than commanded by this speed, which its own encoder measures.

    The drive's dead band applies to its commands: it does not stop a creep.
    """

    def inject(stand: Stand) -> None:
        drive, dead_mm_s = stand.drive, float(stand.plant.parameters["dead_band"][0])
        stand.plant.parameters["dead_band"] = 0.0

        def defect(speed: float, braked: bool) -> tuple[float, bool]:
            if not drive.control.stage.powered:
                return speed, braked
            return (0.0 if abs(speed) < dead_mm_s else speed) + speed_mm_s, braked

        drive.defect = defect

    return _of(_DRIVE, inject)


def brake_slips(speed_mm_s: float) -> Injector:
    """The closed brake lets the load down at this speed."""

    def inject(stand: Stand) -> None:
        stand.drive.brake.slip_mm_s = speed_mm_s

    return _of(_BRAKE, inject)


def brake_closes_late(milliseconds: int) -> Injector:
    """The brake closes so much later than it should, and the drive does not wait for it."""

    def inject(stand: Stand) -> None:
        stand.drive.brake.late_ns = milliseconds * 1_000_000

    return _of(_BRAKE, inject)


def brake_stays_closed() -> Injector:
    """The brake does not open, or has closed by itself; the motor pulls against it up to its peak current."""

    def inject(stand: Stand) -> None:
        stand.drive.brake.stuck_closed = True

    return _of(_BRAKE, inject)


def brake_drags(newtons: float) -> Injector:
    """The brake opens only partly: the motor turns against so much friction, as rope force."""

    def inject(stand: Stand) -> None:
        stand.drive.brake.drag_n = newtons

    return _of(_BRAKE, inject)


def brake_stays_open() -> Injector:
    """The brake does not close; a motor without power gives way slowly."""

    def inject(stand: Stand) -> None:
        stand.drive.brake.stuck_open = True

    return _of(_BRAKE, inject)


def _device(stand: Stand, address: Address) -> Node:
    if address in (CELL, CELL_STATUS):
        return stand.cell
    return stand.slope if address in (LONG, LATERAL) else stand.drive
