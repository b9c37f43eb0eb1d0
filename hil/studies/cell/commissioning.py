"""Tare, creep and calibration of a cell on the bench, as an operator and the calibration service do them."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Sequence

from hil.studies.cell.bench import CellBench
from hil.studies.cell.drawn_cell import DrawnCell
from rigctl.control.excitation.trials import LoadBin
from rigctl.ipc import ledger
from rigctl.ipc.ledger import Entry
from rigctl.model.requests import Request
from rigctl.model.verbs import Verb
from rigctl.operations import filing
from rigctl.operations.calibration_findings import FindingError, Measured

DAY_S = 86_400.0
OPERATOR = "bench"
WEEK_C = (-3.0, -1.5, 0.0, 1.5, 3.0)
"""Temperatures of the tares of the days before, about that of the calibration."""
CREEP_S, REST_S, SETTLE_S = 1800.0, 3600.0, 120.0


class Commissioned:
    """A cell on its bench, and its ledger: a `CellInOperation`. ``standing``: what the ledger says now."""

    def __init__(self, bench: CellBench) -> None:
        self.bench, self.settings = bench, bench.settings
        self._entries: list[Entry] = []
        self._bins: list[LoadBin] = []
        self.standing = ledger.standing(bench.settings, (), bench.wall_ns)

    def tare(self) -> None:
        """Of the unloaded cell."""
        self._file(Request(Verb.TARE, OPERATOR), self._measured(self.bench.average()))

    def record_creep(self, seconds: float, weight_n: float) -> None:
        """Hang the weight, record, and adopt the creep if it is told; the weight stays."""
        self._bins = self.bench.record_creep(seconds, weight_n)
        request = Request(Verb.CALIBRATE, OPERATOR, creep_s=seconds, adopt=True)
        with contextlib.suppress(FindingError):  # not told from drift: the class's creep stays in the budget
            self._file(request, Measured(0.0, 0.0, self.bench.wall_ns, seconds), held_s=seconds)

    def calibrate(self) -> None:
        """Against the weight that hangs; the scale is adopted."""
        self._file(Request(Verb.CALIBRATE, OPERATOR, adopt=True), self._measured(self.bench.average()))

    def _file(self, request: Request, measured: Measured, held_s: float = math.nan) -> None:
        """Put a finding on the ledger and in force; ``held_s``: time since the load of an adopted creep came."""
        finding = filing.of_cell(self, request, measured, measured.wall_ns)
        self.standing = filing.put_on_record(self, finding, measured.wall_ns).standing or self.standing
        self.bench.cell.put(self.standing.correction, held_s=held_s)

    def entries(self) -> list[Entry]:
        """Every entry, oldest first."""
        return list(self._entries)

    def append(self, written: Entry) -> list[Entry]:
        """File one more entry; returns all."""
        self._entries.append(written)
        return self.entries()

    def load_bins(self, _until_ns: int) -> list[LoadBin]:
        """The newest record of a weight."""
        return self._bins

    def _measured(self, figures: dict[str, float]) -> Measured:
        return Measured(
            figures["reading_n"], figures["rms_n"], self.bench.wall_ns, samples=figures["samples"],
            creep_n=figures.get("creep_n", 0.0), creep_doubt_n=figures.get("creep_doubt_n", 0.0),
            beside_n=figures.get("zero_drift_n", 0.0), cell_c=figures.get("cell_c"),
        )  # fmt: skip


def commission(drawn: DrawnCell, bench: CellBench, scatter: Sequence[float], *, quickened: float = 1.0) -> Commissioned:
    """Tares on a week's days at other temperatures; then tare, creep and scale. It ends unloaded and rested.

    ``scatter``: of the zero in N, one for each tare, beside the cell's errors. ``quickened``: the cell creeps that many
    times as fast, and its creep is recorded for a time as much shorter.
    """
    done, base_c = Commissioned(bench), bench.celsius
    assert bench.settings.calibration is not None  # the command refuses a rig without it
    weight_n = bench.settings.calibration.reference_n + drawn.weight_error_n
    for beside_c, scattered_n in zip((*WEEK_C, 0.0), scatter, strict=True):
        bench.wait(DAY_S)
        bench.celsius = base_c + beside_c
        bench.shift_zero(scattered_n)
        bench.wait(SETTLE_S)
        done.tare()
    done.record_creep(CREEP_S / quickened, weight_n)
    done.calibrate()
    bench.pull(0.0, 1.0)
    bench.wait(REST_S / quickened)
    return done
