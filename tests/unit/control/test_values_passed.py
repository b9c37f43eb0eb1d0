"""What a tick's parts need of each other is passed: none assigns the attribute of another's object."""

from __future__ import annotations

import ast
import collections
import pathlib

from rigctl.ipc.record import RECORD
from tests.builders.paths import ROOT

OWN = {
    "cell_correction": {"one", "term", "two"},
    "escalation": {"since"},
    "inclination": {"kf"},
    "logbook": {"values"},
    "move_learning": {"self._lesson", "table"},
    "observer": {"snapshot"},
}
"""By module: names of the values that it makes for itself, or for others to read. The list only shrinks."""
FINDINGS = {"seen", "self.seen"}
"""Of the detector that has made them, see `rigctl.control.findings`."""
OUTSIDE = {"control_process": {"loop"}}
"""In no tick: a signal's handler."""


def assigned(function: ast.FunctionDef) -> set[str]:
    """Owners, other than self, of the attributes that a function assigns."""
    found = set()
    for node in ast.walk(function):
        targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
        for target in targets:
            for one in target.elts if isinstance(target, ast.Tuple) else [target]:
                if isinstance(node, ast.Assign | ast.AugAssign | ast.AnnAssign) and isinstance(one, ast.Attribute):
                    found.add(ast.unparse(one.value))
    return found - {"self"}


def owners(file: pathlib.Path) -> set[str]:
    text = file.read_text()
    functions = [node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.FunctionDef)]
    found = {owner for function in functions if function.name != "__init__" for owner in assigned(function)}
    return found - FINDINGS if "self.seen = " in text else found


def test_no_part_of_the_tick_assigns_what_another_part_owns() -> None:
    found = collections.defaultdict(set)
    for file in (ROOT / "rigctl/control").rglob("*.py"):
        if names := owners(file):
            found[file.stem] = names
    assert dict(found) == {**OWN, **OUTSIDE}


def test_each_signal_of_the_record_is_assigned_once_in_one_function() -> None:
    places = collections.Counter[str]()
    for node in ast.walk(ast.parse((ROOT / "rigctl/control/logbook.py").read_text())):
        if isinstance(node, ast.FunctionDef) and node.name == "record":
            for one in ast.walk(node):
                if isinstance(one, ast.Attribute) and isinstance(one.ctx, ast.Store):
                    places[one.attr] += 1
    assert places == dict.fromkeys((RECORD.dtype.names or ())[1:], 1)  # the ring counts the first, the slot's number
