"""Results of the design's calculations that are kept from one start of a rig to the next.

python-control and filterpy take two seconds to load, and a start with the files of the start before has nothing new to
compute. What is kept is a pure function of settings, gains and identified plant, so it is kept under the SHA-256 of
these, of every module that can take part in it (those that the layers allow `rigctl.design` to import) and of the
libraries' versions. A start that differs in any of them computes anew, as does one whose file is missing, damaged, of
another user or open to others. Whether gains are believed is decided at each start and never kept.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import importlib.metadata
import json
import pathlib
from collections.abc import Callable, Sequence
from dataclasses import asdict
from typing import Any, NamedTuple, TypeVar

import msgspec

import rigctl
from rigctl.config import input_file
from rigctl.config.settings import RigSettings
from rigctl.control.law.tension import Gains
from rigctl.design import identified
from rigctl.design.gains import design
from rigctl.design.identified import Identified
from rigctl.design.margins import judge
from rigctl.design.plant_family import Family, assumed
from rigctl.design.transitions import EntryLoop, dwell_time_s
from rigctl.design.verdict import Design
from rigctl.ipc import whole_file
from rigctl.ipc.folder_places import digest

TAKING_PART = ("config", "control", "design", "ipc")
"""Folders of `rigctl` whose modules can change a result: `design` and what its layer may import (a test)."""
LIBRARIES = ("control", "filterpy", "numpy", "scipy")
_MODE = 0o600
_Result = TypeVar("_Result")


class JudgedLoop(NamedTuple):
    """Settings of a design, its gains, and the plant that it is for; None: the assumed family."""

    settings: RigSettings
    gains: Gains
    plant: Identified | None


class KeptResults:
    """The calculations of a start; with a file, those that it holds are not done again."""

    def __init__(self, file: pathlib.Path | None = None) -> None:
        """``file``: None computes everything."""
        self._file = file
        self._kept: dict[str, Any] = {} if file is None else _read(file)
        self._used: dict[str, Any] = {}

    def gains(self, settings: RigSettings) -> Gains:
        """As `rigctl.design.gains.design`.

        Raises:
            DesignError: there are no gains for these settings.
        """
        return self._of("gains", [_plain(settings)], Gains, lambda: design(settings))

    def judged(self, loop: JudgedLoop) -> Design:
        """As `rigctl.design.margins.judge`.

        Raises:
            DesignError: the filter has no steady state.
        """
        return self._of("judged", _inputs(loop), Design, lambda: judge(loop.settings, loop.gains, family=_family(loop)))

    def dwell_s(self, loops: Sequence[JudgedLoop]) -> float:
        """As `rigctl.design.transitions.dwell_time_s`.

        Raises:
            TransitionError: there is none.
        """

        def computed() -> float:
            return dwell_time_s([EntryLoop(loop.settings, loop.gains, _family(loop)) for loop in loops])

        return self._of("dwell", [part for loop in loops for part in _inputs(loop)], float, computed)

    def keep(self) -> None:
        """Write what was used into the file, if that has changed.

        A file that cannot be written costs the next start two seconds, and is no reason to refuse this one.
        """
        if self._file is None or self._used == self._kept:
            return
        data = json.dumps(self._used).encode()
        with contextlib.suppress(OSError):
            whole_file.replace(self._file, data + b"\n" + digest(data) + b"\n", mode=_MODE, sync=False)

    def _of(self, what: str, inputs: Sequence[object], kind: type[_Result], computed: Callable[[], _Result]) -> _Result:
        if self._file is None:
            return computed()
        key = hashlib.sha256(json.dumps([what, _code(), inputs], sort_keys=True).encode()).hexdigest()
        found: _Result | None = None
        with contextlib.suppress(KeyError, msgspec.ValidationError):
            found = msgspec.convert(self._kept[key], kind)
        if found is None:
            found = computed()
        self._used[key] = json.loads(json.dumps(msgspec.to_builtins(found)))
        return found


def _read(file: pathlib.Path) -> dict[str, Any]:
    """Content of the file; nothing of one that is damaged, or not this user's alone."""
    try:
        data, _, seal = input_file.read(file, alone=True).rstrip(b"\n").rpartition(b"\n")
        found = json.loads(data) if seal == digest(data) else None
    except (OSError, ValueError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}


def _family(loop: JudgedLoop) -> Family:
    return assumed(loop.settings) if loop.plant is None else identified.family(loop.settings, loop.plant)


def _inputs(loop: JudgedLoop) -> list[Any]:
    return [_plain(loop.settings), asdict(loop.gains), None if loop.plant is None else loop.plant.as_dict()]


def _plain(settings: RigSettings) -> dict[str, Any]:
    """The settings as JSON values, but for the folder of their file."""
    return settings.model_dump(mode="json", exclude={"directory"})


@functools.cache
def _code() -> str:
    """SHA-256 of the modules that take part, and the versions of the libraries."""
    found = hashlib.sha256()
    root = pathlib.Path(rigctl.__file__).parent
    for folder in TAKING_PART:
        for module in sorted((root / folder).rglob("*.py")):
            found.update(f"{module.relative_to(root)} {module.stat().st_size} ".encode() + module.read_bytes())
    return " ".join([found.hexdigest(), *(f"{name} {importlib.metadata.version(name)}" for name in LIBRARIES)])
