"""A file of gains (YAML) with the inputs they were computed from, the versions used, the date and the rig.

``rigctl tune RIG --gains FILE`` writes it; ``design.gains_file: FILE`` in the rig file makes the daemon use it. It
fits as long as the rig file has the same inputs. Limit and waiver are not inputs: they belong to the verdict, which is
made again at every use. Its last line is a seal over all before it, where the rig's key could be used.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import math
import os
import pathlib
import platform
import re
from dataclasses import asdict
from datetime import UTC, datetime
from typing import Any

import yaml
from pydantic import Field, ValidationError

from rigctl import __version__
from rigctl.config import strict_yaml
from rigctl.config.changed_settings import changed
from rigctl.config.settings import RigSettings
from rigctl.config.settings_base import Settings
from rigctl.config.wording import Wording
from rigctl.control.tension import Gains
from rigctl.design.gains import DesignError, design
from rigctl.design.margins import design_and_check, judge
from rigctl.design.verdict import Design, GainSource
from rigctl.ipc import seal, whole_file
from rigctl.ipc.seal import SealError, SealVerdict

# Keys that determine gains, margins and performance.
INPUTS: dict[str, tuple[str, ...]] = {
    "loop": ("rate_hz",),
    "tension_cell": ("noise_n",),
    "plant": ("spring_n_mm", "rope_n_mm", "cylinder_lag_s", "command_delay_s", "payload_kg", "mechanism_n_mm"),
    "estimator": (
        "speed_noise_mm_s", "cell_noise_scale", "tension_walk_n", "speed_walk_mm_s", "disturbance_walk_mm_s",
    ),
    "design": ("stretch_weight", "integral_weight", "command_weight"),
}  # fmt: skip
SAME_GAIN = 1e-6  # relative: the last digits of a gain differ between versions of the libraries
_PACKAGES = {"python-control": "control", "numpy": "numpy", "scipy": "scipy"}
_HEADING = """\
# Gains of the tension law, written by `rigctl tune`. To use them: `gains_file` under `design` in the rig file.
# They hold for the inputs below: when those change in the rig file, `rigctl run` refuses this file until `rigctl tune`
# has written it anew. Margins are computed again at every start.
# Units: k_tension mm/s per N, k_speed 1, k_integral mm/s per N s.
"""

_SEALED = "gains"  # what the seal is about
_SEAL = re.compile(r'^seal: "([0-9a-f]{64})"\n?\Z', re.MULTILINE)

Inputs = dict[str, dict[str, float | None]]


class GainFileError(DesignError):
    """A gain file that cannot be used; ``str()`` is one line that names it."""


class GainValues(Settings):
    """The gains, see `Gains`."""

    k_tension: float = Field(ge=-1e9, le=1e9)
    k_speed: float = Field(ge=-1e9, le=1e9)
    k_integral: float = Field(ge=-1e9, le=1e9)


class VerdictThen(Settings):
    """Verdict at the time the file was written; for the reader only."""

    ms_max: float | None  # null = unstable somewhere in the family
    limit: float
    accepted: bool
    waiver: str | None


class Provenance(Settings):
    """Origin of the gains."""

    rig: str
    rig_file: str
    date_utc: str  # ISO 8601
    versions: dict[str, str]
    inputs_sha256: str  # of ``inputs`` as canonical JSON
    inputs: Inputs


class GainFile(Settings):
    """The whole file."""

    gains: GainValues
    verdict: VerdictThen
    provenance: Provenance
    seal: str | None = None  # of the text before it


def inputs(settings: RigSettings) -> Inputs:
    """The inputs of a design, by section and key of the rig file."""
    return {
        section: {key: _number(getattr(getattr(settings, section), key)) for key in keys}
        for section, keys in INPUTS.items()
    }


def sha256(found: Inputs) -> str:
    """Hash of inputs: SHA-256 of JSON with sorted keys, no spaces, every number as a float."""
    plain = {section: {key: _number(value) for key, value in keys.items()} for section, keys in found.items()}
    text = json.dumps(plain, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def provenance(settings: RigSettings, rig_file: pathlib.Path, now: datetime) -> Provenance:
    """Provenance of a design made from these settings at ``now`` (with its time zone)."""
    found = inputs(settings)
    return Provenance(
        rig=settings.rig,
        rig_file=str(rig_file),
        date_utc=now.astimezone(UTC).isoformat(timespec="seconds"),
        versions={"rigctl": __version__}
        | {name: importlib.metadata.version(package) for name, package in _PACKAGES.items()}
        | {"python": platform.python_version()},
        inputs_sha256=sha256(found),
        inputs=found,
    )


def write(file: pathlib.Path, found: Design, made: Provenance, sealed_for: RigSettings | None = None) -> None:
    """Write a gain file atomically: a reader sees the old file or the new one.

    ``sealed_for``: settings of the rig whose key seals it; None: it has no seal.

    Raises:
        OSError: it cannot be written.
        SealError: the rig's key cannot be used.
    """
    content = {
        "gains": asdict(found.gains),
        "verdict": {
            "ms_max": found.ms_max if math.isfinite(found.ms_max) else None,
            "limit": found.limit,
            "accepted": found.accepted,
            "waiver": found.waiver,
        },
        "provenance": made.model_dump(),
    }
    text = _HEADING + yaml.dump(content, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=10_000)
    if sealed_for is not None:
        text += f'seal: "{seal.seal(sealed_for, _SEALED, text.encode())}"\n'
    file = file.resolve()  # so that a link stays a link
    part = file.with_name(f".{file.name}.{os.getpid()}")
    try:
        part.unlink(missing_ok=True)
        with os.fdopen(os.open(part, whole_file.NEW, 0o666), "w", encoding="utf-8") as written:
            written.write(text)
        part.replace(file)
    finally:
        part.unlink(missing_ok=True)


def read(file: pathlib.Path) -> GainFile:
    """Read a gain file, whatever rig it is for.

    Raises:
        GainFileError: it cannot be read, is not a gain file, or its inputs do not match its hash.
    """
    return parse(_text(file), str(file))


def _text(file: pathlib.Path) -> str:
    try:
        return strict_yaml.text_of(file)
    except strict_yaml.FileError as error:
        raise GainFileError(str(error)) from None


def _checked_seal(settings: RigSettings, text: str, name: str) -> str:
    """What the seal of a gain file's text says, in words.

    Raises:
        GainFileError: it was edited since it was sealed, or the rig's key is not its owner's alone.
    """
    found = _SEAL.search(text)
    if found is None:
        return "no seal"
    try:
        verdict = seal.verdict(settings, _SEALED, text[: found.start()].encode(), found[1])
    except SealError as error:
        raise GainFileError(f"{name}: its seal cannot be verified: {error}") from None
    if verdict is SealVerdict.BROKEN:
        raise GainFileError(
            f"{name}: edited since it was sealed, or sealed on another computer: run `rigctl tune` again, or delete "
            "its last line if it is right"
        )
    return str(verdict.value)


def parse(text: str, name: str) -> GainFile:
    """Read the text of a gain file named ``name``.

    Raises:
        GainFileError: it is not a gain file, or its inputs do not match its hash.
    """
    try:
        return _understood(strict_yaml.load(text), pathlib.Path(name))
    except strict_yaml.StrictYamlError as error:
        raise GainFileError(f"{name}:{error.line}: {error.message}") from None


def _understood(document: strict_yaml.Document, file: pathlib.Path) -> GainFile:
    try:
        found = GainFile.model_validate(document.data)
    except ValidationError as error:
        if not isinstance(document.data, dict):
            raise GainFileError(f"{file}:1: found no gain file, expected one from `rigctl tune --gains`") from None
        first, *more = Wording(GainFile, frozenset(), document, file).lines(error)
        raise GainFileError(first + (f" (and {len(more)} more)" if more else "")) from None
    if sha256(found.provenance.inputs) != found.provenance.inputs_sha256:
        raise GainFileError(f"{file}: its inputs do not give its inputs_sha256, edited? Run `rigctl tune` again")
    return found


def read_for(settings: RigSettings) -> tuple[Gains, Provenance, str] | None:
    """Gains, provenance and seal in words of the gain file in the settings; None if they name none.

    Raises:
        GainFileError: it cannot be read, was edited since it was sealed, or was made for other settings.
    """
    if settings.design.gains_file is None:
        return None
    file = settings.file(settings.design.gains_file)
    text = _text(file)
    found, sealed = parse(text, str(file)), _checked_seal(settings, text, str(file))
    now, then = inputs(settings), found.provenance.inputs
    if sha256(now) != found.provenance.inputs_sha256:
        raise GainFileError(f"{file}: made for other settings ({_difference(then, now)}): run `rigctl tune` again")
    return Gains(**found.gains.model_dump()), found.provenance, sealed


def design_in_use(settings: RigSettings) -> Design:
    """The design of a rig, judged now: that of its gain file, or a new one without a file.

    Raises:
        DesignError: there are no gains for these settings, or the gain file does not fit them.
    """
    kept = read_for(settings)
    if kept is None:
        return design_and_check(settings)
    return _judged(settings, *kept, str(settings.design.gains_file))


def design_while_running(settings: RigSettings, text: str, name: str) -> Design:
    """The design of a gain file's text on a rig that runs with ``settings``; only its weights may differ from them.

    Raises:
        GainFileError: it is not a gain file, was edited since it was sealed, is for another rig, plant, rate or
            estimator, or has no margins.
    """
    found, sealed = parse(text, name), _checked_seal(settings, text, name)
    then = found.provenance.inputs
    if found.provenance.rig != settings.rig:
        raise GainFileError(f"{name}: found gains of rig {found.provenance.rig!r}, expected {settings.rig!r}")
    weights = then.get("design", {})
    if weights.keys() != set(INPUTS["design"]) or any(value is None or value <= 0.0 for value in weights.values()):
        raise GainFileError(f"{name}: its inputs hold no weights of the design: run `rigctl tune` again")
    made_for = changed(settings, {f"design.{key}": value for key, value in weights.items()})
    if sha256(inputs(made_for)) != found.provenance.inputs_sha256:
        difference = _difference(then, inputs(made_for))
        raise GainFileError(f"{name}: made for other settings ({difference}): run `rigctl tune` on the file that runs")
    return _judged(made_for, Gains(**found.gains.model_dump()), found.provenance, sealed, name)


def _judged(settings: RigSettings, gains: Gains, made: Provenance, sealed: str, name: str) -> Design:
    own = design(settings)
    edited = not all(math.isclose(asdict(gains)[k], g, rel_tol=SAME_GAIN) for k, g in asdict(own).items())
    try:
        return judge(settings, gains, GainSource(name, made.model_dump(), edited, sealed))
    except (ArithmeticError, ValueError) as error:  # numbers that no law has
        raise GainFileError(f"{settings.file(name)}: no margins for its gains: {error}") from None


class _Dumper(yaml.SafeDumper):
    """Quotes every text, so that a hash or a version is never read as a number; keys stay unquoted."""

    def represent_mapping(self, tag: str, mapping: Any, flow_style: bool | None = None) -> yaml.MappingNode:
        node = super().represent_mapping(tag, mapping, flow_style)
        for _, value in node.value:
            if isinstance(value, yaml.ScalarNode) and value.tag == "tag:yaml.org,2002:str":
                value.style = '"'
        return node


def _number(value: float | None) -> float | None:
    return None if value is None else float(value)


def _difference(then: Inputs, now: Inputs) -> str:
    """The first input that differs, in words."""
    for section, keys in now.items():
        for key, value in keys.items():
            old = then.get(section, {}).get(key)
            if old != value:
                return f"{section}.{key} was {_shown(old)}, is {_shown(value)}"
    return "it has inputs this version does not know"


def _shown(value: float | None) -> str:
    return "null" if value is None else f"{value:.10g}"
