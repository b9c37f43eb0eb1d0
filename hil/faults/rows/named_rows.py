"""Plays rows of the catalogue for their culprits; what a row has shown is kept, so that it is played once."""

from __future__ import annotations

import pathlib
from collections.abc import Sequence

from hil.faults.catalogue import BY_ID
from hil.faults.expected import InjectedFault
from hil.faults.judging.naming import NamedRow, RecordedRow, culprit, named, recorded
from hil.faults.lockstep_run import Bench, by_start
from hil.runs import runner
from hil.runs.runner import Work
from hil.scenario.play import Advance, design
from rigctl.config.changed_settings import changed
from rigctl.config.settings import RigSettings
from rigctl.control.law.tension import Gains
from rigctl.model.states import Mode

_bench: list[Bench] = []
"""The bench of this process."""


def play(
    rig: RigSettings, rows: Sequence[tuple[InjectedFault, Mode]], folder: pathlib.Path, advance: Advance
) -> tuple[list[NamedRow], list[str]]:
    """Name the culprit of each row that trips; returns them, and a line for each row that could not be played.

    Args:
        rig: the rig file.
        rows: faults with their modes.
        folder: has, or gets, the window of each row; those it has are not played again.
        advance: called after each row that is played.

    Raises:
        ScenarioError: the design of the rig's law is refused.
    """
    missing = [(fault, mode) for fault, mode in rows if not _file(folder, fault, mode).exists()]
    unplayed: list[str] = []

    def keep(key: tuple[str, Mode], row: RecordedRow | str) -> None:
        if isinstance(row, str):
            unplayed.append(f"{key[0]} in {key[1].name}: {row}")
        else:
            row.save(_file(folder, BY_ID[key[0]], key[1]))

    if missing:
        pieces = {(f.id, m): Work(_play, (f.id, m), f"{f.id} in {m.name}") for f, m in by_start(missing)}
        runner.play(pieces, advance, keep=keep, pieces_per_worker=12, start=_start, start_arguments=(rig, design(rig)))
    found = []
    for fault, mode in rows:
        file = _file(folder, fault, mode)
        if file.exists():
            settings = changed(rig, dict(fault.around.change))
            about = culprit(RecordedRow.load(file), settings, last=fault.ends_elsewhere)
            if about is not None:
                found.append(named(fault, mode, about))
    return found, unplayed


def _file(folder: pathlib.Path, fault: InjectedFault, mode: Mode) -> pathlib.Path:
    return folder / f"{mode.name}-{fault.id}.npz"


def _start(rig: RigSettings, gains: Gains) -> None:
    _bench[:] = [Bench(rig, gains)]


def _play(fault_id: str, mode: Mode) -> RecordedRow | str:
    fault = BY_ID[fault_id]
    try:
        return recorded(_bench[0].play(fault, mode), fault)
    except (RuntimeError, TimeoutError) as error:
        return str(error)
