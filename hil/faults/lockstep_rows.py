"""The rows that play in simulated time, on as many processors as there are."""

from __future__ import annotations

from collections.abc import Sequence

from hil.faults.catalogue import ROWS
from hil.faults.expected import InjectedFault
from hil.faults.judging.judge import FaultResult, judge
from hil.faults.lockstep_run import Bench, by_start
from hil.runs import runner
from hil.runs.runner import Work
from hil.scenario.play import Advance, design
from rigctl.config.changed_settings import changed
from rigctl.config.settings import RigSettings
from rigctl.control.law.tension import Gains
from rigctl.model.states import Mode

_ROWS_PER_WORKER = 12
"""A process takes as long to start as a few rows to play."""
_bench: list[Bench] = []
"""The bench of this process."""


def play(rig: RigSettings, rows: Sequence[tuple[InjectedFault, Mode]], advance: Advance) -> list[FaultResult]:
    """Play rows; returns their results in their order.

    Raises:
        ScenarioError: the design of the rig's law is refused.
    """
    if not rows:
        return []
    pieces = {
        (fault.id, mode): Work(_play, (fault.id, mode), f"{fault.id} in {mode.name}") for fault, mode in by_start(rows)
    }
    start = (rig, design(rig))
    found = runner.play(pieces, advance, pieces_per_worker=_ROWS_PER_WORKER, start=_start, start_arguments=start)
    return [found[fault.id, mode] for fault, mode in rows]


def row_of(bench: Bench, fault: InjectedFault, mode: Mode) -> FaultResult:
    """Play and judge one row; a row whose mode cannot be reached has failed."""
    try:
        run, undisturbed = bench.play(fault, mode), bench.undisturbed(fault, mode)
        cut = bench.play_cut(fault, mode) if fault.against_cut else None
        return judge(fault, mode, run, undisturbed, changed(bench.settings, dict(fault.around.change)), cut)
    except (RuntimeError, TimeoutError) as error:
        return FaultResult.unreached(fault.id, mode, fault.expected[mode], str(error))


def _start(rig: RigSettings, gains: Gains) -> None:
    _bench[:] = [Bench(rig, gains)]


def _play(fault_id: str, mode: Mode) -> FaultResult:
    return row_of(_bench[0], ROWS[fault_id], mode)
