"""What the commands read and write: rig files, figures, pictures."""

from __future__ import annotations

import json
import math
import pathlib
import sys
from collections.abc import Callable, Collection, Mapping, Sequence

import numpy as np

from hil.scenario.errors import ScenarioError
from rigctl.cli.json_file import STANDARD_OUTPUT
from rigctl.cli.json_file import complaint as json_complaint
from rigctl.config import rig_file as config
from rigctl.config.settings import RigSettings
from rigctl.ipc import output_file


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


def check_names(option: str, names: Collection[str], allowed: Sequence[str]) -> None:
    """Refuse a name that does not exist."""
    for name in names:
        if name not in allowed:
            raise ScenarioError([f"{option}: found {name!r}, expected {', '.join(allowed)}"])


def check_outputs(outputs: Mapping[str, pathlib.Path | None], inputs: list[pathlib.Path]) -> None:
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
        if file is None or (option == "--json" and file == STANDARD_OUTPUT):
            continue
        if file.resolve() in taken:
            raise ScenarioError([f"{option}: {file} is in use already, expected a file of its own"])
        if option == "--json" and (why := json_complaint(file)) is not None:
            raise ScenarioError([why])
        taken.add(file.resolve())
        output_file.check(option, file)


def check_folder(option: str, folder: pathlib.Path | None, first: str) -> None:
    """Make a folder for pictures, and refuse one that the picture ``first`` could not be written to."""
    if folder is None:
        return
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ScenarioError([f"{option}: {folder} cannot be made: {error.strerror}"]) from None
    output_file.check(option, folder / first)


def json_text(found: Mapping[str, object]) -> str:
    """Figures as the text of a JSON file; numpy's numbers as those of Python, a number that is none as null."""
    return json.dumps(_plain(found), indent=2, allow_nan=False) + "\n"


def _plain(value: object) -> object:
    if isinstance(value, Mapping):
        return {str(key): _plain(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(one) for one in value]
    if isinstance(value, np.generic | np.ndarray):
        return _plain(value.tolist())
    return None if isinstance(value, float) and not math.isfinite(value) else value


def publish(json: pathlib.Path | None, found: Mapping[str, object], show: Callable[[], object]) -> None:
    """Show figures in words, and write them to the file, if one was requested; standard output takes JSON alone.

    Args:
        json: file for the figures; ``-`` prints them in place of the words.
        found: the figures.
        show: prints them in words.
    """
    if json == STANDARD_OUTPUT:
        sys.stdout.write(json_text(found))
        sys.stdout.flush()
        return
    show()
    if json is not None:
        output_file.write(json, json_text(found))


def say(json: pathlib.Path | None, line: str) -> None:
    """One line of progress or of a file that was written: beside JSON it is on standard error."""
    stream = sys.stderr if json == STANDARD_OUTPUT else sys.stdout
    stream.write(line + "\n")
    stream.flush()
