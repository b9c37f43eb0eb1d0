"""``python -m hil scenario``: from the file to the exit code."""

from __future__ import annotations

import json as json_codec
import pathlib
import sys

from rich.console import Console

from hil.scenario import output
from hil.scenario.case import Case, load
from hil.scenario.errors import ScenarioError
from hil.scenario.play import Played, play
from hil.scenario.plot import SUFFIXES, plot
from rigctl.cli.progress import progress
from rigctl.config import rig_file as config
from rigctl.config.settings import RigSettings
from rigctl.ipc import output_file

STANDARD_OUTPUT = pathlib.Path("-")


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
    check_outputs({"--json": None if json == STANDARD_OUTPUT else json, "--plot": picture}, inputs)
    played = _play(case)
    said = output.as_dict(case, played)
    text = json_codec.dumps(said, indent=2, allow_nan=False) + "\n"
    if json is not None and json != STANDARD_OUTPUT:
        output_file.write(json, text)
    if picture is not None:
        with output_file.writing(picture):
            plot(case, played, picture)
    if json == STANDARD_OUTPUT:
        sys.stdout.write(text)
    else:
        output.show(said, Console(soft_wrap=True))
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


def check_outputs(outputs: dict[str, pathlib.Path | None], inputs: list[pathlib.Path]) -> None:
    """Refuse, before a long run, outputs that could not be written after it or would overwrite an input.

    Args:
        outputs: files by option.
        inputs: files that were read.

    Raises:
        ScenarioError: two outputs are one file, or one is an input.
        OutputError: one cannot be written.
    """
    taken = {file.resolve() for file in inputs}
    for option, file in outputs.items():
        if file is None:
            continue
        if file.resolve() in taken:
            raise ScenarioError([f"{option}: {file} is in use already, expected a file of its own"])
        taken.add(file.resolve())
        output_file.check(option, file)


def check_folder(option: str, folder: pathlib.Path | None, first: str) -> None:
    """Make a folder for plots, and refuse one that the plot ``first`` could not be written to."""
    if folder is None:
        return
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ScenarioError([f"{option}: {folder} cannot be made: {error.strerror}"]) from None
    output_file.check(option, folder / first)


def simulated_rig(rig_file: pathlib.Path) -> RigSettings:
    """A rig file with a ``simulation`` section."""
    try:
        rig = config.load(rig_file)
    except config.ConfigError as error:
        raise ScenarioError(error.findings) from None
    if rig.simulation is None:
        raise ScenarioError(
            [f"{rig_file}: simulation: found nothing, expected a section (it says what rig to simulate)"]
        )
    return rig
