"""``python -m hil faults --draw N``: play drawn pairs of faults, print what the load did, write each miss as a file."""

from __future__ import annotations

import pathlib
from collections.abc import Sequence

from rich.console import Console

from hil.cli.files import check_folder, check_outputs, publish, simulated_rig
from hil.faults import fault_tables
from hil.faults.drawn import draw_file, named_draws, played_draws
from hil.faults.drawn.draw import BLOCK
from hil.faults.drawn.played_draws import Judged
from hil.faults.judging import naming
from hil.runs.rows_file import RowsFile
from hil.scenario.errors import ScenarioError
from rigctl import __version__
from rigctl.cli.progress import progress
from rigctl.config.settings import RigSettings
from rigctl.config.typed_number import TypedNumber, TypedNumberError

MISSES = pathlib.Path("misses")
"""Folder for the files of misses."""


def run(
    rig_file: pathlib.Path, count: int, seed: int, only: Sequence[str], json: pathlib.Path | None,
    rows: pathlib.Path | None = None,
) -> int:  # fmt: skip
    """Play draws 0 to ``count`` - 1 of a seed; 1 if a load moved beyond the bound, else 0.

    Args:
        rig_file: with the ``simulation`` section.
        count: how many.
        seed: of all draws.
        only: numbers to play; none = all.
        json: file for the verdicts.
        rows: file that keeps each draw as it is played, and those of a run that was stopped.

    Raises:
        ScenarioError: bad input.
        OutputError: a file that cannot be written.
    """
    rig = simulated_rig(rig_file)
    indices = _numbers(only, count) or list(range(count))
    check_outputs({"--json": json, "--rows": rows}, [rig_file])
    kept = RowsFile(rows, study_of(rig, seed))
    with progress("drawn faults", len(indices)) as advance:
        judged, seconds = played_draws.drawn(rig, seed, indices, advance, kept, _write_miss)
    return _shown(judged, json, seconds)


def run_named(rig_file: pathlib.Path, count: int, seed: int, json: pathlib.Path | None) -> int:
    """Name the culprits of the first faults of ``count`` draws, whole blocks of them; 0 when enough are right, else 1.

    Raises:
        ScenarioError: bad input.
        OutputError: a file that cannot be written.
    """
    rig = simulated_rig(rig_file)
    check_outputs({"--json": json}, [rig_file])
    blocks = range(-(-count // BLOCK))
    with progress("culprits of drawn faults", BLOCK * len(blocks)) as advance:
        rows = named_draws.play(rig, seed, blocks, advance)
    ok = naming.good(rows)
    found = {"rows": [row.as_dict() for row in rows], "drawn": BLOCK * len(blocks), "total": len(rows), "ok": ok}
    publish(json, found, lambda: fault_tables.show_named(rows, []))
    return 0 if ok else 1


def study_of(rig: RigSettings, seed: int) -> dict[str, object]:
    """What rows are of: the rig file wherever it is."""
    return {"drawn": seed, "rigctl": __version__, "rig": rig.model_dump(mode="json", exclude={"directory"})}


def _write_miss(judged: Judged) -> None:
    if not judged[1].ok:
        check_folder("the misses", MISSES, _name(judged))
        draw_file.write(MISSES / _name(judged), judged[0], judged[1].findings)


def replay(rig_file: pathlib.Path, file: pathlib.Path, json: pathlib.Path | None) -> int:
    """Play the draw of a file; 1 if the load moved beyond the bound, else 0.

    Raises:
        ScenarioError: bad input.
        OutputError: a file that cannot be written.
    """
    rig = simulated_rig(rig_file)
    draw = draw_file.read(file)
    check_outputs({"--json": json}, [rig_file, file])
    return _shown([played_draws.replayed(rig, draw)], json)


def _numbers(only: Sequence[str], count: int) -> list[int]:
    draw = TypedNumber(least=0, most=count - 1, whole=True)
    try:
        return sorted({int(draw.read(text)) for text in only})
    except TypedNumberError as error:
        raise ScenarioError([f"--only: {error}"]) from None


def _name(judged: Judged) -> str:
    return f"draw_{judged[0].seed}_{judged[0].index}.yaml"


def _shown(judged: Sequence[Judged], json: pathlib.Path | None, seconds: float = 0.0) -> int:
    """Print the misses and the sum of all, and write the requested file; ``seconds``: processor time it took."""
    missed = [(draw, verdict) for draw, verdict in judged if not verdict.ok]
    found = {
        "draws": [played_draws.as_row(one) for one in judged],
        "bad": len(missed), "ok": not missed, "total": len(judged),
    }  # fmt: skip
    publish(json, found, lambda: _show(judged, missed, seconds))
    return 1 if missed else 0


def _show(judged: Sequence[Judged], missed: Sequence[Judged], seconds: float) -> None:
    console = Console(soft_wrap=True, highlight=False)
    for draw, verdict in missed:
        console.print(f"draw {draw.index}: {draw.course}, {draw.rig.spring_n_mm:g} N/mm, {draw.rig.target_n:g} N")
        for line in (*(fault.words for fault in draw.faults), *verdict.trips, *verdict.findings):
            console.print(f"  {line}", markup=False)
    seen = [verdict.moved_n / verdict.allowed_n for _, verdict in judged]
    unseen = [verdict.unseen_n / verdict.cap_n for _, verdict in judged]
    console.print(
        f"{len(judged)} draws: {len(missed)} beyond the bound; at most {100 * max(seen):.0f} % of the allowed motion "
        f"once seen, {100 * max(unseen):.0f} % of the cap"
    )
    if seconds:
        console.print(f"{seconds:.0f} s of processor time")
