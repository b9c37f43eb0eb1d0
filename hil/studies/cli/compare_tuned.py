"""``python -m hil compare --shares``, ``--random``, ``--front`` and ``--bound``: laws tuned by one optimiser."""

from __future__ import annotations

import pathlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from hil.cli.files import check_names, check_outputs, json_text, publish, say, simulated_rig
from hil.runs.result_table import console
from hil.runs.rows_file import RowsFile
from hil.scenario.errors import ScenarioError
from hil.studies.compare import equal_limits, front, random_rigs, random_tables, shares, tuned_laws
from hil.studies.compare.compared_runs import compared_runs
from hil.studies.compare.groups import GROUPS
from hil.studies.compare.rivals import OURS
from rigctl.config.settings import RigSettings
from rigctl.design import gain_file
from rigctl.design.linear_errors import references_n
from rigctl.ipc import output_file

WIDTH = 132


@dataclass(frozen=True)
class Asked:
    """The options that the studies have in common; see ``python -m hil compare --help``."""

    only: Sequence[str]
    controllers: Sequence[str]
    json: pathlib.Path | None
    rows: pathlib.Path | None
    designs: int | None = None

    def say(self, line: str) -> None:
        """Print a line; on standard error, where standard output takes JSON."""
        say(self.json, line)

    def laws(self, allowed: Sequence[str], default: Sequence[str]) -> list[str]:
        """The laws named; by default those of ``default``."""
        names = [name for part in self.controllers for name in part.split(",")]
        check_names("--controllers", names, allowed)
        return [law for law in allowed if law in (names or default)]


def run_bound(rig_file: pathlib.Path, asked: Asked) -> int:
    """Our law against the convex bound; returns 0, or 1 when ours is below it.

    Raises:
        ScenarioError: bad input, or a rig that cannot be simulated.
        OutputError: a file that cannot be written.
    """
    from hil.studies.compare.bound import bound_tables, study  # the solver takes seconds to load
    from hil.studies.compare.bound.linear_law import NoBoundError

    rig = _rig(rig_file, asked)
    asked.laws((OURS,), (OURS,))
    runs = compared_runs(rig)
    every = study.names(runs)
    check_names("--only", asked.only, every)
    kept = RowsFile(asked.rows, _of(rig, asked))
    try:
        found, joint = study.study(rig, runs, asked.only or every, kept, asked.say, asked.designs)
    except NoBoundError as error:
        raise ScenarioError([f"{rig_file}: {error}"]) from None
    figures = study.document(rig, found, joint)
    publish(asked.json, figures, lambda: bound_tables.show_bound(rig, found, joint, console(WIDTH)))
    return int(any(row.below for row in found))


def run_shares(rig_file: pathlib.Path, file: pathlib.Path, asked: Asked) -> int:
    """Every law by groups of runs, over three seeds, and the joint bounds; they are written to a file.

    Returns 0, or 1 when our law did not reach the end of a run. Raises: as `run_bound`.
    """
    from hil.studies.compare import shares_tables
    from hil.studies.compare.bound import group_bounds, joint_groups  # the solver takes seconds to load
    from hil.studies.compare.bound.linear_law import NoBoundError

    rig = _rig(rig_file, asked, {"--shares": file})
    laws, runs = asked.laws(equal_limits.COMPARED, equal_limits.COMPARED), compared_runs(rig)
    every = [*GROUPS, shares.JOINT]
    check_names("--only", asked.only, every)
    wanted = asked.only or every
    rows = RowsFile(asked.rows, _of(rig, asked))
    found = shares.study(
        rig, runs, [group for group in GROUPS if group in wanted], laws, rows, asked.say,
        lambda run: group_bounds.bound_pct(rig, run, rows), asked.designs,
    )  # fmt: skip
    joint: list[joint_groups.JointGroups] = []
    if shares.JOINT in wanted:
        try:
            joint = joint_groups.study(rig, runs, found.least_by_case(joint_groups.RUNS), rows, asked.say)
        except NoBoundError as error:
            raise ScenarioError([f"{rig_file}: {error}"]) from None
    figures = shares.document(found, [joint_groups.as_json(one) for one in joint])
    output_file.write(file, json_text(figures))
    publish(asked.json, figures, lambda: shares_tables.show(found, joint, console(WIDTH)))
    asked.say(str(file))
    return int(bool(found.ended_early()))


def run_random(rig_file: pathlib.Path, count: int, seed: int, asked: Asked) -> int:
    """Random rigs; returns 0, or 1 when our identified law tripped on one, or has Ms above the limit there.

    Raises: as `run_bound`.
    """
    allowed = (*equal_limits.COMPARED, random_rigs.ASSUMED)
    rig, laws = _rig(rig_file, asked), asked.laws(allowed, random_rigs.DEFAULT_LAWS)
    rows = RowsFile(asked.rows, {**_of(rig, asked), "seed": seed})
    found = random_rigs.study(rig, count, seed, laws, rows, asked.say, asked.designs)
    limit = rig.design.ms_max
    said = random_rigs.summary(found, limit)
    document = {"seed": seed, "laws": said, "rigs": [row._asdict() for row in found]}
    publish(asked.json, document, lambda: random_tables.show_random(found, limit, console(WIDTH)))
    return int(OURS in said and said[OURS]["ended_early"] + said[OURS]["ms_above"] > 0)


def run_front(rig_file: pathlib.Path, file: pathlib.Path, asked: Asked) -> int:
    """Draw the front of error against Ms; returns 0.

    Raises: as `run_bound`.
    """
    rig, laws = _rig(rig_file, asked, {"--front": file}), asked.laws(equal_limits.COMPARED, equal_limits.COMPARED)
    points = front.points(rig, laws, RowsFile(asked.rows, _of(rig, asked)), asked.say)
    front.draw(rig, points, file)
    publish(asked.json, {"points": [point._asdict() for point in points]}, lambda: None)
    asked.say(str(file))
    return 0


def _rig(rig_file: pathlib.Path, asked: Asked, outputs: Mapping[str, pathlib.Path] | None = None) -> RigSettings:
    check_outputs({"--json": asked.json, **(outputs or {})}, [rig_file])
    return simulated_rig(rig_file)


def _of(rig: RigSettings, asked: Asked) -> dict[str, Any]:
    """What rows are of."""
    assert rig.simulation is not None  # `simulated_rig` refuses a rig without it
    limits = {"ms": rig.design.ms_max, "command_noise_mm_s": rig.design.command_noise_max_mm_s}
    return {
        "law": tuned_laws.LAW_VERSION, "rig": rig.rig, "inputs": gain_file.inputs(rig), "limits": limits,
        "simulation": rig.simulation.model_dump(mode="json"), "references": references_n(rig),
        "starts": tuned_laws.STARTS, "designs": asked.designs or list(tuned_laws.EVALUATIONS.values()),
    }  # fmt: skip
