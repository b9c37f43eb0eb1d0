"""Changes of an EDS file, each of a kind that users of other projects have reported (CiA 306)."""

from __future__ import annotations

import random
import re
from collections.abc import Callable
from dataclasses import dataclass

from tests.builders.paths import ROOT

_TYPES = ("0x0001", "0x0002", "0x0003", "0x0004", "0x0005", "0x0006", "0x0007", "0x0008", "0x0009", "0x000F", "0x0015")


@dataclass(frozen=True)
class Section:
    """A section of an EDS file: its name and its lines, the blank ones included."""

    name: str
    lines: tuple[str, ...]

    def __str__(self) -> str:
        return "\n".join((f"[{self.name}]", *self.lines))


Sections = list[Section]
Change = Callable[[Sections, random.Random], Sections | bytes]


def sections(text: str) -> Sections:
    """The sections of an EDS file, in order."""
    found: Sections = []
    for line in text.splitlines():
        if line.startswith("["):
            found.append(Section(line[1:-1], ()))
        else:
            found[-1] = Section(found[-1].name, (*found[-1].lines, line))
    return found


def joined(parts: Sections) -> str:
    """The text of an EDS file."""
    return "\n".join(map(str, parts)) + "\n"


def _place(parts: Sections, chance: random.Random, like: str = r"[0-9A-F]{4}(sub[0-9A-F]+)?") -> int:
    return chance.choice([i for i, part in enumerate(parts) if re.fullmatch(like, part.name)])


def _with(parts: Sections, at: int, *new: Section) -> Sections:
    return [*parts[:at], *new, *parts[at + 1 :]]


def _relined(parts: Sections, at: int, pattern: str, by: str) -> Sections:
    part = parts[at]
    return _with(parts, at, Section(part.name, tuple(re.sub(pattern, by, line) for line in part.lines)))


def _pdo_without_its_mapping(parts: Sections, chance: random.Random) -> Sections:
    new = chance.choice(("1405", "1802", "1803", "19FF"))
    head = Section(new, ("ParameterName=PDO communication parameter", "ObjectType=0x9", "SubNumber=2"))
    subs = [
        Section(f"{new}sub{i}", ("ParameterName=x", "ObjectType=0x7", f"DataType={kind}", "AccessType=rw"))
        for i, kind in enumerate(("0x0005", "0x0007"))
    ]
    return [*(part for part in parts if not part.name.startswith(f"1A{new[2:]}")), head, *subs]


def _mapping_is_missing(parts: Sections, chance: random.Random) -> Sections:
    index = chance.choice(("1A00", "1A01", "1600", "1800", "1400"))
    return [part for part in parts if not part.name.startswith(index)]


def _other_type(parts: Sections, chance: random.Random) -> Sections:
    typed = [i for i, part in enumerate(parts) if any(line.startswith("DataType") for line in part.lines)]
    return _relined(parts, chance.choice(typed), r"^DataType=.*", f"DataType={chance.choice(_TYPES)}")


def _object_is_missing(parts: Sections, chance: random.Random) -> Sections:
    name = parts[_place(parts, chance, "[0-9A-F]{4}")].name
    return [part for part in parts if not part.name.startswith(name)]


def _sub_index_is_missing(parts: Sections, chance: random.Random) -> Sections:
    return _with(parts, _place(parts, chance, "[0-9A-F]{4}sub.*"))


def _few_objects(parts: Sections, chance: random.Random) -> Sections:
    kept = {parts[_place(parts, chance)].name for _ in range(chance.choice((1, 3)))}
    return [part for part in parts if not re.match("[0-9A-F]{4}", part.name) or part.name in kept]


def _of_another_device(_parts: Sections, chance: random.Random) -> bytes:
    files = ("cylinder_drive", "inclinometer", "io_node", "simulator", "tension_amplifier", "stock_drive")
    return (ROOT / f"config/eds/{chance.choice(files)}.eds").read_bytes()


def _empty_value(parts: Sections, chance: random.Random) -> Sections:
    key = chance.choice(("PDOMapping", "PDOMapping", "AccessType", "DataType", "ObjectType", "DefaultValue"))
    return _relined(parts, _place(parts, chance), rf"^{key}=.*", f"{key}=")


def _no_number(parts: Sections, chance: random.Random) -> Sections:
    key, value = chance.choice(("DataType", "ObjectType", "SubNumber")), chance.choice(("x", "7h", "0x", "UNSIGNED32"))
    return _relined(parts, _place(parts, chance), rf"^{key}=.*", f"{key}={value}")


def _octal_number(parts: Sections, chance: random.Random) -> Sections:
    return _relined(parts, _place(parts, chance), r"^(\w+Type)=0x0*", r"\1=000")


def _key_is_missing(parts: Sections, chance: random.Random) -> Sections:
    at = _place(parts, chance)
    key = chance.choice(("ObjectType", "DataType", "AccessType", "PDOMapping", "ParameterName", "SubNumber"))
    return _with(parts, at, Section(parts[at].name, tuple(x for x in parts[at].lines if not x.startswith(key))))


def _encoding(parts: Sections, chance: random.Random) -> bytes:
    name = chance.choice(("latin-1", "cp1252", "cp1250", "utf-8", "utf-8-sig", "utf-16", "shift-jis"))
    word = "力" if name == "shift-jis" else "Müller"
    return joined(parts).replace("CreatedBy=", f"CreatedBy={word} ").encode(name)


def _letter_case(parts: Sections, chance: random.Random) -> Sections:
    change = chance.choice((str.upper, str.lower, lambda name: name.replace("sub", "Sub")))
    return [Section(change(part.name), part.lines) for part in parts]


def _keys_in_another_case(parts: Sections, _chance: random.Random) -> Sections:
    return [
        Section(part.name, tuple(re.sub(r"^\w+", lambda m: m[0].lower(), line) for line in part.lines))
        for part in parts
    ]


def _line_ends(parts: Sections, chance: random.Random) -> bytes:
    end = chance.choice(("\r\n", "\r", " \n", "\t\r\n", "\n\n"))
    return joined(parts).replace("\n", end).encode()


def _spaces(parts: Sections, _chance: random.Random) -> bytes:
    return re.sub(r"(?m)^(\w+)=", r" \1 = ", joined(parts)).encode()


def _comments(parts: Sections, chance: random.Random) -> bytes:
    return re.sub(r"(?m)^(DataType=\S+)$", rf"; next\n\1 {chance.choice(';#')} type", joined(parts)).encode()


def _other_object_type(parts: Sections, chance: random.Random) -> Sections:
    kind = chance.choice(("0x2", "0x7", "0x8", "0x9", "7", "0x5"))
    return _relined(parts, _place(parts, chance), r"^ObjectType=.*", f"ObjectType={kind}")


def _doubled(parts: Sections, chance: random.Random) -> Sections:
    at = _place(parts, chance)
    again = parts[at]
    if chance.random() < 0.5:
        (again,) = _relined([again], 0, r"^DataType=.*", "DataType=0x0006")
    return [*parts, again]


def _compact(parts: Sections, chance: random.Random) -> Sections:
    """An object of sub-indices without sections of their own (CiA 306, CompactSubObj)."""
    at = _place(parts, chance, "1018|1A0[01]|1600|1003")
    name = parts[at].name
    body = ("ParameterName=compact", "ObjectType=0x8", "DataType=0x0007", "AccessType=rw", "CompactSubObj=8")
    return [part for part in _with(parts, at, Section(name, body)) if not part.name.startswith(f"{name}sub")]


def _cut_off(parts: Sections, chance: random.Random) -> bytes:
    text = joined(parts).encode()
    return text[: chance.randrange(len(text))]


def _lines_of_something_else(parts: Sections, chance: random.Random) -> Sections:
    at = _place(parts, chance)
    line = chance.choice(("just words", "=0", "<xml/>", "DataType", "x" * 9000))
    return _with(parts, at, Section(parts[at].name, (*parts[at].lines, line)))


CHANGES: tuple[Change, ...] = (
    _pdo_without_its_mapping, _mapping_is_missing, _other_type, _object_is_missing, _sub_index_is_missing, _few_objects,
    _of_another_device, _empty_value, _no_number, _octal_number, _key_is_missing, _encoding, _letter_case,
    _keys_in_another_case, _line_ends, _spaces, _comments, _other_object_type, _doubled, _compact, _cut_off,
    _lines_of_something_else,
)  # fmt: skip
