"""``python -m hil faults --hash``: digests of many runs, and their comparison with those of another commit."""

from __future__ import annotations

import hashlib
import pathlib
import platform
import sys
from typing import Any

import numpy as np

import hil
import rigctl
from hil.cli.files import check_outputs, simulated_rig
from hil.faults.digests import comparison, play, played_rows
from hil.faults.digests.comparison import MovedRow
from hil.scenario.errors import ScenarioError
from hil.study import rows_file
from hil.study.rows_file import RowsFile
from rigctl.cli.progress import progress

_NAMES_SHOWN = 6
_SOURCES = frozenset({".py", ".yaml", ".eds", ".dbc"})


def run(rig_file: pathlib.Path, file: pathlib.Path, against: pathlib.Path | None) -> int:
    """Play the default set, write its digests into ``file``, and compare them with those of another file.

    Rows that ``file`` has already, of the same source, are not played again.

    Args:
        rig_file: with the ``simulation`` section.
        file: gets the digests, a line of JSON for each row.
        against: digests of another commit, made on the same computer.

    Returns:
        0 when nothing is compared or all is equal, else 1.

    Raises:
        ScenarioError, ConfigError: bad input, or a rig that cannot be simulated.
        OutputError: the file cannot be written.
    """
    simulated_rig(rig_file)
    check_outputs({"--hash": file}, [rig_file, *([against] if against is not None else [])])
    other = None if against is None else _other(against)
    kept = RowsFile(file, {"digests": 1, "source": source_of(rig_file), "computer": _computer()})
    rigs = played_rows.rigs(rig_file)
    rows = played_rows.default(rigs)
    with progress("digests", len(rows)) as advance:
        play.play(rigs, rows, kept, advance)
    found = {row.key: kept.get(row.key) for row in rows}
    _print(f"{len(found)} rows, sum {comparison.sum_of(found)}")
    for key, digests in found.items():
        for error, text in digests.get("not played", {}).items():
            _print(f"{key}: not played: {error}: {text}")
    return 0 if other is None else _compare(found, other)


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
    moved = comparison.moved(found, other)
    for row in moved:
        _print(f"{row.key}: {_names(row)}")
    if not moved:
        _print("equal")
        return 0
    first = moved[0]
    _print(f"{len(moved)} of {len(found)} rows differ; the first: {first.key}, {first.names[0]}")
    return 1


def _names(row: MovedRow) -> str:
    more = f" and {len(row.names) - _NAMES_SHOWN} more" if len(row.names) > _NAMES_SHOWN else ""
    return ", ".join(row.names[:_NAMES_SHOWN]) + more


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


def _print(text: str) -> None:
    sys.stdout.write(text + "\n")
