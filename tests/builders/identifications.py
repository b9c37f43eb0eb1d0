"""Ledger entries of `rigctl identify`, by steps and by frequency response, as the gateway writes them."""

from __future__ import annotations

from typing import Any

from rigctl.config.settings import RigSettings
from rigctl.ipc.ledger import Entry, entry

NOON_NS = 1_793_534_400_000_000_000  # 2026-11-01T12:00:00Z
DAY_NS = 86_400_000_000_000


def steps(settings: RigSettings, days_ago: float = 0.0, tension_n: float = 300.0, **found: Any) -> Entry:
    """An entry of `rigctl identify`; ``found``: (value, error) by key of the row, dots as double underscores."""
    figures: dict[str, Any] = {
        "stiffness": (6.0, 0.01), "plant__cylinder_lag_s": (0.02, 0.0002), "plant__command_delay_s": (0.002, 0.0001),
    } | found  # fmt: skip
    before = {"stiffness": settings.plant.stiffness_n_mm}
    rows = [
        {"key": (key := name.replace("__", ".")), "unit": "", "before": before.get(key), "found": pair[0],
         "error": pair[1], "why": ""}
        for name, pair in figures.items()
    ]  # fmt: skip
    return entry(
        settings, "identify", "kim", round(NOON_NS - days_ago * DAY_NS), before={}, after={},
        figures={"rows": rows, "tension_n": tension_n},
    )  # fmt: skip


def response(settings: RigSettings, days_ago: float = 0.0, tension_n: float = 300.0, **figures: Any) -> Entry:
    """An entry of `rigctl identify --response`."""
    plant = {
        "stiffness_n_mm": {"value": 6.0, "error": 0.01},
        "lag_s": {"value": 0.02, "error": 0.0002},
        "delay_s": {"value": 0.002, "error": 0.0001},
        "sensor_delay_s": {"value": 0.0003, "error": 0.0},
        "mechanism_n_mm": {"value": None, "error": None, "above": 300.0},
    } | figures.pop("plant", {})
    return entry(
        settings, "response", "kim", round(NOON_NS - days_ago * DAY_NS),
        before={"stiffness_n_mm": settings.plant.stiffness_n_mm}, after={},
        figures={"plant": plant, "tension_n": tension_n, **figures},
    )  # fmt: skip
