"""``python -m hil moves``: play the repeated moves, print their figures, and write the requested files."""

from __future__ import annotations

import pathlib
from collections.abc import Sequence

from hil.cli.files import check_folder, check_names, check_outputs, publish, say, simulated_rig
from hil.runs.result_table import console
from hil.studies.moves import moves_output, repeated_moves
from rigctl.cli.progress import progress

WIDTH = 100


def run(rig_file: pathlib.Path, only: Sequence[str], json: pathlib.Path | None, folder: pathlib.Path | None) -> int:
    """Play the variants, print the table, write the requested files.

    Args:
        rig_file: with the ``simulation`` section.
        only: variants to play; none = all.
        json: file for the figures.
        folder: folder for the picture; made if absent.

    Returns:
        0 when every run reached its end, 1 when one tripped.

    Raises:
        ScenarioError: bad input, or a rig that cannot be simulated.
        OutputError: a file that cannot be written.
    """
    rig = simulated_rig(rig_file)
    every = repeated_moves.variants()
    check_names("--only", only, [variant.name for variant in every])
    chosen = [variant for variant in every if not only or variant.name in only]
    check_outputs({"--json": json}, [rig_file])
    check_folder("--plots", folder, moves_output.PICTURE)
    total = sum(piece.cost for piece in repeated_moves.pieces(rig, chosen).values())
    with progress("the moves", total) as advance:
        found = repeated_moves.study(rig, chosen, advance)
    publish(json, moves_output.document(found), lambda: moves_output.show(found, chosen, console(WIDTH)))
    if folder is not None and (file := moves_output.draw(found, folder)) is not None:
        say(json, f"{file}")
    return 1 if any(result.ended != "COMPENSATING" for result in found.values()) else 0
