"""EDS files (CiA 306), read and checked before any process starts, so that a bad file is reported as such.

Only the objects that a start uses are read (`rigctl.devices.needed_objects`): what else a vendor's file has, lacks or
has wrong does not matter. Of those the file says whether the device has them, their names, and their width, which must
be that of the profile.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field

from rigctl.config import input_file
from rigctl.config.one_line import on_one_line
from rigctl.config.settings import RigSettings
from rigctl.devices.needed_objects import Needed, needed

LARGEST_BYTES = 4 << 20
_SHOWN = 8
_OBJECT = re.compile(r"([0-9a-f]{1,4})(?:sub([0-9a-f]{1,2}))?", re.IGNORECASE)
_LINE_END = re.compile(r"\r\n|\r|\n")
_COMMENT = re.compile(r"(?:^|\s);.*")
_UNSIGNED8 = 0x05
_VARIABLE, _DIVIDED = 0x07, frozenset({0x08, 0x09})  # object types: variable; array and record
_TYPES = {
    0x01: "BOOLEAN", 0x02: "INTEGER8", 0x03: "INTEGER16", 0x04: "INTEGER32", 0x05: "UNSIGNED8", 0x06: "UNSIGNED16",
    0x07: "UNSIGNED32", 0x08: "REAL32", 0x09: "VISIBLE_STRING", 0x0A: "OCTET_STRING", 0x0B: "UNICODE_STRING",
    0x0C: "TIME_OF_DAY", 0x0D: "TIME_DIFFERENCE", 0x0F: "DOMAIN", 0x10: "INTEGER24", 0x11: "REAL64", 0x15: "INTEGER64",
    0x16: "UNSIGNED24", 0x1B: "UNSIGNED64",
}  # fmt: skip
_BYTES = {0x01: 1, 0x02: 1, 0x03: 2, 0x04: 4, 0x05: 1, 0x06: 2, 0x07: 4}
"""Of the types that an object which we use may have; CiA 301."""
_OF_CODE = {"?": 0x01, "b": 0x02, "h": 0x03, "i": 0x04, "B": 0x05, "H": 0x06, "I": 0x07}


class EdsError(ValueError):
    """A file that is no EDS file, or not of this device; ``str()`` is one line that names it."""


@dataclass(frozen=True)
class EdsObject:
    """An object that a device has; ``code`` is its struct code by the profile."""

    index: int
    sub: int
    name: str
    code: str

    @property
    def size(self) -> int:
        """Bytes of its value."""
        return struct.calcsize("<" + self.code)

    @property
    def type_name(self) -> str:
        """Its type in words, as in CiA 301."""
        return type_name(self.code)


@dataclass
class _Section:
    """A section of the file; keys in lower case, with line and value."""

    title: str
    line: int
    values: dict[str, tuple[int, str]] = field(default_factory=dict)
    again: int = 0
    """Line of a second section of the same object, or of a second value of a key; 0 = none."""


Sections = dict[tuple[int, int | None], _Section]


def check(settings: RigSettings) -> None:
    """Read the EDS file of every CANopen device.

    Raises:
        EdsError: the first file that cannot be read, or cannot be the device's.
    """
    for section in settings.canopen_nodes:
        read(settings, section)


def read(settings: RigSettings, section: str) -> Mapping[tuple[int, int], EdsObject]:
    """The objects that a start uses and the device of ``section`` has, by index and sub-index.

    Raises:
        EdsError: the file cannot be read, lacks objects that the start cannot do without, or has one of another width.
    """
    path = settings.file(getattr(settings, section).eds)
    try:
        data = input_file.read(path, largest=LARGEST_BYTES, links=True)
    except OSError as error:
        raise EdsError(f"{path}: cannot be read: {error.strerror}") from None
    sections = _sections(input_file.text(data))
    if not sections:
        raise EdsError(f"{path}: found no objects, expected an EDS file as in CiA 306")
    try:
        return _objects(sections, needed(settings, section), f"{section}.eds")
    except _FindingError as error:
        raise EdsError(f"{path}{error}") from None


class _FindingError(ValueError):
    """What is wrong: ``:LINE: ...`` or ``: ...``, to be written behind the file's name."""


def _objects(
    sections: Sections, wanted: Mapping[tuple[int, int], Needed], key: str
) -> dict[tuple[int, int], EdsObject]:
    found: dict[tuple[int, int], EdsObject] = {}
    missing, others = [], []
    divided = {index for index, sub in sections if sub is not None}
    for (index, sub), need in wanted.items():
        where = f"0x{index:04X}:{sub:02X}"
        entry = _entry(sections, index, sub, divided=index in divided)
        if entry is None:
            missing += [where] if need.required else []
            continue
        name, kind = entry
        if _BYTES.get(kind) != struct.calcsize("<" + need.code):
            others.append(f"{where} as {_TYPES.get(kind, f'type 0x{kind:04X}')}, expected {type_name(need.code)}")
        found[index, sub] = EdsObject(index, sub, name, need.code)
    words = []
    if missing:
        many = len(missing) > 1
        what = f"all {len(missing)} (a start uses them)" if many else "it (a start uses it)"
        words.append(f"found no object{'s' if many else ''} {_listed(missing)}, expected {what}")
    if others:
        words.append(f"found {_listed(others, '; ')}")
    if words:
        raise _FindingError(f": {key}: {'; '.join(words)}")
    return found


def type_name(code: str) -> str:
    """CiA 301's name of a type with this struct code."""
    return _TYPES[_OF_CODE[code]]


def _listed(items: list[str], mark: str = ", ") -> str:
    return mark.join(items[:_SHOWN]) + (f"{mark}and {len(items) - _SHOWN} more" if len(items) > _SHOWN else "")


def _sections(text: str) -> Sections:
    """The sections of objects; lines that are nothing are passed over, as are sections that are none of an object."""
    found: Sections = {}
    section = None
    for number, raw in enumerate(_LINE_END.split(text), 1):
        line = _COMMENT.sub("", raw).strip()
        if line.startswith("[") and line.endswith("]"):
            title = line[1:-1].strip()
            section = None
            if named := _OBJECT.fullmatch(title):
                key = int(named[1], 16), None if named[2] is None else int(named[2], 16)
                if key in found:
                    found[key].again = number
                section = found.setdefault(key, _Section(title, number))
        elif section is not None and "=" in line:
            name, _, value = (part.strip() for part in line.partition("="))
            before = section.values.setdefault(name.lower(), (number, value))
            if before[1] != value and name.lower() == "datatype":
                section.again = number
    return found


def _entry(sections: Sections, index: int, sub: int, *, divided: bool) -> tuple[str, int] | None:
    """Name and data type of an object; None: the file has no such object. ``divided``: it has sub-indices.

    Raises:
        _FindingError: its section cannot be read.
    """
    own, head = sections.get((index, sub)), sections.get((index, None))
    if own is not None:
        return _name(own), _number(own, "DataType")
    if head is None:
        return None
    if most := _number(head, "CompactSubObj", 0):  # sub-indices without sections of their own
        kind = _number(head, "DataType") if sub else _UNSIGNED8
        return (_name(head), kind) if sub <= most else None
    divided = divided or _number(head, "ObjectType", _VARIABLE) in _DIVIDED
    return None if sub or divided else (_name(head), _number(head, "DataType"))


def _name(section: _Section) -> str:
    return on_one_line(section.values.get("parametername", (0, ""))[1])


def _number(section: _Section, key: str, default: int | None = None) -> int:
    """A number: decimal, hexadecimal with 0x, or octal with a leading 0, as in CiA 306."""
    if section.again:
        raise _FindingError(f":{section.again}: [{section.title}]: found it again, expected it once")
    line, value = section.values.get(key.lower(), (section.line, ""))
    if not value and default is not None:
        return default
    if not value:
        raise _FindingError(f":{line}: [{section.title}]: found no {key}, expected a number as in CiA 306")
    try:
        return int(value, 8 if re.fullmatch("0[0-7]+", value) else 0)
    except ValueError:
        found = f"{key} {on_one_line(value)}"
        raise _FindingError(f":{line}: [{section.title}]: found {found}, expected a number as in CiA 306") from None
