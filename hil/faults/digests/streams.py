"""Digests of a run, one for each stream and name: numbers of enumerations by name, so that only behaviour counts."""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Callable, Iterator, Mapping
from enum import IntEnum, IntFlag
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hil.faults.digests import name_map
from hil.faults.lockstep_run import Run
from hil.wire import FRAME
from rigctl.model.checks import Check
from rigctl.model.events import Kind
from rigctl.model.faults import Fault
from rigctl.model.signals import ENUMS
from rigctl.model.states import Mode
from rigctl.model.verbs import Refusal

Digests = dict[str, dict[str, str]]
"""By stream and name."""
_DIGITS = 16
_FRAME = np.dtype([("t_ns", "<i8"), ("frame", f"V{FRAME.size}")])

_BY_NUMBER = {(Kind.NODE_STATE, "b"), (Kind.WITNESS, "a")}
"""Values of events that are hashed as numbers though they are members of an enumeration: no member of it is renamed."""
_EVENT: dict[Kind, dict[str, type[IntEnum]]] = {
    kind: {
        field.slot: field.members
        for field in kind.fields
        if field.members is not None and (kind, field.slot) not in _BY_NUMBER
    }
    for kind in Kind
}
_CAUSE_BITS = "cause_bits"
_PLACE = re.compile(rb" in [\w<>]+:\d+(?=: )")
"""Where an exception was raised, which a moved line changes."""
_TRUTH = ("tension_n", "stroke_mm", "enabled", "powered")


class HashedStreams(NamedTuple):
    """What is hashed of a run."""

    frames: npt.NDArray[Any]
    """See `frames_array`."""
    records: npt.NDArray[Any]
    events: npt.NDArray[Any]
    replies: npt.NDArray[Any]
    truth: Mapping[str, npt.NDArray[Any]]
    """Of the plant, by name."""


def digests_of(run: Run) -> Digests:
    """Digests of a run whose frames were kept."""
    truth = {name: getattr(run, name) for name in ("t_s", *_TRUTH)}
    return digests(HashedStreams(frames_array(run.frames), run.records, run.events, run.replies, truth))


def digests(streams: HashedStreams) -> Digests:
    """Digests of each stream of a run."""
    found = {
        "frames": dict(_frames(streams.frames)),
        "records": dict(_records(streams.records)),
        "events": dict(_events(streams.events)),
        "replies": dict(_replies(streams.replies)),
        "truth": {name: _digest(_plain(values)) for name, values in streams.truth.items()},
    }
    return {stream: dict(_as_compared(stream, names)) for stream, names in found.items()}


def frames_array(log: list[tuple[int, bytes]]) -> npt.NDArray[Any]:
    """The frames on the wire with their time."""
    return np.array([(t_ns, np.void(frame)) for t_ns, frame in log], _FRAME)


def _as_compared(stream: str, digests: Mapping[str, str]) -> Iterator[tuple[str, str]]:
    for name, digest in digests.items():
        if f"{stream}/{name}" not in name_map.ADDED:
            before = name_map.RENAMED.get(f"{stream}/{name}", f"{stream}/{name}")
            yield before.partition("/")[2], digest


def _frames(frames: npt.NDArray[Any]) -> Iterator[tuple[str, str]]:
    whole = np.frombuffer(frames["frame"].tobytes(), np.dtype([("id", "=u4"), ("rest", f"V{FRAME.size - 4}")]))
    for can_id in np.unique(whole["id"]):
        yield f"0x{can_id:03X}", _digest(frames[whole["id"] == can_id].tobytes())


def _records(records: npt.NDArray[Any]) -> Iterator[tuple[str, str]]:
    for name in records.dtype.names or ():
        if name == "seq":
            continue
        column = records[name]
        if name == _CAUSE_BITS:
            yield name, _digest(_named(column, _fault_bits))
        elif name in ENUMS:
            yield name, _digest(_named(column, _namer(ENUMS[name].kind)))
        else:
            yield name, _digest(_plain(column))


def _events(events: npt.NDArray[Any]) -> Iterator[tuple[str, str]]:
    added = [kind for kind in Kind if f"Kind.{kind.name}" in name_map.ADDED]
    events = events[~np.isin(events["kind"], added)]
    names = [_member(Kind(int(kind))) for kind in events["kind"]]
    yield "order", _digest(_plain(events["t_ns"]) + "\n".join(names).encode())
    for kind in sorted({Kind(int(number)) for number in events["kind"]}):
        of_kind = events[events["kind"] == kind]
        enums = _EVENT.get(kind, {})
        for field in ("a", "b", "value", "limit"):
            column = of_kind[field]
            content = _named(column, _namer(enums[field])) if field in enums else _plain(column)
            yield f"{_member(kind)}.{field}", _digest(content)
        texts = [bytes(text) for text in of_kind["text"]]
        if kind is Kind.EXCEPTION:
            texts = [_PLACE.sub(b"", text) for text in texts]
        yield f"{_member(kind)}.text", _digest(b"\n".join(texts))


def _replies(replies: npt.NDArray[Any]) -> Iterator[tuple[str, str]]:
    enums: dict[str, type[IntEnum]] = {"reason": Refusal, "mode": Mode, "cause": Fault}
    for name in replies.dtype.names or ():
        if name == "seq":
            continue
        if name == "checks":
            caused = replies["reason"] == Refusal.CAUSE_PRESENT
            content = _named(replies[name][caused], _fault_bits) + _named(replies[name][~caused], _namer(Check))
        elif name in enums:
            content = _named(replies[name], _namer(enums[name]))
        else:
            content = _plain(replies[name])
        yield name, _digest(content)


def _plain(column: npt.NDArray[Any]) -> bytes:
    """The column's bytes; a number that is not one has one form."""
    if column.dtype.kind == "f":
        column = np.where(np.isnan(column), np.nan, column)
    return np.ascontiguousarray(column).tobytes()


def _named(column: npt.NDArray[Any], name_of: Callable[[float], str]) -> bytes:
    """The column by the names of its values, whatever their numbers are."""
    values, places = np.unique(column, return_inverse=True)
    names = [name_of(value.item()) for value in values]
    ordered = sorted(set(names))
    ranks = np.array([ordered.index(name) for name in names], "<u2")
    return "\n".join(ordered).encode() + b"\n" + ranks[places].tobytes()


def _namer(kind: type[IntEnum | IntFlag]) -> Callable[[float], str]:
    """The function that names a value of an enumeration; bits by the names of those that are set."""
    known = {int(member): _member(member) for member in kind}

    def name_of(value: float) -> str:
        if issubclass(kind, IntFlag):
            return _bits(int(value), known, kind)
        return "nan" if math.isnan(value) else known.get(int(value), f"{value:g}")

    return name_of


def _bits(value: int, known: Mapping[int, str], kind: type[IntEnum | IntFlag]) -> str:
    bits = (1 << place for place in range(value.bit_length()))
    found = [known.get(bit, str(bit)) for bit in bits if value & bit]
    return "|".join(sorted(name for name in found if f"{kind.__name__}.{name}" not in name_map.ADDED))


def _fault_bits(value: float) -> str:
    return _bits(int(value), {fault.bit: _member(fault) for fault in Fault}, Fault)


def _member(member: IntEnum | IntFlag) -> str:
    """The member's name, as it was before where it is renamed."""
    own = f"{type(member).__name__}.{member.name}"
    return name_map.RENAMED.get(own, own).partition(".")[2]


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:_DIGITS]
