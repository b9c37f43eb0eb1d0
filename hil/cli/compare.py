"""``python -m hil compare``: run the comparison, print it, and write the requested files."""

from __future__ import annotations

import json as json_codec
import pathlib
import sys
from collections.abc import Collection, Sequence

from rich.console import Console

from hil.cli.scenario import check_folder, check_outputs, simulated_rig
from hil.compare import plots, study, tables
from hil.compare.rivals import CONTROLLERS, OURS
from hil.compare.scenarios import QUICK, scenarios
from hil.scenario.errors import ScenarioError
from rigctl.cli.progress import progress
from rigctl.ipc import output_file

WIDTH = 100


def run(
    rig_file: pathlib.Path,
    only: Sequence[str],
    controllers: Sequence[str],
    json: pathlib.Path | None,
    folder: pathlib.Path | None,
    *,
    quick: bool = False,
) -> int:
    """Run the comparison, print it, write the requested files.

    Args:
        rig_file: with the ``simulation`` section.
        only: scenarios to run; none = all.
        controllers: laws to run, the names separated by commas in each; none = all.
        json: file for the figures.
        folder: folder for the plots; made if absent.
        quick: the scenarios of ``QUICK`` only, where ``only`` names none.

    Returns:
        0 when it ran to its end; 1 when our law tripped or was unstable anywhere. A limit missed is in the table.

    Raises:
        ScenarioError: bad input, or a rig that cannot be simulated.
        OutputError: a file that cannot be written.
    """
    rig = simulated_rig(rig_file)
    names = [name for part in controllers for name in part.split(",")]
    _known("--only", only, [scenario.name for scenario in scenarios(rig)])
    _known("--controllers", names, [controller.name for controller in CONTROLLERS])
    wanted = only or (QUICK if quick else ())
    chosen = [scenario for scenario in scenarios(rig) if not wanted or scenario.name in wanted]
    laws = [controller for controller in CONTROLLERS if not names or controller.name in names]
    check_outputs({"--json": json}, [rig_file])
    check_folder("--plots", folder, plots.FIRST)
    with progress("the comparison", study.length_s(chosen, laws)) as advance:
        found = study.run(rig, chosen, laws, advance)
    terminal = Console()
    tables.show(found, Console(width=WIDTH) if not terminal.is_terminal or terminal.width > WIDTH else terminal)
    if json is not None:
        output_file.write(json, json_codec.dumps(tables.document(found), indent=2, allow_nan=False) + "\n")
    for file in plots.save(found, folder) if folder is not None else ():
        sys.stdout.write(f"{file}\n")
    return 1 if any(who == OURS and not result.whole for (_, who), result in found.results.items()) else 0


def _known(option: str, names: Collection[str], allowed: Sequence[str]) -> None:
    for name in names:
        if name not in allowed:
            raise ScenarioError([f"{option}: found {name!r}, expected {', '.join(allowed)}"])
