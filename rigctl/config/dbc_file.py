"""The messages a rig file takes from DBC files, read and checked with cantools when the rig file is loaded.

Imported only for a rig file with a ``dbc`` section, because cantools is slow to import.
"""

from __future__ import annotations

import contextlib
import logging
import math
import pathlib
from collections.abc import Collection, Iterator
from typing import Any

import cantools

from rigctl.config import canopen, input_file
from rigctl.config.one_line import on_one_line
from rigctl.config.plain import FLOAT_CODES, PlainMessage, PlainSignal
from rigctl.config.sensor_sections import DbcSettings, PlainMessages
from rigctl.config.settings import RigSettings

_TENSION = {"N": 1.0}
_ANGLE = {"deg": math.radians(1.0), "rad": 1.0}
UNITS = {"tension_cell": {"tension": _TENSION}, "inclinometer": {"tangential": _ANGLE, "normal": _ANGLE}}
"""Signals each device must have, with the factor to N or rad by the unit in the DBC file."""

_WATCHED = {
    "tension_n": ("tension_cell", "tension", "N"),
    "tangential_deg": ("inclinometer", "tangential", "deg"),
    "normal_deg": ("inclinometer", "normal", "deg"),
}
"""What of a limit's signals comes in a plain frame: device, signal, and the limit's unit."""
_LARGEST_FRAME = 8
_LARGEST_BYTES = 64 << 20  # a car maker's whole network has 10 MiB
_NAMES_SHOWN = 8
logging.getLogger("cantools").addHandler(
    logging.NullHandler()
)  # it reports two messages of a name, which we may not use


class DbcError(ValueError):
    """A DBC section that is refused: ``key`` is the rig file's (a path), with what was found and what is expected."""

    def __init__(self, key: tuple[str, ...], found: str, allowed: str) -> None:
        super().__init__(f"{'.'.join(key)}: found {found}, expected {allowed}")
        self.key = key


def messages(settings: RigSettings) -> PlainMessages:
    """Layouts of the plain frames the rig file names.

    Raises:
        DbcError: the first thing that cannot be used.
    """
    ids = _canopen_ids(settings)
    stale_ms = {"tension_cell": "stale_ms", "inclinometer": "inclination_stale_ms"}
    found: dict[str, PlainMessage] = {}
    for device in UNITS:
        dbc: DbcSettings | None = getattr(settings, device).dbc
        if dbc is None:
            continue
        message = found[device] = _message(device, dbc, settings.file(dbc.file))
        if message.can_id in ids:
            raise DbcError(
                (device, "dbc", "message"),
                f"{message.name} with id 0x{message.can_id:03X}",
                f"an id of its own ({ids[message.can_id]} has it)",
            )
        ids[message.can_id] = device
        limit_ms, two_ms = getattr(settings.safety, stale_ms[device]), 2 * (message.cycle_ms or 0)
        if limit_ms < two_ms:
            allowed = f"two cycles of {device}'s message ({two_ms} ms) or more"
            raise DbcError(("safety", stale_ms[device]), str(limit_ms), allowed)
    reached = PlainMessages(**found)
    if settings.safety.waiver is None:
        _refuse_unreached(settings, reached)
    return reached


def _refuse_unreached(settings: RigSettings, found: PlainMessages) -> None:
    """Refuse a signal that ends within a limit that acts on it: the limit could never trip.

    Raises:
        DbcError: the first such signal.
    """
    for device, role, unit, low, high, bound in _bounds(settings):
        message: PlainMessage | None = getattr(found, device)
        if message is None:
            continue
        signal, si = message.signals[role], UNITS[device][role][unit]
        begins, ends = signal.least / si, signal.most / si
        for reaches, words, limit, end in (
            (low is None or begins < low, f"begin at {begins:.6g}", low, "low"),
            (high is None or ends > high, f"end at {ends:.6g}", high, "high"),
        ):
            if not reaches:
                raise DbcError(
                    (device, "dbc", role),
                    f"{signal.name}, whose values {words} {unit}",
                    f"one that passes {limit:g} ({bound.format(end)}), which could never trip",
                )


def _bounds(settings: RigSettings) -> Iterator[tuple[str, str, str, float | None, float | None, str]]:
    """Device, signal and unit of each limit that acts, its ends, and their name, with a place for low or high."""
    safety = settings.safety
    yield "tension_cell", "tension", "N", safety.tension_low_n, safety.tension_high_n, "safety.tension_{}_n"
    for place, row in enumerate(settings.limits):
        if row.signal in _WATCHED and row.action != "log":
            yield *_WATCHED[row.signal], row.low, row.high, f"limits.{place}.{{}}"
    yield "tension_cell", "tension", "N", -settings.slack_reading_n, None, "fault CELL_NEGATIVE"


def _canopen_ids(settings: RigSettings) -> dict[int, str]:
    """Identifiers that CANopen uses on this rig, with their use (CiA 301, pre-defined connection set)."""
    ids = {
        canopen.NMT_COB: "NMT",
        canopen.SYNC_COB: "SYNC",
        canopen.HEARTBEAT_BASE + settings.can.controller_node: "the controller's heartbeat",
    }
    kinds = {
        canopen.EMCY_BASE: "emergency", canopen.TPDO1_BASE: "TPDO", canopen.RPDO1_BASE: "RPDO",
        canopen.SDO_TX_BASE: "SDO answer", canopen.SDO_RX_BASE: "SDO request", canopen.HEARTBEAT_BASE: "heartbeat",
    }  # fmt: skip
    for name, node in {**settings.canopen_nodes, "simulator": canopen.SIMULATOR_NODE}.items():
        ids |= {base + node: f"{name}'s {kind}" for base, kind in kinds.items()}
    cylinder = settings.cylinder
    used = {"cylinder_speed": cylinder.velocity_pdo} if cylinder.velocity_pdo != cylinder.position_pdo else {}
    used |= {"cylinder_status": cylinder.status_pdo} if settings.status_divisor else {}
    return ids | {canopen.tpdo_base(pdo) + cylinder.node: f"the drive's PDO ({name})" for name, pdo in used.items()}


def _message(device: str, dbc: DbcSettings, file: pathlib.Path) -> PlainMessage:
    key = (device, "dbc", "message")
    known = _read(device, dbc, file)
    same = [message for message in known if message.name == dbc.message]
    if not same:
        raise DbcError(key, f"no message {dbc.message} in {dbc.file}", _one_of([message.name for message in known]))
    if len(same) > 1:
        raise DbcError(key, f"{len(same)} messages {dbc.message} in {dbc.file}", "one")
    (message,) = same
    if message.is_extended_frame:
        raise DbcError(key, f"{dbc.message} with extended id 0x{message.frame_id:08X}", "a standard id (11 bits)")
    if message.is_fd or message.length > _LARGEST_FRAME:
        kind = "CAN FD, " if message.is_fd else ""
        raise DbcError(key, f"{dbc.message} with {kind}{message.length} bytes", "a classic frame of 1 to 8 bytes")
    units = {**UNITS[device], **({"valid": None} if dbc.valid is not None else {})}
    return PlainMessage(
        name=dbc.message,
        can_id=message.frame_id,
        size=message.length,
        cycle_ms=_cycle_ms(key, message),
        signals={
            role: signal_layout((device, "dbc", role), message, getattr(dbc, role), units[role]) for role in units
        },
    )


def _cycle_ms(key: tuple[str, ...], message: Any) -> int | None:
    """GenMsgCycleTime in whole ms; None where it is missing or 0."""
    try:
        cycle_ms = int(message.cycle_time or 0)
    except (ValueError, OverflowError):  # the file may declare the attribute as text, or as a float
        raise DbcError(key, f"{message.name} with a GenMsgCycleTime that is no number", "milliseconds") from None
    return cycle_ms if cycle_ms > 0 else None


def _read(device: str, dbc: DbcSettings, file: pathlib.Path) -> list[Any]:
    key = (device, "dbc", "file")
    if not file.is_file():
        raise DbcError(key, f"no file {dbc.file}", "a DBC file")
    try:
        text = input_file.text(input_file.read(file, largest=_LARGEST_BYTES, links=True))
        return list(cantools.database.load_string(text, database_format="dbc").messages)
    except (OSError, ValueError, cantools.database.Error) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else " ".join(str(error).split())
        raise DbcError(key, f"{dbc.file}, which cannot be read ({on_one_line(reason)})", "a DBC file") from None


def signal_layout(key: tuple[str, ...], message: Any, name: str, units: dict[str, float] | None) -> PlainSignal:
    """Layout of a message's signal, scaled to N or rad; ``units`` None: any unit, not scaled.

    Raises:
        DbcError: there is no such signal, or it cannot be used; ``key`` is the rig file's.
    """
    same = [signal for signal in message.signals if signal.name == name]
    if not same:
        names = [signal.name for signal in message.signals]
        raise DbcError(key, f"no signal {name} in message {message.name}", _one_of(names))
    signal = same[0]
    if signal.is_multiplexer or signal.multiplexer_ids:
        raise DbcError(key, f"{name}, which is multiplexed", "a signal that is in every frame")
    if units is not None and signal.unit not in units:
        raise DbcError(key, f"unit {signal.unit}" if signal.unit else "no unit", f"unit {' or '.join(units)}")
    if signal.is_float and signal.length not in FLOAT_CODES:
        raise DbcError(key, f"a float of {signal.length} bits", "16, 32 or 64 bits")
    factor = 1.0 if units is None else units[signal.unit]
    return PlainSignal(
        name=name,
        start=signal.start,
        length=signal.length,
        big_endian=signal.byte_order == "big_endian",
        signed=bool(signal.is_signed),
        floating=bool(signal.is_float),
        scale=_finite(key, "scale", signal.scale, factor, zero=False),
        offset=_finite(key, "offset", signal.offset, factor, zero=True),
        **_declared(signal, factor),
    )


def _finite(key: tuple[str, ...], what: str, number: float, factor: float, *, zero: bool) -> float:
    """Scale or offset times ``factor``, which must be finite."""
    try:
        scaled = float(number) * factor
    except OverflowError:  # an integer of hundreds of digits
        scaled = math.inf
    if not math.isfinite(scaled) or (scaled == 0.0 and not zero):
        raise DbcError(key, f"{what} {scaled:g}", f"a finite {what}" + ("" if zero else ", not 0"))
    return scaled


def _declared(signal: Any, factor: float) -> dict[str, float]:
    """The range that the file gives the signal, in N or rad; empty where it gives none, or one that is no range."""
    if signal.minimum is None or signal.maximum is None or not signal.minimum < signal.maximum:
        return {}
    found = {}
    for key, end in (("declared_least", signal.minimum), ("declared_most", signal.maximum)):
        with contextlib.suppress(OverflowError):  # an integer of hundreds of digits
            if math.isfinite(number := float(end) * factor):
                found[key] = number
    return found


def _one_of(names: Collection[str]) -> str:
    if not names:
        return "one that is there (it has none)"
    return " or ".join(sorted(names)[:_NAMES_SHOWN]) + (" ..." if len(names) > _NAMES_SHOWN else "")
