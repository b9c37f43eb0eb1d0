"""Measures the loop's margins each minute of COMPENSATING and gives them to the loop, which puts them on record."""

from __future__ import annotations

import math
import queue
import sys
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any

from rigctl.config.settings import RigSettings
from rigctl.control.excitation.margin_probe import GROW_S, WINDOW_S
from rigctl.design.identified import WINDOW
from rigctl.gateway.evaluation import EvaluationError, evaluate
from rigctl.gateway.excited_records import ExcitedRecords
from rigctl.ipc import ledger
from rigctl.ipc.ledger import Entry
from rigctl.ipc.runtime_folder import Runtime
from rigctl.model.verbs import Setting, SettingOrder

FIRST_NS = round((GROW_S + 5.0 + WINDOW_S) * 1e9)  # after the multisine began: growth, a period to die away, a window
AGAIN_NS = round(WINDOW_S * 1e9)


class MarginService:
    """One thread for each evaluation, so that nothing waits for it. Nothing is done without a ``margins`` section."""

    def __init__(
        self, runtime: Runtime, settings: RigSettings, excited: ExcitedRecords, record: Callable[[Entry], None]
    ) -> None:
        """``record``: takes an entry for the ledger."""
        self._runtime, self._excited, self._on = runtime, excited, settings.margins is not None
        self._found: queue.SimpleQueue[SettingOrder] = queue.SimpleQueue()
        self._evaluating: threading.Thread | None = None
        self._settings, self._record = settings, record
        self._differs: dict[str, float] | None = None
        self._began_ns = self._due_ns = 0
        self._said = ""

    def settings_due(self) -> Sequence[SettingOrder]:
        """Begin an evaluation if one is due; returns what the last one found. Any thread, often."""
        if not self._on:
            return ()
        began_ns, newest_ns = self._excited.span
        if began_ns != self._began_ns:
            self._began_ns, self._due_ns = began_ns, began_ns + FIRST_NS
        busy = self._evaluating is not None and self._evaluating.is_alive()
        if began_ns and newest_ns >= self._due_ns and not busy:
            self._due_ns = newest_ns + AGAIN_NS
            records = self._excited.between(newest_ns - FIRST_NS, newest_ns)
            self._evaluating = threading.Thread(target=self._evaluate, args=(records,), name="margins", daemon=True)
            self._evaluating.start()
        return [self._found.get() for _ in range(self._found.qsize())]

    def _evaluate(self, records: Any) -> None:
        try:
            answer = evaluate(self._runtime, "margins", records)
        except EvaluationError as error:
            self._say(str(error))
            self._found.put(SettingOrder(Setting.MARGINS, (math.nan, float(error.reason))))
            return
        self._say("")
        self._found.put(SettingOrder(Setting.MARGINS, (float(answer["ms"]), float(answer["error"]))))
        self._compare(answer["difference"])

    def _compare(self, differs: dict[str, float] | None) -> None:
        """Where the sensitivity begins or ceases to differ from the design's: a warning, and an entry of the ledger."""
        if (differs is None) == (self._differs is None):
            return
        self._differs = differs
        if differs is not None:
            nearest = min(differs["low"], differs["high"], key=lambda end: abs(end - differs["measured"]))
            self._found.put(SettingOrder(Setting.DIFFERS, (differs["measured"], nearest)))
        self._record(
            ledger.entry(
                self._settings, WINDOW, "gateway", time.time_ns(), before={}, after={}, figures={"difference": differs}
            )
        )

    def _say(self, why: str) -> None:
        """Tell the log once why there is no measurement."""
        if why and why != self._said:
            sys.stderr.write(f"gateway: margins not measured: {why}\n")
        self._said = why
