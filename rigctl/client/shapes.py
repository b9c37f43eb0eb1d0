"""JSON messages from the network, checked before any use: size, depth, types, ranges, text.

Anyone on the network may publish on the rig's keys or answer its queries. A message that does not have the shape of the
daemon's is refused here, with the reason. Control characters and the like are escaped, so that any message may be
printed. Fields that are not named here are passed on, because a newer daemon may have them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any, Literal, TypeVar

import msgspec
from msgspec import Meta

from rigctl.config.built_type import built
from rigctl.config.one_line import on_one_line, printable
from rigctl.ipc.record import RECORD
from rigctl.model.quantity import count
from rigctl.model.signals import ANGLES, NAMED, UNRECORDED

Message = dict[str, Any]
Check = Callable[[bytes], object]
DEPTH = 16
_KIB = 1024
LONGEST_MESSAGE = 64 * _KIB
LONGEST_DOCUMENT = 1024 * _KIB  # cfg/active with its tables, meta/schema
LONGEST_PAST = 16 * _KIB * _KIB  # all events and notes the rings can hold
LONGEST_BLOCK = 4 * _KIB * _KIB  # of the fast stream: 1000 records in one answer

Real = float  # any finite number: the values of a broken sensor must still be shown
Bounded = Annotated[float, Meta(ge=-1e12, le=1e12)]  # settings, and times used in calculations
Count = Annotated[int, Meta(ge=0, le=2**63 - 1)]
Time = Annotated[int, Meta(ge=-(2**62), le=2**63 - 1)]  # ns, also from a wall clock that was never set
Seconds = Annotated[float, Meta(ge=0, le=1e9)]
Word = Annotated[str, Meta(pattern="^[A-Za-z0-9_]{1,64}$")]
Line = Annotated[str, Meta(max_length=8192)]
Lines = Annotated[list[Line], Meta(max_length=256)]


class MessageRefusedError(ValueError):
    """A message without the shape of the daemon's; ``str()`` is one line."""


@dataclass
class Refusals:
    """Messages refused on one connection."""

    count: int = 0
    last: str = ""

    def add(self, what: str, why: object) -> None:
        """Count a refused message: on which key, and why."""
        self.count += 1
        self.last = on_one_line(f"{what}: {why}")

    @property
    def words(self) -> str:
        """The refusals in one line; empty without any."""
        if not self.count:
            return ""
        return f"{count(self.count, 'message')} refused, the last on {self.last}"


class _Calibration(msgspec.Struct):
    zero_n: Real | None = None
    scale: Real | None = None
    due: Line | None = None
    overdue: bool = False
    waiver: Line | None = None


class _LeaseShown(msgspec.Struct):
    holder: Line
    held_s: Seconds
    left_s: Bounded
    id: Line = ""


class _Preflight(msgspec.Struct):
    failing: dict[str, Line] = {}
    waived: dict[str, Line] = {}


class _AuditStatus(msgspec.Struct):
    entries: Count | None = None
    failures: Count | None = None


class _RecordingStatus(msgspec.Struct):
    file: Line | None = None
    records_lost: Count | None = None


class _Quality(msgspec.Struct):
    tension: Line
    inclination: Line
    drive: Line


class _Percentiles(msgspec.Struct):
    p50: Real
    p99: Real
    p999: Real
    max: Real


class _Cause(msgspec.Struct):
    fault: Line = ""
    text: Line = ""
    action: Line = ""
    value: Real | None = None
    limit: Real | None = None
    since_ns: Time | None = None
    since_wall_ns: Time | None = None
    blocks_reset: bool = False


class _ReadBack(msgspec.Struct):
    t_ns: Time
    settings: Count
    took_s: Real


@built
class _AnyState(msgspec.Struct):
    mode: Word | None
    loop_alive: bool
    warnings: Lines
    wall_ns: Time
    age_ms: Bounded | None
    rig: Line = ""
    waits_for: Line | None = None
    drive_state: Word | None = None
    drive_power: Word | None = None
    calibration: _Calibration | None = None
    lease: _LeaseShown | None = None
    preflight: _Preflight | None = None
    audit: _AuditStatus | None = None
    recording: _RecordingStatus | None = None
    trip_dump: Line | None = None
    design: Line | None = None
    gateway_wall_ns: Time = 0
    stream: Count = 0
    event_seq: Count = 0
    note_seq: Count = 0
    causes: Annotated[list[_Cause], Meta(max_length=256)] = []
    read_back: _ReadBack | None = None


@built
class _Derived(_AnyState, kw_only=True):
    fault: Word | None
    fault_text: Line
    flag_names: Lines
    quality: _Quality
    lateness_us: _Percentiles | None
    work_us: _Percentiles | None


_NAMES: list[tuple[str, Any, Any]] = [
    (name, Word | None, None) if enum.none else (name, Word, "") for name, enum in NAMED.items() if name != "fault"
]
_PEOPLE: list[tuple[str, Any]] = [
    *((row.name, Real | None) for row in UNRECORDED),
    *((row.degrees, Real | None) for row in ANGLES),
]
_REPLACED = {*NAMED, *_AnyState.__struct_fields__, *_Derived.__struct_fields__}
_SHOWN = (
    "vertical_n", "tension_n", "target_n", "stroke_mm", "speed_mm_s", "t_ns", "tick", "skipped", "frames_lost",
    "frames_refused", "send_failures", "error_frames",
)  # fmt: skip
_CODES: dict[str, Any] = {"d": Real | None, "q": Time | None}
_NARROW: dict[str, Any] = {"target_n": Bounded | None, "t_ns": Time}
_FIELDS: list[tuple[str, Any]] = [
    (field.name, _NARROW.get(field.name) or _CODES.get(field.code, Count))
    for field in RECORD.fields
    if field.name not in _REPLACED
]
_Recorded: Any = built(
    msgspec.defstruct(
        "_Recorded",
        _PEOPLE
        + [field for field in _FIELDS if field[0] in _SHOWN]
        + _NAMES
        + [(name, kind | None, None) for name, kind in _FIELDS if name not in _SHOWN],
        bases=(_Derived,),
        kw_only=True,
    )
)


_NoRecord: Any = built(
    msgspec.defstruct("_NoRecord", [(name, Word | None, None) for name, *_ in _NAMES], bases=(_AnyState,))
)
"""A state without a record."""


@built
class _Event(msgspec.Struct):
    source: Literal["loop", "gateway"]
    seq: Count
    t_ns: Time
    wall_ns: Time
    severity: Literal["info", "warning", "error"]
    kind: Word
    text: Line
    stream: Count = 0
    a: Count = 0
    b: Count = 0
    value: Real | None = None
    limit: Real | None = None
    about: Line = ""
    fields: dict[Word, Line | Real | bool | None] = {}
    operator: Line = ""
    other: Line = ""
    reason: Line = ""


class _Cylinder(msgspec.Struct):
    stroke_min_mm: Bounded | None = None
    stroke_max_mm: Bounded | None = None


class _Safety(msgspec.Struct):
    tension_high_n: Real | None = None
    tension_low_n: Real | None = None


class _Tension(msgspec.Struct):
    target_min_n: Bounded | None = None
    target_max_n: Bounded | None = None


class _Loop(msgspec.Struct):
    rate_hz: Annotated[float, Meta(gt=0, le=1e6)] | None = None


class _Limit(msgspec.Struct):
    signal: Line
    action: Line
    low: Real | None = None
    high: Real | None = None


class _Settings(msgspec.Struct):
    rig: Line = ""
    cylinder: _Cylinder | None = None
    safety: _Safety | None = None
    tension: _Tension | None = None
    loop: _Loop | None = None
    limits: Annotated[list[_Limit], Meta(max_length=256)] | None = None


@built
class _ActiveMessage(msgspec.Struct):
    settings: _Settings
    version: Line = ""


@built
class _Answer(msgspec.Struct, kw_only=True):
    accepted: bool
    text: Line
    verb: Line = ""
    operator: Line = ""
    reason: Line = ""
    checks: Lines = []
    waived: dict[str, Line] = {}
    mode: Word | None = None
    t_ns: Time = 0
    value: Real | None = None
    entry: dict[str, Any] = {}
    lease: _LeaseShown | None = None


@built
class _Refusal(_Answer):
    accepted: bool = False


_Shape = TypeVar("_Shape")


def _checked(payload: bytes, longest: int) -> Any:
    """The decoded JSON, with printable text only."""
    if len(payload) > longest:
        raise MessageRefusedError(f"found {len(payload)} bytes, expected at most {longest}")
    try:
        return cleaned(msgspec.json.decode(payload))
    except RecursionError:
        raise MessageRefusedError(f"found more than {DEPTH} levels, expected at most {DEPTH}") from None
    except (msgspec.MsgspecError, UnicodeError) as error:
        raise MessageRefusedError(on_one_line(str(error))) from None


def _of(value: Any, shape: type[Any]) -> Any:
    try:
        msgspec.convert(value, shape)
    except msgspec.ValidationError as error:
        raise MessageRefusedError(on_one_line(str(error))) from None
    return value


def cleaned(value: Any, depth: int = DEPTH) -> Any:
    """A JSON value with printable text: control characters, line ends and the like are escaped.

    Raises:
        MessageRefusedError: it has more than ``depth`` levels.
    """
    if isinstance(value, str):
        return value if value.isprintable() else printable(value)
    if not isinstance(value, dict | list):
        return value
    if depth == 0:
        raise MessageRefusedError(f"found more than {DEPTH} levels, expected at most {DEPTH}")
    if isinstance(value, dict):
        return {cleaned(key): cleaned(item, depth - 1) for key, item in value.items()}
    return [cleaned(item, depth - 1) for item in value]


def message(payload: bytes) -> Message:
    """Any JSON object. This and the following functions raise MessageRefusedError for any other payload."""
    found: Message = _of(_checked(payload, LONGEST_MESSAGE), dict[str, Any])
    return found


def state(payload: bytes) -> Message:
    """A state message."""
    found = message(payload)
    return _of(found, _NoRecord if found.get("mode") is None else _Recorded)  # type: ignore[no-any-return]


def event(payload: bytes) -> Message:
    """An event of the loop or a note of the gateway."""
    return _of(message(payload), _Event)  # type: ignore[no-any-return]


def past_events(payload: bytes) -> list[Message]:
    """The answer of ``events/past``."""
    return _of(_checked(payload, LONGEST_PAST), list[_Event])  # type: ignore[no-any-return]


def active(payload: bytes) -> Message:
    """The active configuration."""
    return _of(_checked(payload, LONGEST_DOCUMENT), _ActiveMessage)  # type: ignore[no-any-return]


def document(payload: bytes) -> Message:
    """A JSON object of the length of ``meta/schema``; its fields are checked where they are used."""
    return _of(_checked(payload, LONGEST_DOCUMENT), dict[str, Any])  # type: ignore[no-any-return]


def answer(payload: bytes) -> Message:
    """The answer to a command."""
    return _of(message(payload), _Answer)  # type: ignore[no-any-return]


def refusal(payload: bytes) -> Message:
    """An error reply, as a refusing answer."""
    return {**_of(message(payload), _Refusal), "accepted": False}
