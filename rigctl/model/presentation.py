"""What a row of the catalogue of signals says of a signal to a person: names of its numbers, its lines, its metric."""

from __future__ import annotations

from enum import IntEnum, IntFlag
from typing import NamedTuple


class Enumeration(NamedTuple):
    """Names of a signal's numbers. A property ``words`` of a member is what a person reads, else its name."""

    table: str
    """In ``meta/schema``."""
    kind: type[IntEnum | IntFlag]
    named: str = ""
    """Meaning of the name, which the state message has in the number's place; "": it has the number alone."""
    none: bool = False
    """The number 0 is no value: the state message has null for it."""


class Shown(NamedTuple):
    """How a person reads a signal, and where. A place is an order among a display's lines; 0: it has no line there."""

    label: str = ""
    """"": no display shows it."""
    digits: int = 0
    sign: bool = False
    """A positive number has a plus."""
    status: int = 0
    """In ``rigctl status --all``."""
    watch: int = 0
    """In ``rigctl watch``."""
    part: int = 0
    """On the page, among the parts of the rig."""
    value: int = 0
    """On the page, among the values: struck through where it is not trusted."""
    finer: int = 0
    """Digits that the page's list of values has more."""
    strip: int = 0
    """On the page, among the strip charts."""
    span: float = 0.0
    """Of the strip's axis, at least."""
    line: str = "{}"
    """Its line in the terminal: the signal, then those ``beside`` it."""
    beside: tuple[str, ...] = ()
    style: str = ""
    """Of the line in the terminal."""
    inferred: bool = False
    """No device measures it."""


class MetricRow(NamedTuple):
    """A metric of Prometheus, in base units. Signals of one ``name`` differ in ``of``, the value of its ``label``."""

    name: str
    meaning: str
    label: str = ""
    of: str = ""
    is_counter: bool = False
