"""A new rig file with what it needs beside it: EDS files and JSON Schemas. Nothing is overwritten."""

from __future__ import annotations

import contextlib
import os
import pathlib
from collections.abc import Mapping

from hil.scenario.errors import ScenarioError
from rigctl.config import rig_file
from rigctl.config.settings import RigSettings
from rigctl.ipc import whole_file

_SIMULATOR = "eds/simulator.eds"  # of `python -m hil serve`, see docs/hil-tests.md
_SCHEMAS = ("schema/rig.schema.json", "schema/scenario.schema.json")


def beside(settings: RigSettings) -> dict[str, bytes]:
    """Files that the rig file needs, by their name relative to it.

    Raises:
        ConfigError: one is not installed.
    """
    names = [getattr(settings, device).eds for device in settings.canopen_nodes]
    return {name: rig_file.shipped(name).read_bytes() for name in (*names, _SIMULATOR, *_SCHEMAS)}


def check(folder: pathlib.Path, name: str, files: Mapping[str, bytes]) -> None:
    """Refuse a folder in which something would have to be overwritten.

    Raises:
        ScenarioError: a line for each file.
    """
    found = []
    if os.path.lexists(folder / f"{name}.yaml"):
        found.append(f"{folder / name}.yaml: found a file, expected none: nothing is overwritten")
    for other, data in files.items():
        place = folder / other
        if os.path.lexists(place) and not (place.is_file() and place.read_bytes() == data):
            found.append(f"{place}: found another file than the one shipped, expected that or none")
    if found:
        raise ScenarioError(found)


def write(folder: pathlib.Path, name: str, text: str, files: Mapping[str, bytes]) -> pathlib.Path:
    """Write everything, the rig file last; returns it. What is there already stays.

    Raises:
        OSError: a file cannot be written; files and folders made before it are taken away again.
    """
    place = folder / f"{name}.yaml"
    with contextlib.ExitStack() as undo:
        for path, data in [*((folder / other, data) for other, data in files.items()), (place, text.encode())]:
            if path != place and path.exists():
                continue
            for missing in [above for above in reversed(path.parents) if not above.exists()]:
                missing.mkdir()
                undo.callback(missing.rmdir)
            descriptor = os.open(path, whole_file.NEW, 0o666)
            undo.callback(path.unlink, missing_ok=True)
            with os.fdopen(descriptor, "wb") as file:
                file.write(data)
        undo.pop_all()
    return place
