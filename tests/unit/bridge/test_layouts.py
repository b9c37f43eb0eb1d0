"""The shipped layouts name topics, fields and metrics that there are."""

from __future__ import annotations

import json
import re
import subprocess
from collections.abc import Iterator
from typing import Any
from xml.etree import ElementTree

import msgspec
import pytest
from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.parser import text_string_to_metric_families

from rigctl.bridge import layouts
from rigctl.bridge.prometheus_metrics import PREFIX, RigMetrics
from rigctl.model.signals import RECORDED
from rigctl.wire.schema import schema
from tests.builders.promtool import promtool
from tests.conftest import Command

SCHEMA = schema("paper_rig")
RECORD = {field["name"] for field in SCHEMA["fast"]["record"]["fields"]}
STATE = {field["name"]: field["json"] for field in SCHEMA["state"]["fields"]}


def strings(found: Any) -> Iterator[str]:
    if isinstance(found, str):
        yield found
    elif isinstance(found, dict | list):
        for one in found.values() if isinstance(found, dict) else found:
            yield from strings(one)


def test_the_foxglove_layout_shows_what_the_bridge_offers() -> None:
    layout = json.loads(layouts.text_of(layouts.FOXGLOVE))
    paths = [text for text in strings(layout) if text.startswith("/")]
    assert len(paths) > 15
    for path in paths:
        topic, _, field = path.partition(".")
        assert topic in ("/records", "/state", "/log"), path
        if field:
            assert field in (RECORD if topic == "/records" else STATE), path
    used = {text for text in strings([layout["layout"], layout["configById"]]) if "!" in text}
    assert used == set(layout["configById"])  # every panel is on the screen, and there is none without settings


def test_the_plotjuggler_layout_shows_signals_of_a_recording() -> None:
    root = ElementTree.fromstring(layouts.text_of(layouts.PLOTJUGGLER))
    curves = [curve.get("name", "") for curve in root.iter("curve")]
    assert len(curves) > 20
    assert {re.sub("^/records/", "", name) for name in curves} <= {signal.name for signal in RECORDED}
    for splitter in root.iter("DockSplitter"):
        areas, sizes = list(splitter.iter("DockArea")), str(splitter.get("sizes")).split(";")
        assert len(areas) == len(sizes) == int(str(splitter.get("count")))
        assert sum(map(float, sizes)) == pytest.approx(1.0, abs=1e-3)


def samples() -> set[str]:
    """Names of the metrics of a rig of which everything is known."""
    metrics, registry = RigMetrics("paper_rig", SCHEMA["enums"]), CollectorRegistry()
    registry.register(metrics)
    known = {name: 1.0 for name, kind in STATE.items() if kind.startswith(("number", "integer"))}
    state: dict[str, Any] = {**known, "mode": "HOLD", "fault": None, "loop_alive": True, "causes": []}
    metrics.take(state, [], [{"source": "loop", "severity": "info"}], (1, 0))
    text = generate_latest(registry).decode()
    return {sample.name for family in text_string_to_metric_families(text) for sample in family.samples}


def expressions() -> list[str]:
    dashboard = json.loads(layouts.text_of(layouts.GRAFANA))
    return [target["expr"] for panel in dashboard["panels"] for target in panel["targets"]]


def test_the_dashboard_asks_for_metrics_that_there_are() -> None:
    asked = {name for expression in expressions() for name in re.findall(rf"{PREFIX}\w+(?={{)", expression)}
    assert len(asked) > 18
    assert asked <= samples()


def test_the_dashboards_expressions_are_prometheus_own() -> None:
    rules = [{"record": f"rule:{number}", "expr": text.replace('job=~"$job"', 'job=~".*"')}
             for number, text in enumerate(expressions())]  # fmt: skip
    text = msgspec.yaml.encode({"groups": [{"name": "dashboard", "rules": rules}]})
    checked = subprocess.run([promtool(), "check", "rules", "/dev/stdin"], input=text, capture_output=True, check=False)
    assert checked.returncode == 0, checked.stdout + checked.stderr


@pytest.mark.parametrize("tool", ["foxglove", "prometheus", "plotjuggler"])
def test_a_layout_is_printed_or_written(in_process: Command, tool: str, tmp_path: Any) -> None:
    printed = in_process("rigctl", "bridge", tool, "--layout", "-")
    assert in_process("rigctl", "bridge", tool, "--layout", tmp_path / "layout").returncode == printed.returncode == 0
    assert (tmp_path / "layout").read_text() == printed.stdout
    assert len(printed.stdout) > 1000
    missing = in_process("rigctl", "bridge", tool, "--layout", tmp_path / "none" / "layout")
    assert (missing.returncode, missing.stderr.count("\n")) == (2, 1)
