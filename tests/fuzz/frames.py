"""Random frames and commands into the real loop; every frame it sends to the drive is checked against the limits."""

from __future__ import annotations

import math
import pathlib
import random
import struct
import tempfile
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import can

from hil.loop_view import LoopView
from rigctl.config.settings import RigSettings
from rigctl.control.clock import SimulatedClock
from rigctl.control.law.tension import Gains
from rigctl.control.logbook import Rings
from rigctl.control.loop import Loop
from rigctl.control.modes import command_slot
from rigctl.devices import objects as od
from rigctl.devices.objects import Controlword
from rigctl.ipc.runtime_folder import Runtime
from rigctl.model.device_states import NmtState
from rigctl.model.reactions import Action
from rigctl.model.states import Mode
from rigctl.model.verbs import Setting, Verb

FRAMES_PER_TICK = 24
EPISODE_TICKS = 6_000
_ODD = (0, 1, -1, 2**31 - 1, -(2**31), 2**15 - 1, -(2**15), 0x7FC00000, 0x7F800000)
_COMMAND = od.DRIVE_RPDO.codec
ROUNDING_MM_S = od.MM_S_PER_VELOCITY_UNIT


_STATUS: dict[int, int] = {Controlword.SWITCH_ON: 0x0233, Controlword.ENABLE_OPERATION: 0x0237 | od.STATUS_FOLLOWS}


class Echo:
    """The smallest rig that can be armed and tensioned: a drive with lag and delay, a spring, and noise."""

    def __init__(self, settings: RigSettings, chance: random.Random) -> None:
        self._chance, self._plant = chance, settings.plant
        self._nodes, self._range_mm = settings.canopen_nodes, settings.cylinder
        self._dt = settings.loop.period_ns * 1e-9
        self._sent = deque([0.0] * round(settings.plant.command_delay_s / self._dt + 1))
        self._speed_mm_s, self._stroke_mm, self._tick = 0.0, 20.0, 0
        self._enabled, self._status = False, 0x0231

    def command(self, controlword: int, speed_mm_s: float) -> None:
        """Receive the loop's command of this tick."""
        self._status = _STATUS.get(controlword, 0x0231)
        self._enabled = controlword == Controlword.ENABLE_OPERATION
        self._sent.append(speed_mm_s if self._enabled else 0.0)
        share = self._dt / self._plant.cylinder_lag_s
        self._speed_mm_s += (self._sent.popleft() - self._speed_mm_s) * share
        self._stroke_mm += self._speed_mm_s * self._dt
        self._tick += 1

    @property
    def position_um(self) -> int:
        """The drive's position."""
        return round(self._stroke_mm * 1000)

    def node_of(self, device: str) -> int:
        """Node id of a device."""
        return self._nodes[device]

    def frames(self) -> Iterator[can.Message]:
        """The devices' frames of this tick."""
        tension = max(0.0, self._plant.stiffness_n_mm * (self._stroke_mm - 2.0)) + self._chance.gauss(0.0, 0.03)
        position, velocity = self.position_um, round(self._speed_mm_s * 100)
        yield _frame(od.TPDO1_BASE + self._nodes["tension_cell"], od.CELL_TPDO.codec.pack(round(tension * 1000), 0))
        yield _frame(
            od.TPDO1_BASE + self._nodes["cylinder"], od.DRIVE_TPDO.codec.pack(self._status, position, velocity)
        )
        if self._tick % 50 == 0:
            yield _frame(od.TPDO2_BASE + self._nodes["cylinder"], od.DRIVE_TPDO2.codec.pack(300, 350, 0xFFFF_FFFF))
        if self._tick % 10 == 0:
            yield _frame(od.TPDO1_BASE + self._nodes["inclinometer"], od.SLOPE_TPDO.codec.pack(3, -1))
        if self._tick % 20 == 0 and "io" in self._nodes:
            yield _frame(od.TPDO1_BASE + self._nodes["io"], bytes([od.EVERY_INPUT_8]))
        if self._tick % 100 == 0:
            for node in self._nodes.values():
                yield _frame(od.HEARTBEAT_BASE + node, bytes([NmtState.OPERATIONAL]))

    def emergencies_over(self) -> Iterator[can.Message]:
        """Emergency messages without an error, so that a standing fault can be reset."""
        for node in self._nodes.values():
            yield _frame(od.EMCY_BASE + node, bytes(8))


def _negated(data: bytes) -> bytes:
    (value,) = struct.unpack_from("<i", data)
    return struct.pack("<i", max(-value, -(2**31) + 1)) + data[4:] if value != -(2**31) else data


def _flipped(data: bytes, chance: random.Random) -> bytes:
    return data[:-4] + bytes([data[-4] ^ 1 << chance.randrange(8)]) + data[-3:]


_SPOILS: dict[str, Callable[[bytes, random.Random], bytes | None]] = {
    "lost": lambda _data, _chance: None,
    "lost now and then": lambda data, chance: data if chance.random() < 0.5 else None,
    "a bit flipped": lambda data, chance: bytes(
        byte ^ (1 << chance.randrange(8) if i == chance.randrange(8) else 0) for i, byte in enumerate(data)
    ),
    "a value flipped": lambda data, chance: _flipped(data, chance) if len(data) >= 4 else data,
    "negated": lambda data, _chance: _negated(data) if len(data) >= 4 else data,
    "cut off": lambda data, chance: data[: chance.randrange(len(data) + 1)],
    "anew": lambda data, chance: chance.randbytes(len(data)),
}


class RandomBus(can.BusABC):
    """Calm stretches with the answers of a rig and few other frames, and wild ones.

    A wild one has random frames, or corrupts one device's: lost, frozen, flipped, negated, cut.
    """

    def __init__(self, settings: RigSettings, seed: int) -> None:
        self.sent: list[can.Message] = []
        self.received = 0
        self._chance = chance = random.Random(seed)
        self.echo = Echo(settings, chance)
        self._queue: deque[can.Message] = deque()
        self._anything = anything(settings, chance, self.echo)
        self._until, self._wild = 0, True
        self._spoil, self._spoilt, self._frozen = "", 0, b""
        self._devices = ("tension_cell", "inclinometer", "cylinder", *(("io",) if settings.io else ()))
        super().__init__(channel="random")

    def refill(self, tick: int) -> None:
        """Prepare the frames of a tick."""
        chance = self._chance
        if tick >= self._until:
            self._wild = not self._wild
            self._until = tick + (chance.randrange(2, 200) if self._wild else chance.randrange(300, 9000))
            self._spoil = chance.choice((*_SPOILS, "frozen", "", "")) if self._wild else ""
            self._spoilt, self._frozen = chance.randrange(len(self._devices) + 1), b""
            if not self._wild:
                self._queue.extend(self.echo.emergencies_over())
        if not self._wild or self._spoil:
            self._queue.extend(self._spoilt_frames())
        anything_goes = self._wild and not self._spoil
        odd = chance.randrange(FRAMES_PER_TICK) if anything_goes else chance.random() < 0.0005
        self._queue.extend(next(self._anything) for _ in range(odd))

    def _spoilt_frames(self) -> Iterator[can.Message]:
        for message in self.echo.frames():
            device = self._spoilt - 1  # 0: all of them
            node = self.echo.node_of(self._devices[device]) if device >= 0 else message.arbitration_id & 0x7F
            if not self._spoil or message.arbitration_id & 0x7F != node:
                yield message
            elif self._spoil == "frozen":
                if message.arbitration_id < od.TPDO2_BASE:
                    self._frozen = self._frozen if device >= 0 and self._frozen else bytes(message.data)
                    yield _frame(message.arbitration_id, self._frozen)
            elif (data := _SPOILS[self._spoil](bytes(message.data), self._chance)) is not None:
                yield _frame(message.arbitration_id, data)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:  # noqa: ARG002
        """Keep the message."""
        self.sent.append(msg)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:  # noqa: ARG002
        if not self._queue:
            return None, True
        self.received += 1
        return self._queue.popleft(), True


def _frame(can_id: int, data: bytes) -> can.Message:
    return can.Message(arbitration_id=can_id, data=data, is_extended_id=False)


def anything(settings: RigSettings, chance: random.Random, echo: Echo) -> Iterator[can.Message]:
    """Valid ids with any value, any bytes or any length; any id; error, remote and extended frames."""
    nodes = settings.canopen_nodes
    cell, slope, drive = (od.TPDO1_BASE + nodes[name] for name in ("tension_cell", "inclinometer", "cylinder"))
    bases = (od.TPDO1_BASE, od.TPDO2_BASE, od.EMCY_BASE, od.HEARTBEAT_BASE, od.RPDO1_BASE, od.SDO_TX_BASE)
    known = [base + node for base in bases for node in (*nodes.values(), settings.can.controller_node)]

    def odd_bytes() -> bytes:
        data = struct.pack("<ii", chance.choice(_ODD), chance.choice(_ODD)) if chance.random() < 0.3 else None
        return (data or chance.randbytes(8))[: chance.randrange(9)]

    while True:
        kind = chance.random()
        if kind < 0.2:
            yield _frame(cell, od.CELL_TPDO.codec.pack(chance.randrange(-20_000, 520_000), chance.choice((0, 0, 1))))
        elif kind < 0.3:
            yield _frame(slope, od.SLOPE_TPDO.codec.pack(chance.randrange(-9000, 9000), chance.randrange(-90, 90)))
        elif kind < 0.5:
            status = chance.choice((0x0237, 0x0237, 0x0231, 0x0250, 0x0208, chance.randrange(2**16)))
            near = chance.random() < 0.9  # else the jump of the position trips first
            position = echo.position_um + chance.randrange(-200, 200) if near else chance.randrange(-30_000, 130_000)
            velocity = chance.randrange(-1500, 1500)
            yield _frame(drive, od.DRIVE_TPDO.codec.pack(status, position, velocity))
        elif kind < 0.55 and "io" in nodes:
            yield _frame(od.TPDO1_BASE + nodes["io"], bytes([chance.choice((0, 0xFF, chance.randrange(256)))]))
        elif kind < 0.85:
            yield _frame(chance.choice(known), odd_bytes())
        elif kind < 0.92:
            yield can.Message(arbitration_id=chance.randrange(2**29), data=odd_bytes(), is_extended_id=True)
        elif kind < 0.96:
            length = chance.randrange(9)
            yield can.Message(
                arbitration_id=chance.randrange(2**11), is_remote_frame=True, dlc=length, is_extended_id=False
            )
        else:
            yield can.Message(arbitration_id=chance.randrange(2**29), data=odd_bytes(), is_error_frame=True)


@dataclass
class Found:
    """Results of the fuzzing."""

    frames: int = 0
    ticks: int = 0
    commands: int = 0
    modes: set[str] = field(default_factory=set)
    faults: set[str] = field(default_factory=set)
    wrong: list[str] = field(default_factory=list)


def play(settings: RigSettings, gains: Gains, frames: int, seed: int) -> Found:
    """Feed at least ``frames`` random frames, with random commands between them, to one loop after the other."""
    found, chance = Found(), random.Random(seed)
    while found.frames < frames:
        _episode(settings, gains, found, chance)
    return found


def _episode(settings: RigSettings, gains: Gains, found: Found, chance: random.Random) -> None:
    """One loop from its start; an episode whose loop reboots or fails for good must not end the fuzzing."""
    with tempfile.TemporaryDirectory(prefix="rigctl-fuzz-", dir="/dev/shm") as folder:
        runtime = Runtime(pathlib.Path(folder))
        runtime.make_rings(settings)
        bus = RandomBus(settings, chance.randrange(2**32))
        records, replies, commands = runtime.records.reader(), runtime.replies.reader(), runtime.commands.writer()
        clock = SimulatedClock(settings.loop.period_ns, lambda _t: None)
        loop = Loop(settings, gains, bus, clock, Rings.of(runtime), supervised=True)
        judge = _Judge(settings, found, bus.echo)
        sent = answered = 0
        for tick in range(EPISODE_TICKS):
            bus.refill(tick)
            if chance.random() < 0.006:
                sent += 1
                commands.write(*command_slot(clock.now(), sent, *_command(settings, chance, loop)))
            loop.tick()
            judge.see(bus.sent, loop)
            bus.sent.clear()
            if tick % 1000 == 999:
                judge.see_records(records.read())
                answered += len(replies.read())
        loop.stop_requested = True  # every waiting command gets its reply, exactly one
        for _ in range(10):
            loop.tick()
        answered += len(replies.read())
        if answered != sent:
            found.wrong.append(f"{sent} commands, {answered} answers")
        found.frames += bus.received
        found.ticks += EPISODE_TICKS
        found.commands += sent
        bus.shutdown()


ONWARD = {
    Mode.DISARMED: (Verb.ARM, Verb.ARM, Verb.CONFIRM_STROKE),
    Mode.HOLD: (Verb.TENSION, Verb.TENSION, Verb.RELEASE, Verb.IDENTIFY, Verb.BRAKE_TEST),
    Mode.TENSIONING: (Verb.TARGET,),
    Mode.COMPENSATING: (Verb.TARGET, Verb.TARGET, Verb.RELEASE, Verb.MOVE),
    Mode.RELEASING: (Verb.TENSION, Verb.TARGET),
    Mode.FAULT: (Verb.RESET, Verb.RESET, Verb.CONFIRM_STROKE),
}


def _command(settings: RigSettings, chance: random.Random, loop: Loop) -> tuple[int, *tuple[float, ...]]:
    """Mostly a command that changes the mode; now and then an invalid code or value."""
    kind = chance.random()
    if loop.machine.mode is Mode.DISARMED and kind < 0.2:
        return chance.choice((Setting.HOST_CHECKS, Setting.OVERDUE)), 0.0  # nothing prevents arming any more
    low, high = settings.tension.target_min_n - 20, settings.tension.target_max_n + 20
    if kind < 0.7:
        verb = chance.choice(ONWARD[loop.machine.mode])
        values = {Verb.CONFIRM_STROKE: loop.inbox.drive.stroke_mm, Verb.RELEASE: chance.choice((0.0, 0.0, 5.0))}
        return verb, values.get(verb, chance.uniform(low, high))
    if kind < 0.8:
        return chance.randrange(256), chance.choice((math.nan, math.inf, -math.inf, 1e300, -1.0, 0.0))
    if kind < 0.9:
        return chance.choice(list(Setting)), *(
            chance.choice((0.0, 1.0, 0.5, chance.uniform(-20, 20))) for _ in range(3)
        )
    return chance.choice(list(Verb)), chance.uniform(low, high)


_CUT = bytes.fromhex("2B40600000000000")  # SDO: 2 bytes to 0x6040, disable voltage


class _Judge:
    """Checks commands to the drive and records against their bounds."""

    def __init__(self, settings: RigSettings, found: Found, echo: Echo) -> None:
        self._found, self._echo = found, echo
        self._speed_max = settings.tension.speed_max_mm_s + ROUNDING_MM_S
        self._step_max = settings.tension.acceleration_max_mm_s2 * settings.loop.period_ns * 1e-9 + 2 * ROUNDING_MM_S
        self._command_id = od.DRIVE_RPDO.cob_base + settings.cylinder.node
        self._drive_sdo = od.SDO_RX_BASE + settings.cylinder.node
        self._ours = {self._command_id, od.SYNC_COB, od.HEARTBEAT_BASE + settings.can.controller_node}
        self._last = 0.0

    def see(self, sent: list[can.Message], loop: Loop) -> None:
        """Check the frames of one tick."""
        self._found.modes.add(loop.machine.mode.name)
        self._found.faults.add(loop.machine.fault.name)
        commands = [message for message in sent if message.arbitration_id == self._command_id]
        if LoopView(loop).action is Action.SILENCE and not commands and all(map(self._of_silence, sent)):
            return
        if len(commands) != 1 or any(message.arbitration_id not in self._ours for message in sent):
            self._wrong(loop, f"sent {[hex(message.arbitration_id) for message in sent]}")
            return
        controlword, velocity = _COMMAND.unpack(commands[0].data)
        speed = velocity * od.MM_S_PER_VELOCITY_UNIT
        if controlword not in Controlword._value2member_map_:
            self._wrong(loop, f"controlword 0x{controlword:04X}")
        if abs(speed) > self._speed_max:
            self._wrong(loop, f"speed {speed} mm/s")
        if abs(speed - self._last) > self._step_max and speed != 0.0:
            self._wrong(loop, f"step from {self._last} to {speed} mm/s")
        if loop.machine.mode is Mode.DISARMED and controlword == Controlword.ENABLE_OPERATION and speed != 0.0:
            self._wrong(loop, f"moves at {speed} mm/s, DISARMED")
        self._last = speed
        self._echo.command(controlword, speed)

    def see_records(self, records: object) -> None:
        """Check the records that the gateway would publish."""
        for record in records:  # type: ignore[attr-defined]
            if not math.isfinite(record["command_mm_s"]) or not math.isfinite(record["estimate_n"]):
                self._found.wrong.append(f"tick {record['tick']}: not finite in the record")

    def _wrong(self, loop: Loop, what: str) -> None:
        self._found.wrong.append(f"tick {self._found.ticks}, {loop.machine.mode.name}: {what}")

    def _of_silence(self, message: can.Message) -> bool:
        """NMT, SYNC, and power off by SDO: a drive that does not obey is stopped, and then gets no command."""
        cuts = message.arbitration_id == self._drive_sdo and bytes(message.data) == _CUT
        return cuts or message.arbitration_id in (od.NMT_COB, od.SYNC_COB)
