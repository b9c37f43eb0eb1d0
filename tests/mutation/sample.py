"""A fixed random sample of small defects in the packages that have no full row.

The draw goes by names and not by position: each place at which an operator applies gets a number from the name of its
function, the operator, the text of its line and its turn among equals, and those with the lowest numbers are the
sample. A line that moves, or a module or class that is renamed, leaves it as it is; a changed line changes its own
places only.
"""

from __future__ import annotations

import ast
import hashlib
import pathlib
import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from typing import Any

from cosmic_ray.ast import ast_nodes, get_ast
from parso.python.tree import Number

from tests.mutation.mutants import Mutant, Workshop

SEED = "rigctl 12"
SIZE = 300
PACKAGES = ("rigctl/control", "rigctl/devices", "rigctl/ipc", "rigctl/gateway", "rigctl/recorder", "rigctl/commission",
            "rigctl/operations", "hil/nodes")  # fmt: skip
_ORDER, _SAME, _IS = {"Lt", "LtE", "Gt", "GtE"}, {"Eq", "NotEq"}, {"Is", "IsNot"}


class OtherNumber:
    """A number that would be wrong: one more or less where it is small, else ten times as much or a third."""

    def mutation_positions(self, node: Any) -> Iterator[Any]:
        """Each number twice."""
        if isinstance(node, Number):
            yield node.start_pos, node.end_pos
            yield node.start_pos, node.end_pos

    def mutate(self, node: Any, index: int) -> Any:
        """Replace the number."""
        value = ast.literal_eval(node.value)
        if abs(value) < 5 and isinstance(value, int):
            value += 1 if index == 0 else -1
        elif value == 0.0:
            value = 1.0 if index == 0 else -1.0
        else:
            third = value // 3 if isinstance(value, int) else value / 3
            value = 10 * value if index == 0 else third
        return Number(f" {value}", node.start_pos)


@dataclass(frozen=True)
class Place:
    """A mutant with its function, the line at which it begins (1-based) and its number in the draw."""

    mutant: Mutant
    function: str
    line: int
    column: int
    number: str


def sources_of(root: pathlib.Path, full: set[str]) -> dict[str, str]:
    """The modules to draw from, by name."""
    files = sorted(file for package in PACKAGES for file in (root / package).rglob("*.py"))
    names = {file.relative_to(root).as_posix(): file for file in files}
    return {name: file.read_text() for name, file in names.items() if name not in full}


def workshop(root: pathlib.Path, sources: dict[str, str]) -> Workshop:
    """The operators of a sample: no comparison by identity for one by value, and numbers that would be wrong."""
    everything = [file.read_text() for folder in ("rigctl", "hil") for file in sorted((root / folder).rglob("*.py"))]
    made = Workshop(sources, enums_of=everything)
    made.operators = {name: made.operators[name] for name in made.operators if _small_defect(name)}
    made.operators["OtherNumber"] = OtherNumber()
    return made


def first(made: Workshop, size: int) -> Iterator[tuple[Place, str]]:
    """The first ``size`` mutants of the draw that change the program, with their text."""
    texts = ((place, made.source_of(place.mutant)) for place in draw(made))
    return islice(((place, text) for place, text in texts if text is not None), size)


def draw(made: Workshop) -> Iterator[Place]:
    """Places in the order of the draw, one mutant of each."""
    turns: Counter[str] = Counter()
    found = sorted((place for file in made.sources for place in _places(made, file, turns)), key=lambda p: p.number)
    seen = set()
    for place in found:
        where = place.mutant.file, place.line, place.column
        if where not in seen:
            seen.add(where)
            yield place


def _places(made: Workshop, file: str, turns: Counter[str]) -> Iterator[Place]:
    source = made.sources[file]
    lines, functions = source.splitlines(), _functions(source)
    tree = get_ast(source)
    nodes = list(ast_nodes(tree))
    for name, operator in made.operators.items():
        positions = (position for node in nodes for position in _positions(operator, node))
        for occurrence, ((line, column), counts) in enumerate(positions):
            if not counts:
                continue
            function = functions[line - 1]
            text = f"{SEED}|{function}|{name}|{lines[line - 1].strip()}"
            turns[text] += 1
            number = hashlib.sha256(f"{text}|{turns[text]}".encode()).hexdigest()
            yield Place(Mutant(file, name, occurrence), function, line, column, number)


def _positions(operator: Any, node: Any) -> Iterator[tuple[tuple[int, int], bool]]:
    """Where an operator applies, and whether that is a defect: a star among parameters is no product."""
    star = node.type == "operator" and node.parent is not None and node.parent.type in ("parameters", "param")
    for position, _ in operator.mutation_positions(node):
        yield position, not star


def _functions(source: str) -> list[str]:
    """For each line the function it is in, or the class."""
    names = [""] * len(source.splitlines())
    for node in ast.walk(ast.parse(source)):  # outer before inner
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            last = node.end_lineno or node.lineno
            own = node.name if not isinstance(node, ast.ClassDef) else ""
            names[node.lineno - 1 : last] = [own] * (last - node.lineno + 1)
    return names


def _small_defect(name: str) -> bool:
    if name == "NumberReplacer":
        return False
    found = re.fullmatch(r"ReplaceComparisonOperator_(\w+)_(\w+)", name)
    return found is None or any({found[1], found[2]} <= kind for kind in (_ORDER, _SAME, _IS))
