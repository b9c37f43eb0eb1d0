"""Each field of the snapshot has one writer."""

from __future__ import annotations

import ast
import collections
from dataclasses import is_dataclass

from rigctl.control.snapshot import Snapshot
from tests.builders import observers
from tests.builders.paths import ROOT
from tests.builders.rig_bench import SETTINGS

FIELDS = frozenset(Snapshot.__slots__)
GROUPS = {name for name in FIELDS if is_dataclass(getattr(Snapshot(), name))}
LIVE = GROUPS | {"heartbeats_t_ns", "node_states"}  # given to the constructor: the inbox's and the detectors' own


def _assigned(tree: ast.AST) -> list[str]:
    """Fields assigned through a name or attribute called ``snapshot``."""
    found = []
    for node in ast.walk(tree):
        targets = (
            node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AugAssign) else []
        )
        for target in targets:
            for one in target.elts if isinstance(target, ast.Tuple) else [target]:
                if isinstance(one, ast.Attribute) and ast.unparse(one.value).split(".")[-1] in ("snapshot", "x"):
                    found.append(one.attr)
    return found


def test_the_observer_alone_assigns_the_fields_of_the_snapshot_each_in_one_place() -> None:
    places = collections.Counter[str]()
    for file in (ROOT / "rigctl/control").rglob("*.py"):
        fields = [name for name in _assigned(ast.parse(file.read_text())) if name in FIELDS]
        assert not fields or file.name == "observer.py", f"{file.name} assigns {fields}"
        places.update(fields)
    assert [name for name, count in places.items() if count > 1] == []
    assert set(places) | LIVE == FIELDS


def test_a_device_is_heard_while_its_newest_sample_is_not_older_than_the_limit() -> None:
    observer, inbox, _ = observers.alone(SETTINGS)
    limit_ns = SETTINGS.safety.stale_ms * 1_000_000
    inbox.cell.t_ns, inbox.drive.t_ns = 0, 1
    observer.look(limit_ns, 0)
    assert (observer.snapshot.cell_heard, observer.snapshot.drive_heard) == (True, True)
    observer.look(limit_ns + 1, 0)
    assert (observer.snapshot.cell_heard, observer.snapshot.drive_heard) == (False, True)
    observer.look(limit_ns + 2, 0)
    assert (observer.snapshot.cell_heard, observer.snapshot.drive_heard) == (False, False)
