"""When the loop's margins are measured, and what a measurement means: settings for the loop, an entry of the ledger."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from rigctl.config.settings import RigSettings
from rigctl.control.excitation.margin_probe import GROW_S, WINDOW_S
from rigctl.design.identified import WINDOW
from rigctl.ipc import ledger
from rigctl.ipc.ledger import Entry
from rigctl.model.verbs import Setting, SettingOrder
from rigctl.operations.evaluation import EvaluationError

FIRST_NS = round((GROW_S + 5.0 + WINDOW_S) * 1e9)  # after the multisine began: growth, a period to die away, a window
AGAIN_NS = round(WINDOW_S * 1e9)


class MarginWindows:
    """Each minute of an excitation is a window. Times are those of the records, ns."""

    def __init__(self, settings: RigSettings) -> None:
        self._settings = settings
        self._differs: Mapping[str, float] | None = None
        self._began_ns = self._due_ns = 0

    def due(self, began_ns: int, newest_ns: int, *, busy: bool) -> tuple[int, int] | None:
        """Begin and end of the window to evaluate now.

        ``began_ns``: begin of the excitation, 0 without one. ``newest_ns``: of the newest record. ``busy``: another
        window is still being evaluated.
        """
        if began_ns != self._began_ns:
            self._began_ns, self._due_ns = began_ns, began_ns + FIRST_NS
        if not began_ns or newest_ns < self._due_ns or busy:
            return None
        self._due_ns = newest_ns + AGAIN_NS
        return newest_ns - FIRST_NS, newest_ns

    def unmeasured(self, error: EvaluationError) -> SettingOrder:
        """The loop learns why there is no measurement."""
        return SettingOrder(Setting.MARGINS, (math.nan, float(error.reason)))

    def measured(self, found: Mapping[str, Any], wall_ns: int) -> tuple[list[SettingOrder], Entry | None]:
        """Settings that follow from what `rigctl.operations.evaluation.margins` returned.

        Where the sensitivity begins or ceases to differ from the design's there is an entry, and a warning.
        """
        orders = [SettingOrder(Setting.MARGINS, (float(found["ms"]), float(found["error"])))]
        differs: Mapping[str, float] | None = found["difference"]
        if (differs is None) == (self._differs is None):
            return orders, None
        self._differs = differs
        if differs is not None:
            nearest = min(differs["low"], differs["high"], key=lambda end: abs(end - differs["measured"]))
            orders.append(SettingOrder(Setting.DIFFERS, (differs["measured"], nearest)))
        written = ledger.entry(
            self._settings, WINDOW, "gateway", wall_ns, before={}, after={}, figures={"difference": differs}
        )
        return orders, written
