"""Margins are evaluated each minute of an excitation, beside everything else."""

from __future__ import annotations

import math
import pathlib
from typing import Any

import pytest

from rigctl.config import rig_file as config
from rigctl.config.margins_section import MarginsSettings
from rigctl.gateway import margin_service
from rigctl.gateway.margin_service import MarginService
from rigctl.ipc.ledger import Entry
from rigctl.ipc.runtime_folder import Runtime
from rigctl.model.unmeasured import Unmeasured
from rigctl.model.verbs import Setting, SettingOrder
from rigctl.operations.evaluation import EvaluationError
from rigctl.operations.margin_windows import AGAIN_NS, FIRST_NS
from tests.builders.paths import ROOT
from tests.builders.waiting import patience_s

PAPER = config.load(ROOT / "config/paper_rig.yaml")
MEASURED = PAPER.model_copy(update={"margins": MarginsSettings()})
BEGAN = 5_000_000_000


class Excited:
    """Stands in for the records."""

    def __init__(self) -> None:
        self.span = (0, 0)
        self.asked: list[tuple[int, int]] = []

    def between(self, after_ns: int, until_ns: int) -> str:
        self.asked.append((after_ns, until_ns))
        return "records"


def orders(service: MarginService) -> list[SettingOrder]:
    """What the evaluation that was begun finds."""
    found = list(service.settings_due())
    thread = service._evaluating
    if thread is not None:
        thread.join(patience_s())
    return [*found, *service.settings_due()]


@pytest.fixture
def excited() -> Excited:
    return Excited()


@pytest.fixture
def recorded() -> list[Entry]:
    return []


def answering(monkeypatch: pytest.MonkeyPatch, *answers: dict[str, Any] | str) -> None:
    left = list(answers)

    def evaluate(_runtime: object, what: str, records: object) -> dict[str, Any]:
        assert (what, records) == ("margins", "records")
        answer = left.pop(0)
        if isinstance(answer, str):
            raise EvaluationError(answer, Unmeasured.WEAK)
        return {"difference": None, **answer}

    monkeypatch.setattr(margin_service, "evaluate", evaluate)


def test_what_stops_it_is_said_once(
    excited: Excited,
    recorded: list[Entry],
    tmp_path: pathlib.Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    answering(monkeypatch, "too weak", "too weak", {"ms": 1.4, "error": 0.02}, "too weak")
    service, now = MarginService(Runtime(tmp_path), MEASURED, excited, recorded.append), BEGAN + FIRST_NS  # type: ignore[arg-type]
    found = []
    for _ in range(4):
        excited.span = (BEGAN, now)
        found += [order.values for order in orders(service)]
        now += AGAIN_NS
    assert [reason for ms, reason in found if math.isnan(ms)] == [Unmeasured.WEAK] * 3, "the loop knows each time"
    assert capsys.readouterr().err == "gateway: margins not measured: too weak\n" * 2


def test_what_is_found_goes_to_the_loop_and_to_the_ledger(
    excited: Excited, recorded: list[Entry], tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    differs = {"hz": 60.0, "measured": 1.9, "error": 0.02, "low": 1.1, "high": 1.5}
    answering(monkeypatch, {"ms": 1.9, "error": 0.02, "difference": differs})
    service = MarginService(Runtime(tmp_path), MEASURED, excited, recorded.append)  # type: ignore[arg-type]
    excited.span = (BEGAN, BEGAN + FIRST_NS)
    assert orders(service) == [(Setting.MARGINS, (1.9, 0.02)), (Setting.DIFFERS, (1.9, 1.5))]
    assert excited.asked == [(BEGAN, BEGAN + FIRST_NS)]
    assert [item.what for item in recorded] == ["margins"]


def test_without_the_section_nothing_is_evaluated(
    excited: Excited, recorded: list[Entry], tmp_path: pathlib.Path
) -> None:
    excited.span = (BEGAN, BEGAN + 10 * FIRST_NS)
    assert orders(MarginService(Runtime(tmp_path), PAPER, excited, recorded.append)) == []  # type: ignore[arg-type]
    assert excited.asked == []
