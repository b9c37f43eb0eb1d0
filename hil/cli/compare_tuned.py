"""``python -m hil compare --equal-limits``, ``--random`` and ``--front``: laws tuned by one optimiser."""

from __future__ import annotations

import pathlib
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from hil.cli.files import check_names, check_outputs, simulated_rig, write_json
from hil.compare import equal_limits, front, random_rigs, tuned_tables
from hil.compare.compared_runs import QUICK, compared_runs
from hil.compare.rivals import OURS
from hil.study.result_table import console
from hil.study.rows_file import RowsFile
from rigctl.config.settings import RigSettings
from rigctl.design import gain_file

WIDTH = 132


@dataclass(frozen=True)
class Asked:
    """The options that the studies have in common; see ``python -m hil compare --help``."""

    only: Sequence[str]
    controllers: Sequence[str]
    json: pathlib.Path | None
    rows: pathlib.Path | None
    quick: bool = False

    def laws(self, allowed: Sequence[str], default: Sequence[str]) -> list[str]:
        """The laws named; by default those of ``default``."""
        names = [name for part in self.controllers for name in part.split(",")]
        check_names("--controllers", names, allowed)
        return [law for law in allowed if law in (names or default)]


def run_equal_limits(rig_file: pathlib.Path, asked: Asked) -> int:
    """Tune and play; returns 0, or 1 when our law did not reach the end of a run.

    Raises:
        ScenarioError: bad input, or a rig that cannot be simulated.
        OutputError: a file that cannot be written.
    """
    rig, laws = _rig(rig_file, asked), asked.laws(equal_limits.COMPARED, equal_limits.COMPARED)
    runs = compared_runs(rig)
    check_names("--only", asked.only, [run.name for run in runs])
    wanted = asked.only or (QUICK if asked.quick else ())
    chosen = [run for run in runs if not wanted or run.name in wanted]
    found = equal_limits.study(rig, chosen, laws, RowsFile(asked.rows, _of(rig)), _say)
    tuned_tables.show_equal_limits(found, console(WIDTH))
    write_json(asked.json, equal_limits.document(found))
    return int(any(law == OURS and row.eta_rms_pct is None for (_, law), row in found.outcomes.items()))


def run_random(rig_file: pathlib.Path, count: int, seed: int, asked: Asked) -> int:
    """Random rigs; returns 0, or 1 when our identified law tripped or has Ms above the limit on one.

    Raises: as `run_equal_limits`.
    """
    allowed = (*equal_limits.COMPARED, random_rigs.ASSUMED)
    rig, laws = _rig(rig_file, asked), asked.laws(allowed, random_rigs.DEFAULT_LAWS)
    found = random_rigs.study(rig, count, seed, laws, RowsFile(asked.rows, {**_of(rig), "seed": seed}), _say)
    limit = rig.design.ms_max
    tuned_tables.show_random(found, limit, console(WIDTH))
    said = random_rigs.summary(found, limit)
    write_json(asked.json, {"seed": seed, "laws": said, "rigs": [row._asdict() for row in found]})
    return int(OURS in said and said[OURS]["ended_early"] + said[OURS]["ms_above"] > 0)


def run_front(rig_file: pathlib.Path, file: pathlib.Path, asked: Asked) -> int:
    """Draw the front of error against Ms; returns 0.

    Raises: as `run_equal_limits`.
    """
    rig, laws = _rig(rig_file, asked, file), asked.laws(equal_limits.COMPARED, equal_limits.COMPARED)
    points = front.points(rig, laws, RowsFile(asked.rows, _of(rig)), _say)
    front.draw(rig, points, file)
    write_json(asked.json, {"points": [point._asdict() for point in points]})
    _say(str(file))
    return 0


def _rig(rig_file: pathlib.Path, asked: Asked, picture: pathlib.Path | None = None) -> RigSettings:
    check_outputs({"--json": asked.json, "--front": picture}, [rig_file])
    return simulated_rig(rig_file)


def _of(rig: RigSettings) -> dict[str, Any]:
    """What rows are of."""
    assert rig.simulation is not None  # `simulated_rig` refuses a rig without it
    limits = {"ms": rig.design.ms_max, "command_noise_mm_s": rig.design.command_noise_max_mm_s}
    return {
        "rig": rig.rig, "inputs": gain_file.inputs(rig), "limits": limits,
        "simulation": rig.simulation.model_dump(mode="json"),
    }  # fmt: skip


def _say(line: str) -> None:
    sys.stdout.write(line + "\n")
    sys.stdout.flush()
