"""``python -m hil faults --ways-out``: whether the displayed steps lead out of every end, and offers are kept."""

from __future__ import annotations

import pathlib
import sys
from collections import Counter
from collections.abc import Sequence

from hil.cli.faults import choose
from hil.cli.faults_hash import source_of
from hil.cli.files import check_outputs, simulated_rig
from hil.runs.rows_file import RowsFile
from hil.ways_out import play
from hil.ways_out.play import LedOut
from rigctl.cli.progress import progress

_ROWS_SHOWN = 3


def run(rig_file: pathlib.Path, file: pathlib.Path, only: Sequence[str], modes: Sequence[str]) -> int:
    """Play rows to their ends, take the steps displayed at one of each distinct end, print those that lead nowhere.

    Rows that ``file`` has already, of the same source, are not played again.

    Args:
        rig_file: with the ``simulation`` section.
        file: gets the ends and the steps taken, a line of JSON for each.
        only: ids of faults; none = all.
        modes: names of modes; none = all.

    Returns:
        0 when every row was played, every end has a way out, and every command was answered as offered, else 1.

    Raises:
        ScenarioError, ConfigError: bad input, or a rig that cannot be simulated.
        OutputError: the file cannot be written.
    """
    rig = simulated_rig(rig_file)
    rows = choose(only, modes).lockstep
    check_outputs({"--ways-out": file}, [rig_file])
    kept = RowsFile(file, {"ways out": 2, "source": source_of(rig_file)})
    with progress("ways out", len(rows)) as advance:
        found = play.play(rig, rows, kept, advance)
    unplayed = play.unplayed(rows, kept)
    for name, why in unplayed.items():
        _print(f"{name}: not played: {why}")
    lost = [one for one in found if not one.leads]
    for one in lost:
        _show(one)
    by_mode = Counter(one.end.mode for one in found)
    named = ", ".join(f"{count} in {mode}" for mode, count in sorted(by_mode.items()))
    misoffered = sorted({words for one in found for words in one.misoffered})
    for words in misoffered:
        _print(f"not as offered: {words}")
    _print(f"{len(rows)} rows, {len(found)} distinct ends ({named}): {len(lost)} without a way out")
    return 1 if lost or unplayed or misoffered else 0


def _show(one: LedOut) -> None:
    more = f" and {len(one.rows) - _ROWS_SHOWN} more" if len(one.rows) > _ROWS_SHOWN else ""
    _print(f"{', '.join(one.rows[:_ROWS_SHOWN])}{more}")
    end = one.end
    doubted = f", {' and '.join(end.doubts)} in doubt" if end.doubts else ""
    _print(f"  ends in {end.mode}, {end.fault}, {end.action}, held by {end.held_by}, at rest {end.at_rest}{doubted}")
    for step in one.taken:
        _print(f"  {step}")
    _print(f"  no way out: {one.why}")


def _print(text: str) -> None:
    sys.stdout.write(text + "\n")
