"""Mutants of a module: the operators of Cosmic Ray, and two of our own for tables and laws."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
from cosmic_ray.operators.provider import OperatorProvider
from parso.python.tree import Name

_ALIKE = ({"Add", "Sub", "Mul", "Div", "FloorDiv"}, {"BitOr", "BitAnd", "BitXor", "Sub"})
ENUMS = ("Enum", "IntEnum", "StrEnum", "Flag", "IntFlag")


class OtherMember:
    """``Mode.HOLD`` becomes the next member of its enumeration; ``members`` holds them by class."""

    def __init__(self, members: dict[str, list[str]]) -> None:
        self._members = members

    def mutation_positions(self, node: Any) -> Iterator[Any]:
        """The member's name, where it follows its enumeration."""
        if isinstance(node, Name) and self._owner(node) is not None:
            yield node.start_pos, node.end_pos

    def mutate(self, node: Any, _index: int) -> Any:
        """Replace the name by another."""
        names = self._members[str(self._owner(node))]
        node.value = names[(names.index(node.value) + 1) % len(names)]
        return node

    def _owner(self, node: Any) -> str | None:
        trailer = node.parent
        if trailer is None or trailer.type != "trailer" or trailer.children[0] != ".":
            return None
        before = trailer.get_previous_sibling()
        owner = before.value if isinstance(before, Name) else ""
        return owner if node.value in self._members.get(owner, ()) else None


class Dropped:
    """A statement with only a side effect (an assignment to an attribute, a call) is left out."""

    def mutation_positions(self, node: Any) -> Iterator[Any]:
        """Assignments to attributes and items, and calls; nothing that defines a name."""
        if node.type == "expr_stmt":
            target = node.children[0]
            if target.type in ("power", "atom_expr") and len(node.children) > 2:
                yield node.start_pos, node.end_pos
        elif node.type in ("power", "atom_expr") and node.parent is not None and node.parent.type == "simple_stmt":
            yield node.start_pos, node.end_pos

    def mutate(self, node: Any, _index: int) -> Any:
        """Replace the statement by ``pass``."""
        first = node.get_first_leaf()
        return Name("pass", node.start_pos, prefix=first.prefix)


@dataclass(frozen=True)
class Mutant:
    """The ``occurrence``-th place at which ``operator`` can change ``file``."""

    file: str
    operator: str
    occurrence: int


@dataclass(frozen=True)
class Change:
    """The change of a mutant: the first line that differs, 1-based, before and after."""

    line: int
    before: str
    after: str


def members_of(sources: Iterable[str]) -> dict[str, list[str]]:
    """Members of the enumerations defined in the sources."""
    found = {}
    for source in sources:
        for node in ast.parse(source).body:
            if isinstance(node, ast.ClassDef) and any(ast.unparse(base) in ENUMS for base in node.bases):
                targets = [target for item in node.body if isinstance(item, ast.Assign) for target in item.targets]
                found[node.name] = [target.id for target in targets if isinstance(target, ast.Name)]
    return found


class Workshop:
    """Makes the mutants of some modules, given as text by name."""

    def __init__(self, sources: dict[str, str], enums_of: Iterable[str] | None = None) -> None:
        """``enums_of``: the sources in which the enumerations are, if they are others."""
        self.sources = sources
        members = members_of(sources.values() if enums_of is None else enums_of)
        provider = OperatorProvider()
        takes_none = (name for name in provider if not provider[name].arguments())
        self.operators: dict[str, Any] = {name: provider[name]() for name in takes_none if _alike(name)}
        self.operators |= {"OtherMember": OtherMember(members), "Dropped": Dropped()}

    def mutants(self, file: str) -> Iterator[Mutant]:
        """All mutants of a module."""
        nodes = list(ast_nodes(get_ast(self.sources[file])))
        for name, operator in self.operators.items():
            places = sum(1 for node in nodes for _ in operator.mutation_positions(node))
            for occurrence in range(places):
                yield Mutant(file, name, occurrence)

    def source_of(self, mutant: Mutant) -> str | None:
        """The mutant's text; None where the program stays the same: a change of annotations alone does not count."""
        before = self.sources[mutant.file]
        after: str = mutate_code(before, self.operators[mutant.operator], mutant.occurrence)
        return None if _program(after) in (None, _program(before)) else after

    def change_of(self, mutant: Mutant) -> Change:
        """The change of a mutant."""
        before, after = self.sources[mutant.file].splitlines(), (self.source_of(mutant) or "").splitlines()
        pairs = enumerate(zip(before, after, strict=False), 1)
        return next(Change(line, old.strip(), new.strip()) for line, (old, new) in pairs if old != new)


def _alike(name: str) -> bool:
    """Whether two operators are similar: a mutant that fails on its first number would only flatter the tests."""
    found = re.fullmatch(r"ReplaceBinaryOperator_(\w+)_(\w+)", name)
    return found is None or any({found[1], found[2]} <= kind for kind in _ALIKE)


def _program(source: str) -> str | None:
    """The program without annotations; None if it is not valid Python."""
    try:
        tree = ast.parse(source)
    except SyntaxError:
        return None
    for node in ast.walk(tree):
        if isinstance(node, ast.AnnAssign):
            node.annotation = ast.Constant(None)
        elif isinstance(node, ast.arg):
            node.annotation = None
        elif isinstance(node, ast.FunctionDef):
            node.returns = None
    return ast.dump(tree)
