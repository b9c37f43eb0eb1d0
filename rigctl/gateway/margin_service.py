"""Measures the loop's margins each minute of COMPENSATING and gives them to the loop, which puts them on record."""

from __future__ import annotations

import queue
import sys
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any

from rigctl.config.settings import RigSettings
from rigctl.gateway.evaluation_process import evaluate
from rigctl.gateway.excited_records import ExcitedRecords
from rigctl.ipc.ledger import Entry
from rigctl.ipc.runtime_folder import Runtime
from rigctl.model.verbs import SettingOrder
from rigctl.operations.evaluation import EvaluationError
from rigctl.operations.margin_windows import MarginWindows


class MarginService:
    """One thread for each evaluation, so that nothing waits for it. Nothing is done without a ``margins`` section."""

    def __init__(
        self, runtime: Runtime, settings: RigSettings, excited: ExcitedRecords, record: Callable[[Entry], None]
    ) -> None:
        """``record``: takes an entry for the ledger."""
        self._runtime, self._excited, self._on = runtime, excited, settings.margins is not None
        self._found: queue.SimpleQueue[SettingOrder] = queue.SimpleQueue()
        self._evaluating: threading.Thread | None = None
        self._windows, self._record = MarginWindows(settings), record
        self._said = ""

    def settings_due(self) -> Sequence[SettingOrder]:
        """Begin an evaluation if one is due; returns what the last one found. Any thread, often."""
        if not self._on:
            return ()
        busy = self._evaluating is not None and self._evaluating.is_alive()
        window = self._windows.due(*self._excited.span, busy=busy)
        if window is not None:
            records = self._excited.between(*window)
            self._evaluating = threading.Thread(target=self._evaluate, args=(records,), name="margins", daemon=True)
            self._evaluating.start()
        return [self._found.get() for _ in range(self._found.qsize())]

    def _evaluate(self, records: Any) -> None:
        try:
            answer = evaluate(self._runtime, "margins", records)
        except EvaluationError as error:
            self._say(str(error))
            self._found.put(self._windows.unmeasured(error))
            return
        self._say("")
        orders, written = self._windows.measured(answer, time.time_ns())
        for order in orders:
            self._found.put(order)
        if written is not None:
            self._record(written)

    def _say(self, why: str) -> None:
        """Tell the log once why there is no measurement."""
        if why and why != self._said:
            sys.stderr.write(f"gateway: margins not measured: {why}\n")
        self._said = why
