"""Changes of a DBC file, each of a kind that users of other projects have reported."""

from __future__ import annotations

import random
import re
from collections.abc import Callable

Change = Callable[[str, random.Random], str | bytes]
_SIGNAL = re.compile(
    r" SG_ (?P<name>\w+) : (?P<start>\d+)\|(?P<length>\d+)@(?P<order>[01])(?P<sign>[+-]) "
    r'\((?P<scale>[^,]+),(?P<offset>[^)]+)\) \[(?P<range>[^\]]+)\] "(?P<unit>\w*)"'
)


def _signal(*ways: dict[str, str]) -> Change:
    """A change that gives one signal one of the ``ways``: parts of its line by name."""

    def change(text: str, chance: random.Random) -> str:
        found = chance.choice(list(_SIGNAL.finditer(text)))
        part = {**found.groupdict(), **chance.choice(ways)}
        line = (
            f" SG_ {part['name']} : {part['start']}|{part['length']}@{part['order']}{part['sign']} "
            f'({part["scale"]},{part["offset"]}) [{part["range"]}] "{part["unit"]}"'
        )
        return text[: found.start()] + line + text[found.end() :]

    return change


def _replaced(pattern: str, *ways: str) -> Change:
    """A change of one of the places that match ``pattern`` to one of ``ways``."""

    def change(text: str, chance: random.Random) -> str:
        found = chance.choice(list(re.finditer(pattern, text)))
        return text[: found.start()] + found.expand(chance.choice(ways)) + text[found.end() :]

    return change


def _each(key: str, *values: str) -> Change:
    return _signal(*({key: value} for value in values))


def _added(line: str) -> Change:
    return lambda text, _chance: f"{text}\n{line}\n"


def _encoding(text: str, chance: random.Random) -> bytes:
    name = chance.choice(("latin-1", "cp1252", "utf-8", "utf-8-sig", "utf-16"))
    return text.replace('CM_ "Two', 'CM_ "Zwei für Prüfstand, 1 °, Two').encode(name)


def _line_ends(text: str, chance: random.Random) -> bytes:
    return text.replace("\n", chance.choice(("\r\n", "\r", "\n\n"))).encode()


CHANGES: dict[str, Change] = {
    "range ends early": _signal(
        {"length": "8", "sign": "-", "scale": "0.01", "range": "0|0"}, {"length": "4", "range": "0|0"}
    ),
    "scale": _each("scale", "1e-6", "10", "-0.01", "0", "1e400", "1e-320"),
    "offset": _each("offset", "90", "-2000", "1e308", "-1e400"),
    "sign": _each("sign", "+"),
    "declared range": _each("range", "-1.27|1.27", "0|1", "5|-5", "0|0"),
    "byte order": _signal({"start": "7", "order": "0"}, {"start": "0", "order": "1"}),
    "place": _each("start", "60", "3"),
    "unit": _each("unit", "", "kN", "°", "rad", "DEG", "mN"),
    "name": _replaced(r"RopeTension|AngleNormal|Inclination\b", "Other"),
    "identifier": _replaced(r"BO_ (272|273)", "BO_ 2147483920", "BO_ 388", "BO_ 128", "BO_ 3000"),
    "bytes": _replaced(r"(BO_ \d+ \w+): 5", r"\1: 4", r"\1: 8", r"\1: 12", r"\1: 0"),
    "multiplexed": _replaced(r"( SG_ \w+) :", r"\1 m0 :", r"\1 M :"),
    "cycle time": _replaced(
        r'("GenMsgCycleTime") BO_ (\d+) \d+', r"\1 BO_ \2 50", r"\1 BO_ \2 0", r"\1 BO_ \2 -5", r'\1 BO_ \2 "x"'
    ),
    "float": _added("SIG_VALTYPE_ 272 RopeTension : 1;"),
    "float of 16 bits": _added("SIG_VALTYPE_ 273 AngleTangential : 1;"),
    "encoding": _encoding,
    "cut off": lambda text, chance: text[: chance.randrange(len(text))],
    "doubled": _added('BO_ 275 Tension: 5 TensionCell\n SG_ RopeTension : 0|32@1- (0.001,0) [0|0] "N" Controller'),
    "line ends": _line_ends,
    "odd line": _replaced(r"\nBA_DEF_ ", "\nFOO_ 1;\nBA_DEF_ ", "\nBO_TX_BU_ 272 : A,B;\nBA_DEF_ ", "\n\x00BA_DEF_ "),
}
