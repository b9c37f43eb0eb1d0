"""``python -m hil faults``: play the catalogue, print it, and write the requested files."""

from __future__ import annotations

import pathlib
from collections.abc import Sequence
from dataclasses import dataclass

from hil.cli.files import check_folder, check_names, check_outputs, publish, simulated_rig
from hil.faults import fault_tables, gateway_kills, kills, lockstep_rows, processes
from hil.faults.catalogue import CATALOGUE, PARKED
from hil.faults.expected import InjectedFault
from hil.faults.judging import naming
from hil.faults.judging.judge import FaultResult
from hil.faults.rows import named_rows
from hil.faults.rows.rows_parked import PARKED as PARKED_MODES
from hil.scenario.errors import ScenarioError
from rigctl.cli.progress import progress
from rigctl.model.states import Mode

NAMES = (*(fault.id for fault in CATALOGUE), *(fault.id for fault in processes.CATALOGUE))
DIAGNOSED = (Mode.COMPENSATING.name, Mode.HOLD.name)


@dataclass(frozen=True)
class Chosen:
    """Rows to play."""

    lockstep: tuple[tuple[InjectedFault, Mode], ...]
    processes: tuple[tuple[processes.ProcessFault, Mode], ...]


def run_kills(rig_file: pathlib.Path, count: int, json: pathlib.Path | None, *, gateway: bool = False) -> int:
    """Kill processes of the real daemon ``count`` times; 0 when neither load, loop nor listeners were affected.

    Args:
        rig_file: with the ``simulation`` section.
        count: how often.
        json: file for the kills and the largest figures.
        gateway: kill the gateway in COMPENSATING, instead of any process in any mode.

    Raises:
        ScenarioError: bad input, or the daemon does not come up or back.
        OutputError: a file that cannot be written.
    """
    rig = simulated_rig(rig_file)
    check_outputs({"--json": json}, [rig_file])
    with progress("the gateway" if gateway else "kills", count) as advance:
        if gateway:
            found = gateway_kills.play(rig, count, advance).as_dict()
        else:
            found = kills.document(kills.play(rig, count, advance))
    publish(json, found, lambda: fault_tables.show_kills(found))
    return 0 if found["ok"] else 1


def run(rig_file: pathlib.Path, only: Sequence[str], modes: Sequence[str], json: pathlib.Path | None) -> int:
    """Play the requested rows, print them, write the requested file.

    Args:
        rig_file: with the ``simulation`` section.
        only: ids of faults; none = all.
        modes: names of modes, HOLD_PARKED and FAULT_PARKED among them; none = all.
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
        rows = lockstep_rows.play(rig, chosen.lockstep, advance)
        rows += processes.play(rig, chosen.processes, advance)
    publish(json, document(rows), lambda: fault_tables.show(rows))
    return 0 if all(row.ok for row in rows) else 1


def run_diagnosis(
    rig_file: pathlib.Path, folder: pathlib.Path, only: Sequence[str], modes: Sequence[str], json: pathlib.Path | None
) -> int:
    """Name the culprit of every row that trips; print the confusion matrix and what is wrong.

    Args:
        rig_file: with the ``simulation`` section.
        folder: has, or gets, the window of each row; those it has are not played again.
        only: ids of faults; none = all.
        modes: names of modes; none = COMPENSATING and HOLD.
        json: file for the rows.

    Returns:
        0 when enough culprits are right and nobody is sent to a loose load, else 1.

    Raises:
        ScenarioError: bad input, or a rig that cannot be simulated.
        OutputError: a file that cannot be written.
    """
    rig = simulated_rig(rig_file)
    check_names("--mode", modes, [mode.name for mode in Mode])
    chosen = choose(only, modes or DIAGNOSED).lockstep
    check_folder("--diagnosis", folder, "row.npz")
    check_outputs({"--json": json}, [rig_file])
    with progress("culprits", len(chosen)) as advance:
        rows, unplayed = named_rows.play(rig, chosen, folder, advance)
    counted = {str(kind): count for kind, count in naming.shares(rows).items()}
    ok = naming.good(rows) and not unplayed
    found = {"rows": [row.as_dict() for row in rows], **counted, "total": len(rows), "ok": ok}
    publish(json, found, lambda: fault_tables.show_named(rows, unplayed))
    return 0 if ok else 1


def choose(only: Sequence[str], modes: Sequence[str]) -> Chosen:
    """The rows of these faults in these modes.

    Raises:
        ScenarioError: unknown fault or mode, or no row at all.
    """
    check_names("--only", only, NAMES)
    check_names("--mode", modes, [*(mode.name for mode in Mode), *PARKED_MODES])
    wanted = [mode for mode in Mode if not modes or mode.name in modes]
    named = [fault for fault in CATALOGUE if not only or fault.id in only]
    parked = [mode for name, mode in PARKED_MODES.items() if not modes or name in modes]
    on_brake = [PARKED[fault.id] for fault in named if fault.id in PARKED]
    lockstep = tuple((f, m) for f in named for m in f.modes if m in wanted)
    lockstep += tuple((f, m) for f in on_brake for m in f.modes if m in parked)
    real = tuple((p, m) for p in processes.CATALOGUE if not only or p.id in only for m in p.expected if m in wanted)
    if not lockstep and not real:
        raise ScenarioError(
            [f"--mode: found {', '.join(modes)}, expected a mode in which {', '.join(only)} can happen"]
        )
    return Chosen(lockstep, real)


def document(rows: Sequence[FaultResult]) -> dict[str, object]:
    """The content of the ``--json`` file."""
    return {"faults": [row.as_dict() for row in rows], "ok": all(row.ok for row in rows), "total": len(rows)}


def show_list() -> None:
    """Print every fault, its description, and the expected reaction in each mode."""
    fault_tables.show_list([*CATALOGUE, *processes.CATALOGUE])
