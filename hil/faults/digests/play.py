"""Plays runs for their digests, on as many processors as there are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from hil.branching import BranchError
from hil.faults.digests import drawn_runs, played_rows
from hil.faults.digests.played_rows import PlayedRow
from hil.faults.digests.streams import Digests, digests_of
from hil.faults.lockstep_run import Bench, start_of
from hil.runs import runner
from hil.runs.rows_file import RowsFile
from hil.runs.runner import Work
from hil.scenario.play import Advance, design
from rigctl.config.settings import RigSettings

SOON_AFTER_S = 1.0
"""So long after its seconds a row is watched, as in the gate."""
Found = dict[str, Digests | dict[str, Any]]
"""Digests by key; of a run that cannot be played, why."""
_rigs: dict[str, RigSettings] = {}
_benches: dict[str, Bench] = {}
"""Of this process, by the name of the rig."""


def play(
    rigs: Mapping[str, RigSettings],
    rows: Sequence[PlayedRow],
    kept: RowsFile,
    advance: Advance,
    draws: Sequence[int] = (),
) -> None:
    """Play the rows and draws that ``kept`` has not got yet, and keep the digests of each.

    Raises:
        ScenarioError: the design of a rig's law is refused.
    """
    missing = [row for row in rows if kept.get(row.key) is None]
    undrawn = [index for index in draws if kept.get(drawn_runs.key(index)) is None]
    if done := len(rows) + len(draws) - len(missing) - len(undrawn):
        advance(done, "")
    pieces = {
        f"block {number}": Work(_play_block, (number, members), f"draws {members[0]} to {members[-1]}", len(members))
        for number, members in drawn_runs.by_block(undrawn).items()
    }
    pieces |= {row.key: Work(_play, (row,), row.key) for row in sorted(missing, key=_start_of)}

    def keep(_: str, found: Found) -> None:
        for key, digests in found.items():
            kept.put(key, digests)

    runner.play(pieces, advance, keep=keep, pieces_per_worker=4, start=_start, start_arguments=(dict(rigs),))


def _start_of(row: PlayedRow) -> str:
    fault = played_rows.row(row.id)
    return f"{row.rig} {start_of(fault.around, row.mode, fault.from_start)!r}"


def _start(rigs: dict[str, RigSettings]) -> None:
    _rigs.clear()
    _rigs.update(rigs)
    _benches.clear()


def _bench(name: str) -> Bench:
    if name not in _benches:
        _benches[name] = Bench(_rigs[name], design(_rigs[name]), most_after_s=SOON_AFTER_S, keeps_frames=True)
    return _benches[name]


def _play(row: PlayedRow) -> Found:
    try:
        return {row.key: digests_of(_bench(row.rig).play(played_rows.row(row.id), row.mode))}
    except (RuntimeError, TimeoutError, BranchError) as error:
        return {row.key: {"not played": {type(error).__name__: str(error)}}}


def _play_block(number: int, indices: Sequence[int]) -> Found:
    return drawn_runs.play_block(_rigs[played_rows.BASE], number, indices)
