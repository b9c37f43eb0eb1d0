"""The rig of a scenario: its rig file, parameter sets laid over it, and the scenario's own changes last."""

from __future__ import annotations

import pathlib
from collections.abc import Mapping
from typing import Any

from pydantic import ValidationError

from hil.scenario.errors import ScenarioError
from hil.scenario.format import ScenarioFile, read_yaml
from rigctl.config import rig_file as config
from rigctl.config.bounds import as_study
from rigctl.config.rig_file import ConfigError
from rigctl.config.settings import RigSettings
from rigctl.config.strict_yaml import Document
from rigctl.config.wording import Path, Wording

_ADDED = frozenset({"directory", "plain"})
_DEVICE_FILES = frozenset({"eds", "dbc"})
"""Sections read with the rig file, which no layer may change: they describe the devices."""


def settings_of(source: ScenarioFile) -> RigSettings:
    """The rig file with all layers of the scenario, validated as a whole.

    Raises:
        ScenarioError: one line per finding; each names the file, the line and the key at fault.
    """
    scenario = source.scenario
    rig_file = _beside(source, ("rig",), scenario.rig)
    try:
        base = config.load(rig_file)
    except ConfigError as error:
        if not rig_file.is_file():
            raise source.refusal(("rig",), scenario.rig, f"a rig file ({rig_file} cannot be read)") from None
        raise ScenarioError(error.findings) from None
    layers = _Layers(rig_file, read_yaml(rig_file), source.file)
    for i in range(len(scenario.sets)):
        file = _set_file(source, i, rig_file)
        layers.lay(file, read_yaml(file), ())
    layers.lay(source.file, source.document, ("change",))
    if scenario.target_n is not None:
        layers.lay_one(source.file, source.document, ("target_n",), ("tension", "target_n"), scenario.target_n)
    return layers.settings(base)


class _Layers(Wording):
    """Data of several files laid over each other; every finding names the file that set the value last."""

    def __init__(self, file: pathlib.Path, document: Document, scenario: pathlib.Path) -> None:
        super().__init__(RigSettings, _ADDED, document, file)
        self._scenario = scenario
        self._data: dict[str, Any] = document.data
        self._origins: dict[Path, tuple[pathlib.Path, Document, Path]] = {}

    def lay(self, file: pathlib.Path, document: Document, root: Path) -> None:
        """Lay the section at ``root`` of a document over the data, key by key; a list or value replaces.

        Raises:
            ScenarioError: it would change the description of the devices.
        """
        over = document.data
        for part in root:
            over = over.get(part, {})
        for path in document.lines:
            if path[: len(root)] == root and len(path) > len(root):
                key = path[len(root) :]
                self._origins[key] = file, document, path
                if key[0] in _ADDED:
                    raise ScenarioError([self.say(key, "an unknown key", "keys of a rig file")])
                if key[-1] in _DEVICE_FILES:
                    raise ScenarioError([self.say(key, "a key", "it in the rig file only")])
        self._data = _merged(self._data, over)

    def lay_one(self, file: pathlib.Path, document: Document, path: Path, key: tuple[str, str], value: object) -> None:
        """Lay one value, from ``path`` of a document, over ``key`` of the rig file."""
        self._origins[key] = file, document, path
        self._data = _merged(self._data, {key[0]: {key[1]: value}})

    def settings(self, base: RigSettings) -> RigSettings:
        """The settings of all layers together; ``base`` are those of the rig file alone.

        Raises:
            ScenarioError: they are not valid.
        """
        added = {"directory": base.directory, "plain": base.plain}
        try:
            settings = RigSettings.model_validate({**as_study(self._data), **added})
        except ValidationError as error:
            raise ScenarioError(self.lines(error)) from None
        if settings.simulation is None:
            raise ScenarioError([self.say(("simulation",), "nothing", "a section (it says what rig to simulate)")])
        return settings

    def place(self, path: Path) -> str:
        """See `Wording`; the rig file alone is valid, so a contradiction is the scenario's."""
        nearest = path
        while nearest and nearest not in self._origins:
            nearest = nearest[:-1]
        if not nearest:
            return f"{super().place(path)} (as changed by {self._scenario})"
        file, document, own = self._origins[nearest]
        return Wording(RigSettings, _ADDED, document, file).place(own + path[len(nearest) :])


def _merged(under: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """``over`` laid over ``under``, section by section."""
    result = dict(under)
    for key, value in over.items():
        below = result.get(key)
        result[key] = _merged(below, value) if isinstance(value, dict) and isinstance(below, dict) else value
    return result


def _set_file(source: ScenarioFile, index: int, rig_file: pathlib.Path) -> pathlib.Path:
    """File of a parameter set: ``sets/NAME.yaml`` beside the rig file, or a path relative to the scenario."""
    name, path = source.scenario.sets[index], ("sets", index)
    if "/" in name or name.endswith((".yaml", ".yml")):
        file = _beside(source, path, name)
    else:
        file = rig_file.parent / "sets" / f"{name}.yaml"
    if not name.isprintable() or not file.is_file():
        known = sorted(found.stem for found in (rig_file.parent / "sets").glob("*.yaml"))
        words = f"a file, or one of {', '.join(known) or 'none at all'}"
        raise source.refusal(path, repr(name), f"{words} ({file} is not there)")
    return file


def _beside(source: ScenarioFile, path: Path, name: str) -> pathlib.Path:
    """A file named relative to the scenario."""
    if not name.isprintable():
        raise source.refusal(path, repr(name), "the name of a file")
    return source.file.parent / name


def with_set(rig_file: pathlib.Path, set_file: pathlib.Path) -> RigSettings:
    """A rig file with a parameter set laid over it, key by key.

    Raises:
        ConfigError: the rig file is not valid.
        ScenarioError: the set is not, or they do not fit together.
    """
    base, document = config.load(rig_file), read_yaml(set_file)
    data = _merged(read_yaml(rig_file).data, document.data)
    try:
        return RigSettings.model_validate({**as_study(data), "directory": base.directory, "plain": base.plain})
    except ValidationError as error:
        raise ScenarioError(Wording(RigSettings, _ADDED, document, set_file).lines(error)) from None
