"""A file of gains (YAML) with the inputs they were computed from, the versions used, the date and the rig.

``rigctl tune RIG --gains FILE`` writes it; ``design.gains_file: FILE`` in the rig file makes the daemon use it. It
fits as long as the rig file has the same inputs. Limit and waiver are not inputs: they belong to the verdict, which is
made again at every use. Its last line is a seal over all before it, where the rig's key could be used.

A file of `rigctl tune --from LEDGER` is for an identified plant: it names the family of plants it is judged over, and
replaces the plant of the rig file (`in_use`). Once the identification is outdated or contradicted, the rig runs by the
rig file alone, over the assumed family, and says so.
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
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from typing import Any

import yaml
from pydantic import Field, ValidationError, model_validator

from rigctl import __version__
from rigctl.config import strict_yaml
from rigctl.config.changed_settings import changed
from rigctl.config.settings import RigSettings
from rigctl.config.settings_base import Settings, require
from rigctl.config.wording import Wording
from rigctl.control.law.gain_table import plain
from rigctl.design.gains import DesignError
from rigctl.design.identified import Identified
from rigctl.design.verdict import Design
from rigctl.ipc import ledger, seal, whole_file
from rigctl.ipc.seal import SealError, SealVerdict

# Keys that determine gains, margins and performance.
INPUTS: dict[str, tuple[str, ...]] = {
    "loop": ("rate_hz",),
    "tension_cell": ("noise_n", "filter_hz"),
    "plant": (
        "spring_n_mm", "rope_n_mm", "cylinder_lag_s", "command_delay_s", "payload_kg", "mechanism_n_mm",
        "spring_damping_n_s_mm", "rope_damping_n_s_mm",
    ),
    "estimator": (
        "speed_noise_mm_s", "cell_noise_scale", "tension_walk_n", "speed_walk_mm_s", "disturbance_walk_mm_s",
        "quiet_tension_walk_n", "quiet_disturbance_walk_mm_s", "swing_hz", "swing_damping", "swing_walk_mm_s",
    ),
    "design": ("stretch_weight", "integral_weight", "command_weight"),
}  # fmt: skip
_LATER = frozenset(
    (*INPUTS["tension_cell"][1:], *INPUTS["estimator"][5:], *INPUTS["plant"][6:])
)  # left out at their default, so that files without them still fit
SAME_VALUE = 1e-9  # relative
REPLACEABLE = frozenset(f"{section}.{key}" for section in ("plant", "estimator", "design") for key in INPUTS[section])
_PACKAGES = {"python-control": "control", "filterpy": "filterpy", "numpy": "numpy", "scipy": "scipy"}
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


class Replaced(Settings):
    """A value of the rig file that the gain file replaces."""

    file: float | None  # the rig file's, when the gains were made
    used: float | None  # the one used in its place


class PlantThen(Settings):
    """The identified plant that the gains are for, see `rigctl.design.identified.Identified`; pairs: value, error."""

    when: str
    entries: list[str]
    tension_n: float
    believed_n_mm: float
    stiffness_n_mm: list[float] = Field(min_length=2, max_length=2)
    lag_s: list[float] = Field(min_length=2, max_length=2)
    delay_s: list[float] = Field(min_length=2, max_length=2)
    mechanism_n_mm: list[float] | None = Field(default=None, min_length=2, max_length=2)
    mechanism_above_n_mm: float | None = None
    stroke_mm: float | None = None
    damping_n_s_mm: list[float] | None = Field(default=None, min_length=2, max_length=2)
    mechanism_damping: list[float] | None = Field(default=None, min_length=2, max_length=2)

    @model_validator(mode="after")
    def _has_a_date(self) -> PlantThen:
        try:
            dated = ledger.moment(self.when) is not None
        except ValueError:
            dated = False
        require(dated, "when", self.when, "a date of the ledger, ISO 8601")
        return self


class Provenance(Settings):
    """Origin of the gains."""

    rig: str
    rig_file: str
    date_utc: str  # ISO 8601
    versions: dict[str, str]
    inputs_sha256: str  # of ``inputs`` as canonical JSON
    inputs: Inputs


class SpringGains(Settings):
    """Gains for one spring. ``inputs`` are those of the design, after what it replaces in the rig file.

    ``points``: for the other operating points at which the rig was identified with this spring.
    """

    gains: GainValues
    verdict: VerdictThen
    replaces: dict[str, Replaced] = Field(default_factory=dict)
    identified: PlantThen | None = None
    inputs: Inputs
    points: list[SpringGains] = Field(default_factory=list)

    @property
    def plant(self) -> Identified | None:
        """The identified plant; None for gains that are judged over the assumed family."""
        return None if self.identified is None else Identified.of(self.identified.model_dump())

    def differs(self, settings: RigSettings) -> str | None:
        """The first input in which a rig file differs from the one these gains were made with, in words."""
        now, every = inputs(settings), inputs_in_full(settings)
        for section, keys in self.inputs.items():
            for key, used in keys.items():
                given, replaced = every.get(section, {}).get(key, math.nan), self.replaces.get(f"{section}.{key}")
                known = [used] if replaced is None else [used, replaced.file]
                if not any(_same(given, value) for value in known):
                    return f"{section}.{key} was {_shown(known[-1])}, is {_shown(given)}"
        added = {(section, key) for section, keys in now.items() for key in keys}
        added -= {(section, key) for section, keys in self.inputs.items() for key in keys}
        added -= {(section, key) for section, _, key in (name.partition(".") for name in self.replaces)}
        return f"{'.'.join(min(added))} is an input that it does not know" if added else None

    def applied(self, settings: RigSettings) -> RigSettings:
        """The settings with the values that these gains replace."""
        return changed(settings, {key: value.used for key, value in self.replaces.items()})


class GainFile(Settings):
    """The whole file; ``replaces``, ``identified``, ``points`` as in `SpringGains`, ``others``: for other springs."""

    gains: GainValues
    verdict: VerdictThen
    replaces: dict[str, Replaced] = Field(default_factory=dict)
    identified: PlantThen | None = None
    points: list[SpringGains] = Field(default_factory=list)
    others: list[SpringGains] = Field(default_factory=list)
    provenance: Provenance
    seal: str | None = None  # of the text before it

    @property
    def springs(self) -> list[SpringGains]:
        """The gains for each spring, those of the rig file's first."""
        first = SpringGains(
            gains=self.gains, verdict=self.verdict, replaces=self.replaces, identified=self.identified,
            inputs=self.provenance.inputs, points=self.points,
        )  # fmt: skip
        return [first, *self.others]


def inputs(settings: RigSettings) -> Inputs:
    """The inputs of a design, by section and key of the rig file."""
    found: Inputs = {}
    for section, keys in INPUTS.items():
        values = getattr(settings, section)
        defaults = type(values).model_fields
        found[section] = {
            key: _number(value)
            for key in keys
            if (value := getattr(values, key)) != defaults[key].default or key not in _LATER
        }
    return found


def inputs_in_full(settings: RigSettings) -> Inputs:
    """As `inputs`, with those at their default too."""
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


def spring_gains(
    found: Design,
    given: RigSettings,
    used: RigSettings,
    plant: Identified | None = None,
    points: Sequence[SpringGains] = (),
) -> SpringGains:
    """Gains with what they replace: ``given`` is the rig file, ``used`` the settings of the design."""
    now, then = inputs(used), inputs_in_full(given)
    replaces = {
        f"{section}.{key}": Replaced(file=then[section][key], used=value)
        for section, keys in inputs_in_full(used).items()
        for key, value in keys.items()
        if value != then[section][key]
    }
    verdict = VerdictThen(
        ms_max=found.ms_max if math.isfinite(found.ms_max) else None,
        limit=found.limit, accepted=found.accepted, waiver=found.waiver,
    )  # fmt: skip
    identified = None
    if plant is not None:
        pairs: dict[str, Any] = {
            name: list(value) if isinstance(value, tuple) else value for name, value in plant.as_dict().items()
        }
        identified = PlantThen(**pairs)
    return SpringGains(
        gains=GainValues(**asdict(plain(found.gains))),
        verdict=verdict,
        replaces=replaces,
        identified=identified,
        inputs=now,
        points=list(points),
    )


def write(
    file: pathlib.Path,
    found: Design,
    made: Provenance,
    sealed_for: RigSettings | None = None,
    springs: Sequence[SpringGains] = (),
) -> None:
    """Write a gain file atomically: a reader sees the old file or the new one.

    ``sealed_for``: settings of the rig whose key seals it; None: it has no seal. ``springs``: of an identified plant,
    the gains of ``found`` with what they replace, then those for other springs.

    Raises:
        OSError: it cannot be written.
        SealError: the rig's key cannot be used.
    """
    content = {
        "gains": asdict(plain(found.gains)),
        "verdict": {
            "ms_max": found.ms_max if math.isfinite(found.ms_max) else None,
            "limit": found.limit,
            "accepted": found.accepted,
            "waiver": found.waiver,
        },
    }
    if springs:
        first, *others = (spring.model_dump() for spring in springs)
        content |= {name: first[name] for name in ("replaces", "identified", "points")} | {"others": others}
    content["provenance"] = made.model_dump()
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
    return parse(text_of(file), str(file))


def text_of(file: pathlib.Path) -> str:
    """The text of a gain file.

    Raises:
        GainFileError: it cannot be read.
    """
    try:
        return strict_yaml.text_of(file)
    except strict_yaml.FileError as error:
        raise GainFileError(str(error)) from None


def checked_seal(settings: RigSettings, text: str, name: str) -> str:
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
    for spring in (each for outer in found.springs for each in (outer, *outer.points)):
        if foreign := sorted(spring.replaces.keys() - REPLACEABLE):
            raise GainFileError(f"{file}: replaces: found {foreign[0]}, expected only plant and weights")
    return found


class _Dumper(yaml.SafeDumper):
    """Quotes every text, so that a hash or a version is never read as a number; keys stay unquoted."""

    def represent_mapping(self, tag: str, mapping: Any, flow_style: bool | None = None) -> yaml.MappingNode:
        node = super().represent_mapping(tag, mapping, flow_style)
        _quote(value for _, value in node.value)
        return node

    def represent_sequence(self, tag: str, sequence: Any, flow_style: bool | None = None) -> yaml.SequenceNode:
        node = super().represent_sequence(tag, sequence, flow_style)
        _quote(node.value)
        return node


def _quote(nodes: Iterable[yaml.Node]) -> None:
    for node in nodes:
        if isinstance(node, yaml.ScalarNode) and node.tag == "tag:yaml.org,2002:str":
            node.style = '"'


def _number(value: float | None) -> float | None:
    return None if value is None else float(value)


def _same(a: float | None, b: float | None) -> bool:
    """Equal, or but for the last digits of a value that was computed."""
    return a == b or (a is not None and b is not None and math.isclose(a, b, rel_tol=SAME_VALUE))


def _shown(value: float | None) -> str:
    return "null" if value is None else f"{value:.10g}"
