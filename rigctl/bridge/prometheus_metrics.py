"""The rig's state as Prometheus metrics, in base units (metres, seconds), by the rules that ``promtool`` checks."""

from __future__ import annotations

import math
import threading
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
from prometheus_client.core import (
    CounterMetricFamily,
    GaugeMetricFamily,
    HistogramMetricFamily,
    InfoMetricFamily,
    Metric,
    StateSetMetricFamily,
)
from prometheus_client.registry import Collector

from rigctl import __version__
from rigctl.model.presentation import MetricRow
from rigctl.model.signals import SIGNALS

NS = 1.0e-9
_TO_BASE = {"mm": 1.0e-3, "mm/s": 1.0e-3, "ns": NS}
"""Base units by the unit of a signal; the others are base units."""
_LOST = MetricRow("gateway_samples_lost", "Records overwritten before a gateway could publish them.", is_counter=True)
BUCKETS_S = (2e-5, 5e-5, 1e-4, 1.5e-4, 2e-4, 3e-4, 5e-4, 1e-3, 2e-3, 5e-3, 2e-2)
HISTOGRAMS = {
    "loop_lateness_seconds": ("lateness_ns", "How late the loop woke for its tick."),
    "loop_work_seconds": ("work_ns", "Time that a tick took."),
}
PREFIX = "rigctl_"


class _Histogram:
    def __init__(self) -> None:
        self.counts = np.zeros(len(BUCKETS_S) + 1, np.int64)
        self.sum_s = 0.0

    def add(self, values_s: npt.NDArray[np.float64]) -> None:
        where = np.searchsorted(BUCKETS_S, values_s)  # a bucket holds its upper bound
        self.counts += np.bincount(where, minlength=len(self.counts))
        self.sum_s += float(values_s.sum())

    def buckets(self) -> list[tuple[str, float]]:
        bounds = [*(format(bound, "g") for bound in BUCKETS_S), "+Inf"]
        return list(zip(bounds, np.cumsum(self.counts).astype(float).tolist(), strict=True))


class RigMetrics(Collector):
    """Metrics of one rig. One thread adds what arrives, another collects."""

    def __init__(self, rig: str, enums: Mapping[str, Mapping[str, int]]) -> None:
        """``enums``: of the daemon's schema."""
        self._rig, self._modes, self._faults = rig, list(enums["modes"]), [n for n, v in enums["faults"].items() if v]
        self._lock = threading.Lock()
        self._state: Mapping[str, Any] | None = None
        self._histograms = {name: _Histogram() for name in HISTOGRAMS}
        self._events: dict[tuple[str, str], int] = {}
        self._received = self._lost = 0

    def take(
        self,
        state: Mapping[str, Any] | None,
        blocks: list[npt.NDArray[Any]],
        events: list[Mapping[str, Any]],
        count: tuple[int, int],
    ) -> None:
        """Add what has arrived. ``state``: the newest, None while the daemon is silent; ``count``: received, lost."""
        with self._lock:
            self._state, (self._received, self._lost) = state, count
            for block in blocks:
                for name, (field, _) in HISTOGRAMS.items():
                    self._histograms[name].add(block[field].astype(np.float64) * NS)
            for event in events:
                key = str(event["source"]), str(event["severity"])
                self._events[key] = self._events.get(key, 0) + 1

    def collect(self) -> Iterator[Metric]:
        """All metrics as they are now; those of the state are left out while the daemon is silent."""
        with self._lock:
            yield from self._collected()

    def _collected(self) -> Iterator[Metric]:
        state = self._state or {}
        yield InfoMetricFamily(
            f"{PREFIX}bridge", "The bridge and its rig.", value={"rig": self._rig, "version": __version__}
        )
        alive = float(bool(state.get("loop_alive")))
        yield GaugeMetricFamily(f"{PREFIX}up", "1 while the daemon's loop runs and is heard here.", value=alive)
        yield from _of_state(state)
        if state.get("mode") is not None:
            yield _states("mode", "Mode of the rig.", self._modes, state["mode"])
            yield _states("fault", "Latched fault.", self._faults, state.get("fault"))
            causes = float(len(state.get("causes") or ()))
            yield GaugeMetricFamily(f"{PREFIX}causes", "Causes of a fault that stand.", value=causes)
        for name, (_, meaning) in HISTOGRAMS.items():
            found = self._histograms[name]
            yield HistogramMetricFamily(PREFIX + name, meaning, buckets=found.buckets(), sum_value=found.sum_s)
        events = CounterMetricFamily(
            f"{PREFIX}events", "Events since the bridge's start.", labels=["source", "severity"]
        )
        for key, number in sorted(self._events.items()):
            events.add_metric(key, number)
        yield events
        records = CounterMetricFamily(f"{PREFIX}bridge_records", "Records of the fast stream here.", labels=["what"])
        records.add_metric(["received"], self._received)
        records.add_metric(["lost"], self._lost)
        yield records


def _of_state(state: Mapping[str, Any]) -> Iterator[Metric]:
    """The metrics of the catalogue of signals, those of one name as one family, and what the gateway has lost."""
    families: dict[str, CounterMetricFamily | GaugeMetricFamily] = {}
    rows = [(row.metric, row.name, row.unit) for row in SIGNALS if row.metric is not None]
    for metric, field, unit in [*rows, (_LOST, "samples_lost", "")]:
        if metric.name not in families:
            kind = CounterMetricFamily if metric.is_counter else GaugeMetricFamily
            labels = [metric.label] if metric.label else None
            families[metric.name] = kind(PREFIX + metric.name, metric.meaning, labels=labels)
        value = state.get(field)
        if isinstance(value, int | float) and math.isfinite(value):
            of = [metric.of] if metric.label else []
            families[metric.name].add_metric(of, value * _TO_BASE.get(unit, 1.0))
    yield from families.values()


def _states(name: str, meaning: str, names: list[str], now: str | None) -> Metric:
    return StateSetMetricFamily(PREFIX + name, meaning, value={one: one == now for one in names})
