"""Tests and studies use the parts of the loop in three places, so that a change of the parts changes these alone.

Elsewhere they read records, `hil.loop_view.LoopView`, and of the loop itself ``machine.mode`` and ``machine.fault``.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator

import pytest

from tests.builders.paths import ROOT

PLACES = {"hil/loop_view.py", "hil/faults/in_controller.py", "tests/builders/loop_changes.py"}
"""What is read; the trip of a row of the safety table; what tests change."""
PARTS = {"machine", "observer", "outbox"}
PROMISED = {"mode", "fault"}
"""Of the machine, see docs/hil-tests.md."""


def bound_to_loop(nodes: list[ast.AST]) -> set[str]:
    """Names that a loop is assigned to."""
    names = {"loop"}
    for node in nodes:
        if isinstance(node, ast.Assign):
            for target in node.targets:
                pairs = [(target, node.value)]
                if isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple):
                    pairs = list(zip(target.elts, node.value.elts, strict=False))
                names |= {a.id for a, b in pairs if isinstance(a, ast.Name) and is_loop(b, set())}
    return names


def is_loop(node: ast.expr, names: set[str]) -> bool:
    return node.attr == "loop" if isinstance(node, ast.Attribute) else isinstance(node, ast.Name) and node.id in names


def uses_of_parts(source: str) -> Iterator[int]:
    """Lines that use a part of a loop: an attribute, or its name as a string of `getattr` or ``setattr``."""
    nodes = list(ast.walk(ast.parse(source)))
    names = bound_to_loop(nodes)
    promised = {
        node.value
        for node in nodes
        if isinstance(node, ast.Attribute) and node.attr in PROMISED and isinstance(node.ctx, ast.Load)
    }
    for node in nodes:
        if isinstance(node, ast.Attribute) and is_loop(node.value, names):
            private = node.attr.startswith("_") and node.attr != "_replace"  # of a named tuple
            if private or (node.attr in PARTS and not (node.attr == "machine" and node in promised)):
                yield node.lineno
        elif isinstance(node, ast.Call) and len(node.args) > 1 and is_loop(node.args[0], names):
            function, name = node.func, node.args[1]
            called = function.attr if isinstance(function, ast.Attribute) else getattr(function, "id", "")
            part = isinstance(name, ast.Constant) and (str(name.value) in PARTS or str(name.value).startswith("_"))
            if called in ("getattr", "setattr") and part:
                yield node.lineno


def found() -> list[str]:
    files = sorted(file for folder in ("hil", "tests") for file in (ROOT / folder).rglob("*.py"))
    return [
        f"{path}:{line}"
        for file in files
        if (path := file.relative_to(ROOT).as_posix()) not in PLACES
        if re.search(r"\bloop\b", source := file.read_text())
        for line in uses_of_parts(source)
    ]


def test_no_test_and_no_study_uses_a_part_of_the_loop_but_in_its_place() -> None:
    assert found() == []


@pytest.mark.parametrize(
    ("source", "uses"),
    [
        ("rig.loop.machine.mode", 0),
        ("rig.loop.machine.fault", 0),
        ("rig.loop.machine.mode = x", 1),
        ("rig.loop.machine.sequence.action", 1),
        ("machine = rig.loop.machine", 1),
        ("a, b = rig.loop, 0\na.machine.trip()", 1),
        ("loop.observer.snapshot", 1),
        ("rig.loop.outbox", 1),
        ("self.rig.loop._orders.trial", 1),
        ("patch.setattr(rig.loop, '_decide', broken)", 1),
        ("patch.setattr(rig.loop, 'tick', tick)", 0),
        ("getattr(rig.loop, 'machine')", 1),
        ("rig.loop.law.target_n\nself.machine.sequence.action", 0),
    ],
)
def test_a_use_is_counted(source: str, uses: int) -> None:
    assert len(list(uses_of_parts(source))) == uses
