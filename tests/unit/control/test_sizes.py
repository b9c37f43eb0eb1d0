"""What is read as a whole is short: the tick's functions, and the classes of the loop. The ceilings only go down."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from tests.builders.paths import ROOT

CONTROL = ROOT / "rigctl/control"
FUNCTION = 25
"""Lines of a function of the tick, but of the constructor, which builds its parts."""
CLASS = 300


def lines(node: ast.FunctionDef | ast.ClassDef) -> int:
    return (node.end_lineno or node.lineno) - node.lineno + 1


def classes() -> Iterator[ast.ClassDef]:
    """Those with behaviour: an enumeration is a table."""
    for file in CONTROL.rglob("*.py"):
        for node in ast.parse(file.read_text()).body:
            if isinstance(node, ast.ClassDef) and not any("Enum" in ast.unparse(base) for base in node.bases):
                yield node


def test_a_function_of_the_tick_fits_on_a_screen() -> None:
    found = ast.walk(ast.parse((CONTROL / "loop.py").read_text()))
    functions = [node for node in found if isinstance(node, ast.FunctionDef) and node.name != "__init__"]
    assert {node.name: lines(node) for node in functions if lines(node) > FUNCTION} == {}


def test_a_class_of_the_loop_has_one_subject() -> None:
    sizes = {node.name: lines(node) for node in classes()}
    assert {name: size for name, size in sizes.items() if size > CLASS} == {}


def test_the_machine_has_no_state_but_mode_fault_and_sequence() -> None:
    tree = ast.parse((CONTROL / "power/machine.py").read_text())
    machine = next(node for node in tree.body if isinstance(node, ast.ClassDef) and node.name == "Machine")
    methods = [one for one in machine.body if isinstance(one, ast.FunctionDef) and one.name != "__init__"]
    assigned = {
        ast.unparse(one)
        for method in methods
        for one in ast.walk(method)
        if isinstance(one, ast.Attribute) and isinstance(one.ctx, ast.Store)
    }
    assert assigned == {"self.mode", "self.fault", "self.sequence", "self._done"}
