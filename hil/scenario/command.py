"""``python -m hil scenario``: from the file to the exit code."""

from __future__ import annotations

import json as json_codec
import os
import pathlib
import sys

from rich.console import Console

from hil.progress import progress
from hil.scenario import output
from hil.scenario.case import Case, load
from hil.scenario.errors import ScenarioError
from hil.scenario.play import Played, play
from hil.scenario.plot import SUFFIXES, plot
from rigctl import config
from rigctl.config import RigSettings

STANDARD_OUTPUT = pathlib.Path("-")


def run(file: pathlib.Path, json: pathlib.Path | None, picture: pathlib.Path | None) -> int:
    """Play the scenario of ``file``, print its figures, write the files asked for; 1 if the rig tripped, else 0.

    Args:
        file: scenario file.
        json: where the figures go; ``-`` prints them instead of the table.
        picture: where the picture goes.

    Raises:
        ScenarioError: bad input, or a file that cannot be written.
    """
    case = load(file)
    if picture is not None and picture.suffix.lower() not in SUFFIXES:
        raise ScenarioError([f"--plot: found {picture}, allowed a name ending in {', '.join(SUFFIXES)}"])
    check_writable("--json", None if json == STANDARD_OUTPUT else json)
    check_writable("--plot", picture)
    played = _play(case)
    said = output.as_dict(case, played)
    text = json_codec.dumps(said, indent=2, allow_nan=False) + "\n"
    try:
        if json is not None and json != STANDARD_OUTPUT:
            json.write_text(text, encoding="utf-8")
        if picture is not None:
            plot(case, played, picture)
    except OSError as error:
        raise ScenarioError([f"{error.filename or picture}: cannot be written: {error.strerror}"]) from None
    try:
        if json == STANDARD_OUTPUT:
            sys.stdout.write(text)
        else:
            output.show(said, Console(soft_wrap=True))
        sys.stdout.flush()
    except BrokenPipeError:  # whoever read it has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
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


def check_writable(option: str, file: pathlib.Path | None) -> None:
    """Refuse before a long run what could not be written after it."""
    if file is None:
        return
    new = not file.exists()
    try:
        file.open("ab").close()
        if new:
            file.unlink()
    except OSError as error:
        raise ScenarioError([f"{option}: {file} cannot be written: {error.strerror}"]) from None


def check_folder(option: str, folder: pathlib.Path | None, first: str) -> None:
    """Make a folder for pictures, and refuse one that the picture ``first`` could not be written to."""
    if folder is None:
        return
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ScenarioError([f"{option}: {folder} cannot be made: {error.strerror}"]) from None
    check_writable(option, folder / first)


def simulated_rig(rig_file: pathlib.Path) -> RigSettings:
    """A rig file that says what rig to simulate."""
    try:
        rig = config.load(rig_file)
    except config.ConfigError as error:
        raise ScenarioError(error.findings) from None
    if rig.simulation is None:
        raise ScenarioError(
            [f"{rig_file}: simulation: found nothing, allowed a section (it says what rig to simulate)"]
        )
    return rig
