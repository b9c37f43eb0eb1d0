"""``python -m hil faults --hash``: digests of many runs, and their comparison with those of another commit."""

from __future__ import annotations

import hashlib
import pathlib
import platform
from collections.abc import Iterable
from typing import Any

import numpy as np

import hil
import rigctl
from hil.cli.files import check_outputs, simulated_rig
from hil.cli.two_files import conclude, listed, print_line
from hil.faults.digests import comparison, drawn_runs, play, played_rows
from hil.faults.digests.played_rows import PlayedRow
from hil.runs import rows_file
from hil.runs.rows_file import RowsFile
from hil.scenario.errors import ScenarioError
from rigctl.cli.progress import progress

_SOURCES = frozenset({".py", ".yaml", ".eds", ".dbc"})


def run(rig_file: pathlib.Path, file: pathlib.Path, against: pathlib.Path | None, *, every: bool = False) -> int:
    """Play a set of runs, write their digests into ``file``, and compare them with those of another file.

    Runs that ``file`` has already, of the same source, are not played again.

    Args:
        rig_file: with the ``simulation`` section.
        file: gets the digests, a line of JSON for each run.
        against: digests of another commit, made on the same computer.
        every: not the default set, but every row that plays in lockstep, and the draws.

    Returns:
        0 when nothing is compared, or both have the same runs and all are equal, else 1.

    Raises:
        ScenarioError, ConfigError: bad input, or a rig that cannot be simulated.
        OutputError: the file cannot be written.
    """
    simulated_rig(rig_file)
    check_outputs({"--hash": file}, [rig_file, *([against] if against is not None else [])])
    other = None if against is None else _other(against)
    kept = RowsFile(file, {"digests": 1, "source": source_of(rig_file), "computer": _computer()})
    rigs = played_rows.rigs(rig_file)
    rows, draws = (played_rows.every(rigs), range(drawn_runs.COUNT)) if every else (played_rows.default(rigs), ())
    with progress("digests", len(rows) + len(draws)) as advance:
        play.play(rigs, rows, kept, advance, draws)
    found = {key: kept.get(key) for key in _keys(rows, draws)}
    print_line(f"{len(found)} rows, sum {comparison.sum_of(found)}")
    for key, digests in found.items():
        for error, text in digests.get("not played", {}).items():
            print_line(f"{key}: not played: {error}: {text}")
    if other is None:
        return 0
    larger = {*_keys(played_rows.every(rigs), range(drawn_runs.COUNT))}
    return _compare(found, {key: row for key, row in other.items() if key in found or key not in larger})


def _keys(rows: Iterable[PlayedRow], draws: Iterable[int]) -> list[str]:
    return [*(row.key for row in rows), *map(drawn_runs.key, draws)]


def _other(file: pathlib.Path) -> dict[str, Any]:
    study, rows = rows_file.read(file)
    if study.get("digests") != 1:
        raise ScenarioError([f"--against: {file} holds rows of another study, expected digests"])
    if study.get("computer") != _computer():
        raise ScenarioError(
            [f"--against: {file} was made on another computer ({study.get('computer')}), whose arithmetic may differ"]
        )
    return rows


def _compare(found: dict[str, Any], other: dict[str, Any]) -> int:
    """Print what differs. ``other`` without the rows of the larger set that this run was not to play."""
    moved = comparison.moved(found, other)
    for row in moved:
        print_line(f"{row.key}: {listed(row.names)}")
    return conclude("row", found, other, [f"{row.key}, {row.names[0]}" for row in moved])


def source_of(rig_file: pathlib.Path) -> str:
    """Digest of the program and of the rig files: rows of another source are not gone on with."""
    found = hashlib.sha256()
    for folder in (*map(_folder, (rigctl, hil)), rig_file.parent):
        for file in sorted(folder.rglob("*")):
            if file.suffix in _SOURCES:
                found.update(f"{file.relative_to(folder)}\n".encode() + file.read_bytes())
    found.update(rig_file.name.encode())
    return found.hexdigest()[:16]


def _folder(package: Any) -> pathlib.Path:
    return pathlib.Path(package.__file__).parent


def _computer() -> str:
    """What decides how floating-point numbers are rounded."""
    return f"{platform.machine()} {_processor()}, numpy {np.__version__}, Python {platform.python_version()}"


def _processor() -> str:
    try:
        lines = pathlib.Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    return next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), "")
