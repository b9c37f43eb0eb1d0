"""Every name of a library that the source reads exists in the version installed.

mypy passes over the names of an untyped library, and no test reaches each ``except`` and each branch. A chain of names
is followed through modules, classes and functions, and ends at the first instance. A name that its scope binds in
another way as well, as a parameter does, is passed over.
"""

from __future__ import annotations

import ast
import importlib
import sys
import types
from collections.abc import Iterator
from typing import Any

import pytest

from tests.builders.paths import ROOT

FOLDERS = ("rigctl", "hil", "tests", "deploy")
OWN = {*FOLDERS, "sbom"}
"""Modules of the project: mypy knows their names."""
ABSENT = {"cosmic_ray", "parso"}
"""Modules of the extra ``mutation``, which the extra ``dev`` does not bring."""
SCOPES = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)
STATIC = (types.ModuleType, type, types.FunctionType, types.BuiltinFunctionType)
BINDS = {
    **dict.fromkeys((*SCOPES, ast.ExceptHandler, ast.MatchAs, ast.MatchStar), "name"),
    ast.arg: "arg",
    ast.MatchMapping: "rest",
}
"""By kind of node: its field with the name that it binds; a name that is assigned to is another."""

Imported = dict[str, list[Any]]
"""What each name may be that imports of libraries alone bind."""


class NoSuchNameError(Exception):
    """A library does not have a name."""


def module(name: str) -> Any:
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        raise NoSuchNameError(f"there is no module {error.name}") from None


def attribute(owner: Any, name: str) -> Any:
    try:
        return getattr(owner, name)
    except AttributeError:
        raise NoSuchNameError(f"{owner.__name__} has no {name}") from None


def named_by(statement: ast.Import | ast.ImportFrom, alias: ast.alias) -> tuple[str, list[Any]]:
    """The name that one part of an import binds, and what to; nothing where the module is not looked into."""
    source = alias.name if isinstance(statement, ast.Import) else "." * statement.level + (statement.module or "")
    top = source.partition(".")[0]
    name = alias.asname or (top if isinstance(statement, ast.Import) else alias.name)
    if top in {"", *OWN, *ABSENT}:
        return name, []
    found = module(source)
    if isinstance(statement, ast.Import):
        return name, [found if alias.asname else sys.modules[top]]
    if hasattr(found, "__path__") and not hasattr(found, alias.name):
        return name, [module(f"{source}.{alias.name}")]
    return name, [attribute(found, alias.name)]


def nodes_of(scope: ast.AST) -> Iterator[ast.AST]:
    """Every node of a scope; of each scope within it the first alone."""
    left = [*ast.iter_child_nodes(scope)]
    while left:
        yield (node := left.pop())
        if not isinstance(node, SCOPES):
            left.extend(ast.iter_child_nodes(node))


def objects(node: ast.expr, names: Imported) -> list[Any]:
    """What a chain of names may be; nothing where that is known at run time alone."""
    if isinstance(node, ast.Name):
        return names.get(node.id, [])
    if not isinstance(node, ast.Attribute) or not isinstance(node.ctx, ast.Load):
        return []
    return [attribute(owner, node.attr) for owner in objects(node.value, names) if isinstance(owner, STATIC)]


def wrong_names(scope: ast.AST, around: Imported) -> Iterator[tuple[int, str]]:
    """Line and words of each name that a library does not have; ``around``: the names of the scopes around this one."""
    imports: Imported = {}
    others: set[str | None] = set()
    nodes = list(nodes_of(scope))
    for node in nodes:
        if isinstance(node, ast.Import | ast.ImportFrom):
            for alias in node.names:
                try:
                    name, found = named_by(node, alias)
                except NoSuchNameError as error:
                    yield node.lineno, str(error)
                else:
                    imports.setdefault(name, []).extend(found)
        elif isinstance(node, ast.Name) and not isinstance(node.ctx, ast.Load):
            others.add(node.id)
        elif type(node) in BINDS:
            others.add(getattr(node, BINDS[type(node)]))
    names = {name: found for name, found in {**around, **imports}.items() if name not in others}
    for node in nodes:
        if isinstance(node, SCOPES):
            yield from wrong_names(node, around if isinstance(scope, ast.ClassDef) else names)
        elif isinstance(node, ast.Attribute):
            try:
                objects(node, names)
            except NoSuchNameError as error:
                yield node.lineno, str(error)


def found_in(source: str) -> list[str]:
    return [f"{line}: {words}" for line, words in sorted(set(wrong_names(ast.parse(source), {})))]


def test_every_name_of_a_library_exists() -> None:
    files = sorted(file for folder in FOLDERS for file in (ROOT / folder).rglob("*.py"))
    wrong = [f"{file.relative_to(ROOT)}:{line}" for file in files for line in found_in(file.read_text())]
    assert wrong == []


@pytest.mark.parametrize(
    ("source", "finding"),
    [
        ("import canopen\ntry:\n    pass\nexcept canopen.sdo.SdoError:\n    pass", "4: canopen.sdo has no SdoError"),
        ("from canopen.sdo import SdoClient, SdoError", "1: there is no module canopen.sdo.SdoError"),
        ("from canopen import nothing", "1: there is no module canopen.nothing"),
        ("import canopen.nothing", "1: there is no module canopen.nothing"),
        ("def f():\n    import numpy as np\n    np.linalg.nothing.more()", "3: numpy.linalg has no nothing"),
        ("from can import Message\ndef f(x=Message.nothing): ...", "2: Message has no nothing"),
        ("import can\nclass A:\n    can = 0\n    def f(self):\n        can.nothing", "5: can has no nothing"),
        ("import can.bus\ndef f():\n    def g():\n        can.nothing", "4: can has no nothing"),
    ],
)
def test_a_name_that_does_not_exist_is_found(source: str, finding: str) -> None:
    assert found_in(source) == [finding]


@pytest.mark.parametrize(
    "source",
    [
        "import canopen.sdo.exceptions\ncanopen.sdo.exceptions.SdoError",
        "from canopen import sdo\nsdo.SdoClient.RESPONSE_TIMEOUT.nothing",
        "import numpy as np\nnp.pi.nothing",
        "import can\ncan.nothing = 0",
        "import can\ndef f(can):\n    can.nothing",
        "import can\ndef f():\n    for can in ():\n        can.nothing",
        "import can\ndef f():\n    return [can.nothing for can in ()]",
        "import can\ndef f():\n    try:\n        pass\n    except OSError as can:\n        can.nothing",
        "import can\ndef f(x):\n    match x:\n        case [*can]:\n            can.nothing",
        "import control\ndef f():\n    from rigctl import control\n    control.nothing",
        "from . import can\ncan.nothing",
    ],
)
def test_a_name_that_is_known_at_run_time_alone_is_passed_over(source: str) -> None:
    assert found_in(source) == []
