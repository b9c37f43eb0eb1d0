"""``rigctl bridge prometheus`` on a real gateway: read by the library's parser, and checked by ``promtool``."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import urllib.error
import urllib.request
from collections.abc import Iterator

import pytest
from prometheus_client import Metric
from prometheus_client.openmetrics.parser import text_fd_to_metric_families as openmetrics
from prometheus_client.parser import text_string_to_metric_families

from rigctl.model.states import Mode
from tests.builders.miniature import Daemon
from tests.builders.paths import ROOT
from tests.builders.promtool import promtool
from tests.builders.waiting import patience_s, until


class PrometheusBridge:
    """The command in a process of its own."""

    def __init__(self, daemon: Daemon) -> None:
        command = [sys.executable, "-m", "rigctl", "bridge", "prometheus", "--listen", "127.0.0.1:0"]
        self.process = subprocess.Popen(
            command, cwd=ROOT, env=daemon.environment(), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        found = re.match(r"prometheus: (http://127\.0\.0\.1:\d+/metrics), paper_rig at ", line)
        assert found, line
        self.url = found[1]

    def text(self, accept: str = "text/plain") -> str:
        with urllib.request.urlopen(
            urllib.request.Request(self.url, headers={"Accept": accept}), timeout=patience_s()
        ) as page:
            return str(page.read().decode())

    def metrics(self) -> dict[str, Metric]:
        return {family.name: family for family in text_string_to_metric_families(self.text())}

    def value(self, family: str, **labels: str) -> float | None:
        found = self.metrics().get(family)
        samples = found.samples if found is not None else []
        return next((one.value for one in samples if labels.items() <= one.labels.items()), None)


@pytest.fixture
def served(own: Daemon) -> Iterator[PrometheusBridge]:
    bridge = PrometheusBridge(own)
    try:
        yield bridge
    finally:
        bridge.process.kill()
        bridge.process.communicate()


def test_the_metrics_are_the_rigs(own: Daemon, served: PrometheusBridge) -> None:
    until(lambda: served.value("rigctl_up") == 1, "a state")
    with own.rig() as rig:
        assert rig.command("arm", operator="kim")["accepted"]
        assert rig.command("target", 290.0, operator="kim")["accepted"]
        until(lambda: served.value("rigctl_target_newtons") == 290.0, "the target")
        until(lambda: served.value("rigctl_mode", rigctl_mode="HOLD") == 1.0, "the mode")
        state = rig.state()
    metrics = served.metrics()
    modes = {one.labels["rigctl_mode"]: one.value for one in metrics["rigctl_mode"].samples}
    assert modes == {mode.name: float(mode is Mode.HOLD) for mode in Mode}
    assert served.value("rigctl_stroke_meters") == pytest.approx(state["stroke_mm"] * 1e-3)
    assert "rigctl_error_newtons" not in {one.name for one in metrics["rigctl_error_newtons"].samples}
    assert served.value("rigctl_inclination_radians", axis="normal") is None  # NaN on the rig, and so not there
    assert served.value("rigctl_events", source="loop", severity="info")
    late = metrics["rigctl_loop_lateness_seconds"]
    buckets = [one.value for one in late.samples if one.name.endswith("_bucket")]
    count = next(one.value for one in late.samples if one.name.endswith("_count"))
    assert buckets == sorted(buckets)
    assert buckets[-1] == count > 100
    assert served.value("rigctl_bridge_records", what="lost") == 0


def test_a_silent_daemon_is_down_and_has_no_values(own: Daemon, served: PrometheusBridge) -> None:
    until(lambda: served.value("rigctl_up") == 1, "a state")
    own.kill_gateway()
    until(lambda: served.value("rigctl_up") == 0, "the silence")
    assert served.value("rigctl_tension_newtons") is None
    own.start_gateway()
    until(lambda: served.value("rigctl_up") == 1, "the next gateway")


def test_the_text_is_clean(served: PrometheusBridge) -> None:
    until(lambda: served.value("rigctl_up") == 1, "a state")
    checked = subprocess.run(
        [promtool(), "check", "metrics"], input=served.text(), capture_output=True, text=True, check=False
    )
    assert (checked.returncode, checked.stdout, checked.stderr) == (0, "", "")
    lines = iter(served.text("application/openmetrics-text; version=1.0.0").splitlines(True))
    found = list(openmetrics(lines))  # type: ignore[no-untyped-call]
    assert {family.type for family in found} >= {"gauge", "counter", "histogram", "stateset", "info"}


def test_it_ends_with_a_signal(served: PrometheusBridge) -> None:
    served.process.send_signal(signal.SIGTERM)
    _, said = served.process.communicate(timeout=patience_s())
    assert served.process.returncode == 0
    assert "Traceback" not in said
