"""``python -m hil compare``: run the comparison, print it, and write the requested files."""

from __future__ import annotations

import pathlib
from collections.abc import Sequence

from hil.cli.files import check_folder, check_names, check_outputs, publish, say, simulated_rig
from hil.runs.result_table import console
from hil.studies.compare import comparison, comparison_charts, comparison_tables
from hil.studies.compare.compared_runs import QUICK, compared_runs
from hil.studies.compare.rivals import LAWS, OURS
from rigctl.cli.progress import progress

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
    runs = compared_runs(rig)
    names = [name for part in controllers for name in part.split(",")]
    check_names("--only", only, [run.name for run in runs])
    check_names("--controllers", names, list(LAWS))
    wanted = only or (QUICK if quick else ())
    chosen = [run for run in runs if not wanted or run.name in wanted]
    laws = [law for law in LAWS.values() if not names or law.name in names]
    check_outputs({"--json": json}, [rig_file])
    check_folder("--plots", folder, comparison_charts.FIRST)
    total = sum(piece.cost for piece in comparison.pieces(rig, chosen, laws).values())
    with progress("the comparison", total) as advance:
        found = comparison.compare(rig, chosen, laws, advance)
    publish(json, comparison_tables.document(found), lambda: comparison_tables.show(found, console(WIDTH)))
    for file in comparison_charts.save(found, folder) if folder is not None else ():
        say(json, f"{file}")
    return 1 if any(law == OURS and not result.whole for (_, law), result in found.results.items()) else 0
