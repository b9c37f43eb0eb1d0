"""The seal of a recording's file: its last metadata, over the SHA-256 of all that is before it.

What follows is only the index, which no reader here uses. A part is sealed at its end: one that a killed recorder left
has no seal.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum

from rigctl.config.settings import RigSettings
from rigctl.ipc import seal
from rigctl.ipc.seal import SealError, SealVerdict
from rigctl.recorder.file_reader import ReadFile

_SEALED = "recording"


class PartStanding(Enum):
    """What the seal of a file says of it, worst last."""

    INTACT = "sealed, intact"
    UNKNOWN = "sealed, which cannot be verified here"
    UNSEALED = "no seal"
    CHANGED = "changed since it was sealed"


def sealer(settings: RigSettings) -> Callable[[str], str]:
    """Seals a SHA-256 with the rig's key; empty if the key cannot be used, which `rigctl info` then shows."""

    def sealed(sha256: str) -> str:
        try:
            return seal.seal(settings, _SEALED, sha256.encode())
        except SealError:
            return ""

    return sealed


def standing(settings: RigSettings | None, file: ReadFile) -> PartStanding:
    """What the seal of a file says; ``settings``: of its rig, whose key verifies it, None if they are not known."""
    found = file.seal
    if found is None:
        return PartStanding.UNSEALED
    if found.sha256 != found.found_sha256:
        return PartStanding.CHANGED
    if settings is None or not seal.key_file(settings, _SEALED).exists():
        return PartStanding.UNKNOWN
    try:
        verdict = seal.verdict(settings, _SEALED, found.sha256.encode(), found.seal)
    except SealError:
        return PartStanding.UNKNOWN
    return {SealVerdict.GOOD: PartStanding.INTACT, SealVerdict.BROKEN: PartStanding.CHANGED}.get(
        verdict, PartStanding.UNKNOWN
    )
