"""The catalogue of signals is the one place where a signal is named: what reads it follows."""

from __future__ import annotations

import pathlib
import subprocess
import sys
from operator import attrgetter

from rigctl.control.snapshot import Snapshot
from rigctl.model import signals
from rigctl.model.signals import RECORDED, SIGNALS, WATCHED

ADDED = """
    Signal("gate", "B", "", "what keeps the gate shut, see gates",
           enum=Enumeration("gates", LoadAtRest, "what keeps the gate shut"),
           shown=Shown("gate", status=46, part=66, inferred=True)),
    Signal("winch_mm", "d", "mm", "way of the winch", limit=Reading(99, "winch_mm", "mm", "", "stroke_mm"),
           device=ON_DRIVE, shown=Shown("winch", 1, status=45, watch=15, part=65, value=60, strip=50, span=5.0),
           metric=MetricRow("winch_meters", "Way of the winch.")),
"""
FOLLOWS = """
import importlib.util, pathlib, sys
import numpy as np
spec = importlib.util.spec_from_file_location("rigctl.model.signals", sys.argv[1])
module = importlib.util.module_from_spec(spec)
sys.modules[spec.name] = module
spec.loader.exec_module(module)

from rigctl.config.limits_section import LimitSettings
from rigctl.control.watch import limits
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
SHOWN = """
import msgspec, pytest
from prometheus_client import CollectorRegistry, generate_latest
from rigctl.bridge.prometheus_metrics import RigMetrics
from rigctl.cli import status
from rigctl.cli.watch_screen import Screen
from rigctl.client import shapes
from rigctl.client.rig_view import RigView
from rigctl.model.states import LoadAtRest, Mode
from rigctl.page.chart_signals import SIGNALS as CURVES, values_of
from rigctl.page.panel import state_message
from rigctl.page.picture import Picture
from rigctl.wire.state_message import Recent, TripEvents, state_of

assert schema("rig")["enums"]["gates"] == {member.name: int(member) for member in LoadAtRest}
record = np.zeros(1, RECORD.dtype)
for name, value in {"t_ns": 1, "mode": Mode.HOLD, "gate": LoadAtRest.BOTH, "winch_mm": 7.25}.items():
    record[name] = value
beside = {"rig": "rig", "warnings": [], "lease": None}
sent = {**state_of(record[0], TripEvents(), Recent(), 1, 1), **beside}
assert (sent["gate"], sent["gate_code"]) == ("BOTH", LoadAtRest.BOTH)
state = shapes.state(msgspec.json.encode(sent))
for wrong in ({"gate": 4}, {"winch_mm": "7"}):
    with pytest.raises(shapes.MessageRefusedError):
        shapes.state(msgspec.json.encode({**sent, **wrong}))

labels = {label: text for label, text, _ in status.rows(state)}
assert (labels["winch"], labels["gate"]) == ("7.2 mm", LoadAtRest.BOTH.words)
order = list(labels)
assert order.index("stroke") < order.index("winch") < order.index("gate") < order.index("inclination")
view = RigView("tcp/127.0.0.1:1", "rig")
view.take_state(state)
assert any(line.plain.split() == ["winch", "7.2", "mm"] for line in Screen(view).lines(80, 60))
picture = Picture(view.endpoint)
picture.take_state(state)
page = state_message(picture, False)
parts = {row["name"]: (row["text"], row["sure"]) for row in page["devices"]}
assert (parts["winch"], parts["gate"]) == (("7.2 mm", True), (LoadAtRest.BOTH.words, False))
assert {"name": "winch_mm", "label": "winch", "text": "7.2 mm", "doubt": None} in page["figures"]
assert page["values"]["winch_mm"] == values_of(record)[0, [one.name for one in CURVES].index("winch_mm")] == 7.25
state["quality"]["drive"] = "stale"
assert dict(row[:2] for row in status.rows(state))["winch"] == "- (stale)"
metrics, registry = RigMetrics("rig", schema("rig")["enums"]), CollectorRegistry()
registry.register(metrics)
metrics.take(state, [], [], (1, 0))
assert "rigctl_winch_meters 0.00725" in generate_latest(registry).decode().splitlines()
"""


def test_names_are_given_once_and_what_a_limit_reads_is_in_the_snapshot() -> None:
    names, places = [row.name for row in RECORDED], [watch.place for watch in WATCHED.values()]
    assert len(set(names)) == len(names)
    assert len(set(places)) == len(WATCHED) == sum(row.limit is not None for row in SIGNALS)
    read = {name for watch in WATCHED.values() for name in (watch.snapshot, watch.age)} - {""}
    assert all(isinstance(value, int | float) for value in attrgetter(*read)(Snapshot()))
    assert all(watch.words for watch in WATCHED.values() if watch.age)


def test_a_new_signal_is_one_row_of_the_catalogue(tmp_path: pathlib.Path) -> None:
    """Only its value is then to be computed; wire, limits, events, recording, export and displays follow."""
    text = pathlib.Path(signals.__file__).read_text()
    end = text.index("\n)\n# fmt: on") + 1
    catalogue = tmp_path / "signals.py"
    catalogue.write_text(text[:end] + ADDED + text[end:])
    done = subprocess.run(
        [sys.executable, "-c", FOLLOWS + SHOWN, str(catalogue), str(tmp_path)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
