"""Reads a rig file: settings, or a line for each finding."""

from __future__ import annotations

import pathlib
import sys

from pydantic import ValidationError

from rigctl.config import can_section, strict_yaml
from rigctl.config.bounds import as_study
from rigctl.config.one_line import printable
from rigctl.config.settings import ADDED, RigSettings
from rigctl.config.wording import Wording


class ConfigError(ValueError):
    """A rig file that is refused; ``str()`` is one line per finding, each with file, line and key."""

    def __init__(self, findings: list[str]) -> None:
        self.findings = [printable(finding) for finding in findings]
        super().__init__("\n".join(self.findings))


def shipped(name: str) -> pathlib.Path:
    """A rig file that comes with the program: of a checkout, or where the wheel has put it.

    Raises:
        ConfigError: it is not installed.
    """
    places = (pathlib.Path(__file__).parents[2] / "config", pathlib.Path(sys.prefix) / "share/rigctl/config")
    for place in places:
        if (place / name).is_file():
            return place / name
    raise ConfigError([f"{name}: found it neither in {places[0]} nor in {places[1]}, expected an installed rigctl"])


def load(path: str | pathlib.Path, *, study: bool = False) -> RigSettings:
    """Read and validate a rig file.

    Args:
        path: the rig file.
        study: the settings move nothing real, so the bounds of `rigctl.config.bounds` are waived.

    Raises:
        ConfigError: one line per finding, ``FILE:LINE: key: found X, expected Y``.
    """
    file = pathlib.Path(path)
    try:
        document = strict_yaml.read(file)
    except strict_yaml.FileError as error:
        raise ConfigError([str(error)]) from None
    if not isinstance(document.data, dict):
        raise ConfigError([f"{file}:1: found {type(document.data).__name__}, expected a mapping of sections"])
    for key in ADDED & document.data.keys():
        raise ConfigError([f"{file}:{document.line_of((key,))}: {key}: found an unknown key"])
    try:
        data = as_study(document.data) if study else document.data
        settings = RigSettings.model_validate({**data, "directory": str(file.resolve().parent)})
    except ValidationError as error:
        raise ConfigError(Wording(RigSettings, ADDED, document, file).lines(error)) from None
    if (why := can_section.unknown_interface(settings.can)) is not None:
        raise ConfigError([f"{file}:{document.line_of(('can', 'interface'))}: can.interface: {why}"])
    for name in settings.canopen_nodes:
        eds = getattr(settings, name).eds
        if not settings.file(eds).is_file():
            line = document.line_of((name, "eds"))
            raise ConfigError([f"{file}:{line}: {name}.eds: found no file {eds}, expected an EDS file"])
    if settings.tension_cell.dbc is None and settings.inclinometer.dbc is None:
        return settings
    from rigctl.config import dbc_file  # cantools takes 0.15 s to import

    try:
        return settings.model_copy(update={"plain": dbc_file.messages(settings)})
    except dbc_file.DbcError as error:
        raise ConfigError([f"{file}:{document.line_of(error.key)}: {error}"]) from None
