"""``python -m hil faults``: play the catalogue, print it, and write the requested files."""

from __future__ import annotations

import json as json_codec
import pathlib
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

from hil.cli.scenario import check_outputs, simulated_rig
from hil.faults import gateway_kills as gateway
from hil.faults import kills, processes
from hil.faults import lockstep_rows as study
from hil.faults import printing as output
from hil.faults.catalogue import CATALOGUE
from hil.faults.expected import InjectedFault
from hil.faults.judge import Row
from hil.scenario.errors import ScenarioError
from rigctl.cli.progress import progress
from rigctl.control.modes import Mode
from rigctl.ipc import output_file

NAMES = (*(fault.id for fault in CATALOGUE), *(fault.id for fault in processes.CATALOGUE))


@dataclass(frozen=True)
class Chosen:
    """Rows to play."""

    lockstep: tuple[tuple[InjectedFault, Mode], ...]
    processes: tuple[tuple[processes.ProcessFault, Mode], ...]


def run_kills(rig_file: pathlib.Path, count: int, json: pathlib.Path | None) -> int:
    """Kill and stop processes of the real daemon ``count`` times; 0 when the load was never affected.

    Raises:
        ScenarioError: bad input, or the daemon does not come up or back.
        OutputError: a file that cannot be written.
    """
    rig = simulated_rig(rig_file)
    check_outputs({"--json": json}, [rig_file])
    with progress("kills", count) as advance:
        found = kills.document(kills.play(rig, count, advance))
    output.show_kills(found)
    _write(json, found)
    return 0 if found["ok"] else 1


def run_gateway(rig_file: pathlib.Path, count: int, json: pathlib.Path | None) -> int:
    """Kill the gateway ``count`` times in COMPENSATING; 0 when loop and listeners were unaffected. See `run_kills`."""
    rig = simulated_rig(rig_file)
    check_outputs({"--json": json}, [rig_file])
    with progress("the gateway", count) as advance:
        found = gateway.play(rig, count, advance).as_dict()
    output.show_figures(found)
    _write(json, found)
    return 0 if found["ok"] else 1


def run(rig_file: pathlib.Path, only: Sequence[str], modes: Sequence[str], json: pathlib.Path | None) -> int:
    """Play the requested rows, print them, write the requested file.

    Args:
        rig_file: with the ``simulation`` section.
        only: ids of faults; none = all.
        modes: names of modes; none = all.
        json: file for the rows.

    Returns:
        0 when every row is as expected, else 1.

    Raises:
        ScenarioError: bad input, or a rig that cannot be simulated.
        OutputError: a file that cannot be written.
    """
    rig = simulated_rig(rig_file)
    chosen = choose(only, modes)
    check_outputs({"--json": json}, [rig_file])
    with progress("the fault catalogue", len(chosen.lockstep) + len(chosen.processes)) as advance:
        rows = study.play(rig, chosen.lockstep, advance)
        rows += processes.play(rig, chosen.processes, advance)
    output.show(rows)
    _write(json, document(rows))
    return 0 if all(row.ok for row in rows) else 1


def choose(only: Sequence[str], modes: Sequence[str]) -> Chosen:
    """The rows of these faults in these modes.

    Raises:
        ScenarioError: unknown fault or mode, or no row at all.
    """
    _known("--only", only, NAMES)
    _known("--mode", modes, [mode.name for mode in Mode])
    wanted = [mode for mode in Mode if not modes or mode.name in modes]
    lockstep = tuple((f, m) for f in CATALOGUE if not only or f.id in only for m in f.modes if m in wanted)
    real = tuple((p, m) for p in processes.CATALOGUE if not only or p.id in only for m in p.expected if m in wanted)
    if not lockstep and not real:
        raise ScenarioError(
            [f"--mode: found {', '.join(modes)}, expected a mode in which {', '.join(only)} can happen"]
        )
    return Chosen(lockstep, real)


def document(rows: Sequence[Row]) -> dict[str, object]:
    """The content of the ``--json`` file."""
    return {"faults": [row.as_dict() for row in rows], "ok": all(row.ok for row in rows), "total": len(rows)}


def _write(file: pathlib.Path | None, found: Mapping[str, object]) -> None:
    if file is not None:
        output_file.write(file, json_codec.dumps(found, indent=2, allow_nan=False) + "\n")


def show_list() -> None:
    """Print every fault, its description, and the expected reaction in each mode."""
    output.show_list([*CATALOGUE, *processes.CATALOGUE])


def _known(option: str, names: Collection[str], allowed: Sequence[str]) -> None:
    for name in names:
        if name not in allowed:
            raise ScenarioError([f"{option}: found {name!r}, expected {', '.join(allowed)}"])
