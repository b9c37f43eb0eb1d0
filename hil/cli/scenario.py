"""``python -m hil scenario``: from the file to the exit code."""

from __future__ import annotations

import pathlib

from rich.console import Console

from hil.cli.files import check_outputs, publish
from hil.scenario import output
from hil.scenario.case import Case, load
from hil.scenario.errors import ScenarioError
from hil.scenario.play import Played, play
from hil.scenario.plot import SUFFIXES, plot
from rigctl.cli.progress import progress
from rigctl.ipc import output_file


def run(file: pathlib.Path, json: pathlib.Path | None, picture: pathlib.Path | None) -> int:
    """Play the scenario of ``file``, print its figures, write the requested files; 1 if the rig tripped, else 0.

    Args:
        file: scenario file.
        json: file for the figures; ``-`` prints them instead of the table.
        picture: file for the plot.

    Raises:
        ScenarioError: bad input.
        OutputError: a file that cannot be written.
    """
    case = load(file)
    if picture is not None and picture.suffix.lower() not in SUFFIXES:
        raise ScenarioError([f"--plot: found {picture}, expected a name ending in {', '.join(SUFFIXES)}"])
    inputs = [file, file.parent / case.scenario.rig]
    check_outputs({"--json": json, "--plot": picture}, inputs)
    played = _play(case)
    results = output.as_dict(case, played)
    if picture is not None:
        with output_file.writing(picture):
            plot(case, played, picture)
    publish(json, results, lambda: output.show(results, Console(soft_wrap=True)))
    return 1 if played.ended.tripped else 0


def _play(case: Case) -> Played:
    scenario = case.scenario
    with progress(scenario.scenario, scenario.duration_s) as advance:
        return play(
            case.settings,
            case.tracks,
            seconds=scenario.duration_s,
            controller=scenario.controller,
            target_n=case.target_n,
            settle_s=scenario.settle_s,
            progress=advance,
        )
