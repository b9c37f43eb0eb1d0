"""The rows that play in simulated time, on as many processors as there are."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed

from hil.faults.catalogue import BY_ID
from hil.faults.expected import InjectedFault
from hil.faults.judge import Row, judge
from hil.faults.lockstep_run import Bench
from hil.scenario.play import design
from rigctl.cli.progress import Advance
from rigctl.config.settings import RigSettings
from rigctl.control.modes import Mode
from rigctl.control.tension import Gains

_MOST_WORKERS = 4
_WORTH_A_WORKER = 12
"""Rows per worker; a process takes as long to start as a few rows to play."""
_bench: list[tuple[RigSettings, Bench]] = []
"""The bench of this worker process."""


def play(rig: RigSettings, rows: Sequence[tuple[InjectedFault, Mode]], advance: Advance) -> list[Row]:
    """Play rows; returns them in their order.

    Raises:
        ScenarioError: the design of the rig's law is refused.
    """
    if not rows:
        return []
    gains = design(rig)
    workers = min(_MOST_WORKERS, os.cpu_count() or 1, len(rows) // _WORTH_A_WORKER)
    if workers < 2:
        bench = Bench(rig, gains)
        return [_told(row_of(bench, rig, fault, mode), advance) for fault, mode in rows]
    found: dict[int, Row] = {}
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, spawn, initializer=_start, initargs=(rig, gains)) as pool:
        futures = {pool.submit(_row, fault.id, mode): i for i, (fault, mode) in enumerate(rows)}
        try:
            for future in as_completed(futures):
                found[futures[future]] = _told(future.result(), advance)
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
    return [found[i] for i in range(len(rows))]


def row_of(bench: Bench, rig: RigSettings, fault: InjectedFault, mode: Mode) -> Row:
    """Play and judge one row; a row whose mode cannot be reached has failed."""
    try:
        return judge(fault, mode, bench.play(fault, mode), bench.undisturbed(fault, mode), rig)
    except (RuntimeError, TimeoutError) as error:
        return Row.unreached(fault.id, mode, fault.expected[mode], str(error))


def _start(rig: RigSettings, gains: Gains) -> None:
    _bench.append((rig, Bench(rig, gains)))


def _row(fault_id: str, mode: Mode) -> Row:
    rig, bench = _bench[0]
    return row_of(bench, rig, BY_ID[fault_id], mode)


def _told(row: Row, advance: Advance) -> Row:
    advance(1.0, f"{row.id} in {row.mode}")
    return row
