"""SBOM (CycloneDX JSON) of the wheel: every distribution of its extras, from the locked requirements."""

from __future__ import annotations

import json
import pathlib
import re
import uuid
from collections.abc import Iterator
from datetime import UTC, datetime
from importlib import metadata
from typing import NamedTuple

from cyclonedx.model import HashAlgorithm, HashType, Property
from cyclonedx.model.bom import Bom, BomMetaData
from cyclonedx.model.component import Component, ComponentType
from cyclonedx.output.json import JsonV1Dot6
from packageurl import PackageURL

EXTRAS = ("rt", "ops", "sim")
_LINE = re.compile(r"(?P<name>[A-Za-z0-9._-]+)==(?P<version>[^\s;\\]+)")
_HASH = re.compile(r"--hash=sha256:(?P<digest>[0-9a-f]{64})")


class LockError(ValueError):
    """A file of locked requirements that cannot be used; ``str()`` is one line."""


class Locked(NamedTuple):
    """One distribution as locked."""

    name: str
    version: str
    hashes: tuple[str, ...]


def locked(file: pathlib.Path) -> Iterator[Locked]:
    """Distributions of a file of locked requirements.

    Raises:
        LockError: a line has no version or no hash.
    """
    for line in file.read_text().replace("\\\n", " ").splitlines():
        if not (text := line.strip()) or text.startswith("#"):
            continue
        found, hashes = _LINE.match(text), tuple(_HASH.findall(text))
        if found is None or not hashes:
            raise LockError(f"{file.name}: found {text[:60]!r}, expected NAME==VERSION --hash=sha256:...")
        yield Locked(found["name"], found["version"], hashes)


def _component(item: Locked, extras: list[str]) -> Component:
    licence = None
    try:
        about = metadata.metadata(item.name)
        licence = about.get("License-Expression") or about.get("License")
    except metadata.PackageNotFoundError:
        pass  # an extra that is not installed here; the lock has all that identifies it
    properties = [Property(name="rigctl:extras", value=" ".join(extras))]
    if licence and "\n" not in licence:
        properties.append(Property(name="rigctl:licence", value=licence))
    return Component(
        name=item.name,
        version=item.version,
        type=ComponentType.LIBRARY,
        purl=PackageURL("pypi", None, item.name.lower(), item.version),
        bom_ref=f"{item.name}=={item.version}",
        hashes=[HashType(alg=HashAlgorithm.SHA_256, content=digest) for digest in item.hashes],
        properties=properties,
    )


def of(folder: pathlib.Path, wheel: str, digest: str, epoch: int) -> str:
    """The SBOM of a wheel as text, the same for the same wheel and locks.

    Args:
        folder: where ``requirements-EXTRA.txt`` are.
        wheel: the wheel's file name.
        digest: its SHA-256.
        epoch: its time, seconds since 1970.

    Raises:
        LockError: the locks cannot be used.
    """
    name, version = wheel.split("-")[:2]
    itself = Component(
        name=name, version=version, type=ComponentType.APPLICATION, purl=PackageURL("pypi", None, name, version),
        bom_ref=f"{name}=={version}", hashes=[HashType(alg=HashAlgorithm.SHA_256, content=digest)],
    )  # fmt: skip
    bom = Bom(
        serial_number=uuid.uuid5(uuid.NAMESPACE_URL, f"{wheel}#{digest}"),
        metadata=BomMetaData(component=itself, timestamp=datetime.fromtimestamp(epoch, UTC)),
    )
    needed: dict[Locked, list[str]] = {}
    for extra in EXTRAS:
        for item in locked(folder / f"requirements-{extra}.txt"):
            needed.setdefault(item, []).append(extra)
    for item, extras in sorted(needed.items()):
        bom.components.add(component := _component(item, extras))
        bom.register_dependency(itself, [component])
    made = json.loads(JsonV1Dot6(bom).output_as_string())
    return json.dumps(made, indent=2, sort_keys=True) + "\n"
