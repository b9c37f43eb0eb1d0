"""Each minute of an excitation gives the loop its margins, and a difference from the design's is on record once."""

from __future__ import annotations

import math
from typing import Any

import pytest

from rigctl.config import rig_file as config
from rigctl.model.unmeasured import Unmeasured
from rigctl.model.verbs import Setting, SettingOrder
from rigctl.operations.evaluation import EvaluationError
from rigctl.operations.margin_windows import AGAIN_NS, FIRST_NS, MarginWindows
from tests.builders.paths import ROOT

PAPER = config.load(ROOT / "config/paper_rig.yaml")
BEGAN = 5_000_000_000


@pytest.fixture
def windows() -> MarginWindows:
    return MarginWindows(PAPER)


def test_the_first_window_ends_when_the_multisine_has_grown_and_the_next_a_minute_later(windows: MarginWindows) -> None:
    assert windows.due(0, 0, busy=False) is None
    assert windows.due(BEGAN, BEGAN + FIRST_NS - 1, busy=False) is None
    assert windows.due(BEGAN, BEGAN + FIRST_NS, busy=True) is None
    assert windows.due(BEGAN, BEGAN + FIRST_NS, busy=False) == (BEGAN, BEGAN + FIRST_NS)
    after = BEGAN + FIRST_NS + AGAIN_NS
    assert windows.due(BEGAN, after - 1, busy=False) is None
    assert windows.due(BEGAN, after, busy=False) == (after - FIRST_NS, after)


def test_a_new_excitation_begins_a_new_window(windows: MarginWindows) -> None:
    assert windows.due(BEGAN, BEGAN + FIRST_NS - 1, busy=False) is None
    again = BEGAN + FIRST_NS
    assert windows.due(again, again + FIRST_NS // 2, busy=False) is None


def test_the_loop_learns_why_there_is_no_measurement(windows: MarginWindows) -> None:
    setting, (ms, reason) = windows.unmeasured(EvaluationError("too weak", Unmeasured.WEAK))
    assert (setting, reason) == (Setting.MARGINS, Unmeasured.WEAK)
    assert math.isnan(ms)


def test_a_sensitivity_that_is_not_the_designs_is_a_warning_and_on_record_once(windows: MarginWindows) -> None:
    differs = {"hz": 60.0, "measured": 1.9, "error": 0.02, "low": 1.1, "high": 1.5}
    usual: dict[str, Any] = {"ms": 1.9, "error": 0.02, "difference": None}
    found = [windows.measured(usual | {"difference": one}, 0) for one in (None, differs, differs, None)]
    figure = SettingOrder(Setting.MARGINS, (1.9, 0.02))
    warned = [figure, SettingOrder(Setting.DIFFERS, (1.9, 1.5))]
    assert [orders for orders, _ in found] == [[figure], warned, [figure], [figure]]
    recorded = [(item.what, item.figures["difference"]) for _, item in found if item is not None]
    assert recorded == [("margins", differs), ("margins", None)]
