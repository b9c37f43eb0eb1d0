"""A stretch of a test's run: records and truth as numpy and pandas, figures by name, a picture."""

from __future__ import annotations

import pathlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from hil.scenario.case import Case
from hil.scenario.figures import LOOP_FIGURES, TRUTH_FIGURES, Figure, WindowRows
from hil.scenario.format import Scenario
from hil.scenario.play import Ended, Played
from hil.scenario.plot import plot
from rigctl.config.settings import RigSettings
from rigctl.model.faults import Fault
from rigctl.model.states import Mode

if TYPE_CHECKING:
    import pandas as pd

_OF_TRUTH = {figure.name: figure for figure in TRUTH_FIGURES}
_OF_LOOP = {figure.name: figure for figure in LOOP_FIGURES}
FIGURE_NAMES = (*_OF_TRUTH, *_OF_LOOP)
"""Names that `RunStretch.figure` takes; docs/scenario.md says what each means."""


@dataclass(frozen=True)
class RunStretch:
    """Part of a run; times are in seconds from its beginning.

    ``records``: the loop's, one a tick. ``truth``: the plant's true state, one a tick, ``TRUTH_DTYPE``; empty where the
    rig is another process. ``target_n``: vertical tension to hold.
    """

    settings: RigSettings
    start_ns: int
    target_n: float
    records: npt.NDArray[Any]
    truth: npt.NDArray[Any]

    def __repr__(self) -> str:
        """Short, since pytest prints it below a failed assertion."""
        end = f"{self.mode}, fault {self.fault} at its end" if len(self.records) else "no records"
        return f"<RunStretch: {len(self.records)} records, {end}>"

    @property
    def t_s(self) -> npt.NDArray[np.float64]:
        """Time of each record."""
        return self._seconds(self.records)

    @property
    def mode(self) -> str:
        """Mode at the end."""
        return Mode(int(self.records["mode"][-1])).name

    @property
    def fault(self) -> str:
        """Fault latched at the end; NONE without one."""
        return Fault(int(self.records["fault"][-1])).name

    @property
    def frame(self) -> pd.DataFrame:
        """The records as a table: a row a tick by ``t_s``, mode and fault by name."""
        table = self._table(self.records)
        for name, kind in (("mode", Mode), ("fault", Fault)):
            table[name] = [kind(int(number)).name for number in self.records[name]]
        return table

    @property
    def truth_frame(self) -> pd.DataFrame:
        """The truth as a table: a row a tick by ``t_s``."""
        return self._table(self.truth)

    def figure(self, name: str, from_s: float = 0.0, to_s: float = np.inf) -> float:
        """A figure by its name, over a window with both ends included.

        Raises:
            ValueError: there is no such figure, or nothing to take it from.
        """
        figure, rows = self._source(name)
        t_s = self._seconds(rows)
        inside = (t_s >= from_s) & (t_s <= to_s)
        if not np.any(inside):
            raise ValueError(f"{name}: found no data from {from_s:g} to {to_s:g} s")
        return float(figure.of(WindowRows(rows[inside], t_s[inside], self.target_n)))

    def plot(self, file: str | pathlib.Path, title: str = "test") -> pathlib.Path:
        """Draw it into a .png, .svg or .pdf.

        Raises:
            OSError: the file cannot be written.
        """
        tripped = np.flatnonzero(self.records["mode"] == Mode.FAULT)
        at_s = float(self.t_s[tripped[0]]) if len(tripped) else None
        ended = Ended(self.mode, self.fault, tripped=at_s is not None, tripped_at_s=at_s)
        played = Played(
            "loop", self.target_n, self.truth, self._seconds(self.truth), self.records, self.t_s, ended
        )  # fmt: skip
        scenario = Scenario(scenario="test", rig="-", duration_s=1.0).model_copy(update={"scenario": title})
        path = pathlib.Path(file)
        plot(Case(scenario, self.settings, {}, path), played, path)
        return path

    def _source(self, name: str) -> tuple[Figure, npt.NDArray[Any]]:
        if name in _OF_TRUTH and len(self.truth):
            return _OF_TRUTH[name], self.truth
        if name in _OF_LOOP:
            return _OF_LOOP[name], self.records
        there = FIGURE_NAMES if len(self.truth) else tuple(_OF_LOOP)
        raise ValueError(f"found figure {name!r}, expected {', '.join(there)}")

    def _seconds(self, rows: npt.NDArray[Any]) -> npt.NDArray[np.float64]:
        seconds: npt.NDArray[np.float64] = (rows["t_ns"] - self.start_ns) * 1e-9
        return seconds

    def _table(self, rows: npt.NDArray[Any]) -> pd.DataFrame:
        import pandas as pd

        columns = {name: rows[name] for name in rows.dtype.names or () if rows[name].ndim == 1}
        return pd.DataFrame(columns, index=pd.Index(self._seconds(rows), name="t_s"))
