"""A new rig: its text and settings from a name and the decisions, judged as ``rigctl check`` and ``run`` judge it."""

from __future__ import annotations

import pathlib
import re
from collections.abc import Mapping
from dataclasses import dataclass

from pydantic import ValidationError

from hil.new.rig_decisions import DECISIONS, DecidedRig, check_together
from hil.new.rig_sizing import Sized, sized
from hil.new.rig_text import MODELINE, with_head, with_values
from hil.scenario.errors import ScenarioError
from rigctl.config import rig_file, strict_yaml
from rigctl.config.changed_settings import changed
from rigctl.config.settings import ADDED, RigSettings
from rigctl.config.wording import Path, Wording, key_of
from rigctl.design import search
from rigctl.design.gains import DesignError
from rigctl.devices import busload

_NAME = re.compile(r"[a-z][a-z0-9_]{0,31}\Z")


@dataclass(frozen=True)
class NewRig:
    """A rig file that is valid, and its settings."""

    name: str
    text: str
    settings: RigSettings
    ms_max: float
    weights: tuple[str, ...]  # those that were found because the paper's are refused, in words


def paper() -> tuple[pathlib.Path, RigSettings]:
    """File and settings of the paper's rig, from which every other is made.

    Raises:
        ConfigError: it is not installed.
    """
    file = rig_file.shipped("paper_rig.yaml")
    return file, rig_file.load(file)


def check_name(name: str) -> None:
    """Refuse what cannot be a rig's name.

    Raises:
        ScenarioError: one line.
    """
    if not _NAME.match(name):
        raise ScenarioError([f"NAME: found {name!r}, expected a to z, 0 to 9 and _, a letter first, 32 at most"])


def make(name: str, decided: DecidedRig, bus: Mapping[str, int] | None = None) -> NewRig:
    """The rig with these decisions.

    ``bus``: rate of the loop, bit rate and node ids, by their keys; the paper's where there is none.

    Raises:
        ScenarioError: there is no such rig; each line says which setting is out of which bound.
    """
    file, settings = paper()
    check_name(name)
    check_together(decided, settings)
    of_bus = [Sized(tuple(key.split(".")), value, None) for key, value in (bus or {}).items()]
    settings = changed(settings, bus or {})
    text = with_values(file.read_text(), [*sized(name, decided, settings), *of_bus])
    text = with_head(text.replace(f"config/{file.name}", f"{name}.yaml"), _head(name, decided))
    found = _settings(text, file.parent)
    if (load := busload.bus_load(found) or 0.0) > busload.LIMIT:
        advice = busload.advice(found) or "expected a faster bus, or a slower loop"
        raise ScenarioError(
            [f"{name}: bus load {load:.1%} of {found.can.bitrate_bit_s} bit/s, above {busload.LIMIT:.0%}: {advice}"]
        )
    try:
        searched = search.auto(found)
    except DesignError as error:
        raise ScenarioError([f"{name}: design: {error}"]) from None
    if not searched.meets:
        raise ScenarioError([f"{name}: no gains for these decisions: {line}" for line in searched.against])
    weights = [Sized(tuple(each.key.split(".")), each.value, "found as rigctl tune --auto does")
               for each in searched.weights]  # fmt: skip
    text = with_values(text, weights)
    words = tuple(each.in_words() for each in searched.weights)
    return NewRig(name, text, _settings(text, file.parent), searched.design.ms_max, words)


def _settings(text: str, folder: pathlib.Path) -> RigSettings:
    document = strict_yaml.load(text)
    try:
        return RigSettings.model_validate({**document.data, "directory": str(folder)})
    except ValidationError as error:
        wording = _WithoutFile(RigSettings, ADDED, document, pathlib.Path(document.data["rig"]))
        raise ScenarioError(wording.lines(error)) from None


class _WithoutFile(Wording):
    """Findings about a file that is not written, so that its lines say nothing."""

    def place(self, path: Path) -> str:
        return f"{self._file}: these decisions ask for {key_of(path)}"


def _head(name: str, decided: DecidedRig) -> list[str]:
    values = (decided.payload_kg, decided.spring_n_mm, decided.target_n, decided.speed_mm_s, decided.stroke_mm)
    words = ", ".join(f"{decision.option[2:]} {value:g} {decision.unit}"
                      for decision, value in zip(DECISIONS, values, strict=True))  # fmt: skip
    return [
        MODELINE,
        f"# Rig {name}, simulated, made by `python -m hil new rig`:",
        f"# {words}.",
        "# What these do not decide is as on the paper's rig (Wang et al., suspension gravity compensation), and its",
        "# comments are about that rig. For real hardware see the head of config/rig.yaml: bus, scheduling, waivers.",
        "# Units are in the names. `rigctl check FILE` prints it resolved.",
    ]
