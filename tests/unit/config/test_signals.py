"""The catalogue of signals is the one place where a signal is named: what reads it follows."""

from __future__ import annotations

import pathlib
import subprocess
import sys
from operator import attrgetter

from rigctl.control.snapshot import Snapshot
from rigctl.model import signals
from rigctl.model.signals import RECORDED, SIGNALS, WATCHED

ADDED = '    Signal("winch_mm", "d", "mm", "way of the winch", limit=Reading(99, "winch_mm", "mm", "", "stroke_mm")),\n'
FOLLOWS = """
import importlib.util, pathlib, sys
import numpy as np
spec = importlib.util.spec_from_file_location("rigctl.model.signals", sys.argv[1])
module = importlib.util.module_from_spec(spec)
sys.modules[spec.name] = module
spec.loader.exec_module(module)

from rigctl.config.limits_section import LimitSettings
from rigctl.control import limits
from rigctl.model.events import Kind, worded
from rigctl.control.snapshot import Snapshot
from rigctl.ipc.record import RECORD
from rigctl.recorder import recording
from rigctl.recorder.columns import tables
from rigctl.wire.schema import schema
from tests.builders.tape import Tape, as_recorded, same

assert RECORD.dtype.names[-1] == "winch_mm"
row = schema("rig")["fast"]["record"]["fields"][-1]
assert (row["name"], row["unit"], row["description"]) == ("winch_mm", "mm", "way of the winch")
assert [field["name"] for field in schema("rig")["state"]["fields"]].count("winch_mm") == 1

limit = LimitSettings(signal="winch_mm", high=3.0, action="hold")
(bound,) = limits._rows_of(limit)
assert bound.value(Snapshot(stroke_mm=4.0)) == 4.0
assert worded(Kind.LIMIT, int(bound.fault), 0, 4.0, 3.0, bound.text).text == "limit: winch_mm above 3 mm (4 mm)"

tape = Tape(pathlib.Path(sys.argv[2]))
tape.run(50)
tape.close()
found = recording.read(*tape.files())
assert same(found.records, as_recorded(tape.held()[0]))
(column,) = [column for column in tables(found)["records"] if column.name == "winch_mm"]
assert (column.unit, column.description) == ("mm", "way of the winch")
"""


def test_names_are_given_once_and_what_a_limit_reads_is_in_the_snapshot() -> None:
    names, places = [row.name for row in RECORDED], [watch.place for watch in WATCHED.values()]
    assert len(set(names)) == len(names)
    assert len(set(places)) == len(WATCHED) == sum(row.limit is not None for row in SIGNALS)
    read = {name for watch in WATCHED.values() for name in (watch.snapshot, watch.age)} - {""}
    assert all(isinstance(value, int | float) for value in attrgetter(*read)(Snapshot()))
    assert all(watch.words for watch in WATCHED.values() if watch.age)


def test_a_new_signal_is_one_row_of_the_catalogue(tmp_path: pathlib.Path) -> None:
    """Only its value is then to be computed; schema, limits, events, recording and export follow by themselves."""
    text = pathlib.Path(signals.__file__).read_text()
    end = text.index("\n)\n# fmt: on") + 1
    catalogue = tmp_path / "signals.py"
    catalogue.write_text(text[:end] + ADDED + text[end:])
    done = subprocess.run(
        [sys.executable, "-c", FOLLOWS, str(catalogue), str(tmp_path)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
