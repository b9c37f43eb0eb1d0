"""A rig as operations see it, whose ledger, records and calculations are values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from rigctl.config.settings import RigSettings
from rigctl.control.excitation.trials import LoadBin
from rigctl.ipc.ledger import Entry, Standing
from rigctl.ipc.record import RECORD
from rigctl.operations import filing
from rigctl.operations.left_over import InForce


@dataclass
class RigInMemory:
    """``answer``: of a calculation, returned or raised. ``refuses``: raised by the ledger. ``said``: for the log."""

    settings: RigSettings
    standing: Standing = Standing(overdue=True)  # noqa: RUF009 - frozen
    design: Mapping[str, Any] = field(default_factory=dict)
    ledger: list[Entry] = field(default_factory=list)
    ticks: npt.NDArray[Any] = field(default_factory=lambda: np.zeros(0, RECORD.dtype))
    answer: dict[str, Any] | Exception = field(default_factory=dict)
    refuses: Exception | None = None
    bins: Sequence[LoadBin] = ()
    has: InForce = (0.0, 1.0, "")
    said: list[str] = field(default_factory=list)
    wall_ns: int = 0

    def entries(self) -> list[Entry]:
        if self.refuses is not None:
            raise self.refuses
        return list(self.ledger)

    def append(self, written: Entry) -> list[Entry]:
        self.ledger = [*self.entries(), written]
        return self.ledger

    def load_bins(self, _until_ns: int) -> Sequence[LoadBin]:
        return self.bins

    def records(self, after_ns: int, until_ns: int) -> npt.NDArray[Any]:
        return self.ticks[(self.ticks["t_ns"] > after_ns) & (self.ticks["t_ns"] <= until_ns)]

    excited = records

    def response(self, _records: npt.NDArray[Any]) -> dict[str, Any]:
        return self._answered()

    def admitted(self, _text: str, _name: str) -> dict[str, Any]:
        return self._answered()

    def loop_has(self) -> InForce:
        return self.has

    def put_in_force(self, standing: Standing) -> None:
        self.standing = standing

    def withdraw(self, given: Entry) -> None:
        standing = filing.withdraw(self, given, self.wall_ns)
        self.standing = standing or self.standing

    def say(self, text: str) -> None:
        self.said.append(text)

    def _answered(self) -> dict[str, Any]:
        if isinstance(self.answer, Exception):
            raise self.answer
        return self.answer
