"""The sealed head of an audit log, beside it: who cuts the log off, or computes its chain anew, is noticed.

The chain itself shows a changed line, but anyone can compute hashes. The head is sealed with the rig's key.
"""

from __future__ import annotations

import pathlib

import msgspec

from rigctl.config import input_file
from rigctl.config.built_type import built
from rigctl.config.settings import RigSettings
from rigctl.ipc import whole_file
from rigctl.ipc.seal import SealError, SealVerdict, key_file, seal, verdict
from rigctl.recorder.chain import ORIGIN

_SEALED = "audit"


@built
class SealedHead(msgspec.Struct):
    """Number of entries, hash of the last, and the seal of both."""

    entries: int
    head: str
    seal: str = ""

    @property
    def sealed(self) -> bytes:
        """What the seal is about."""
        return f"{self.entries} {self.head}".encode()


def head_file(settings: RigSettings) -> pathlib.Path:
    """The file of the sealed head."""
    return settings.audit_log.with_name(f"{settings.audit_log.name}.head")


def write(settings: RigSettings, entries: int, head: str) -> None:
    """Seal a head and write it.

    Raises:
        OSError: it cannot be written.
        SealError: the rig's key cannot be used.
    """
    made = SealedHead(entries, head)
    made.seal = seal(settings, _SEALED, made.sealed)
    whole_file.replace(head_file(settings), msgspec.json.encode(made) + b"\n", mode=0o640, sync=False)


def read(settings: RigSettings) -> str | None:
    """The sealed head; None if none was ever sealed, or this user cannot verify it.

    Raises:
        SealError: the file is gone though the rig has a key, is damaged, or its seal is not the rig's; one line.
    """
    path = head_file(settings)
    try:
        found: SealedHead = input_file.decoded(input_file.read(path), SealedHead)
    except FileNotFoundError:
        if verdict(settings, _SEALED, b"", "") is SealVerdict.BROKEN and settings.audit_log.exists():
            raise SealError(f"{path}: the sealed head of the log is gone, though the rig has a key") from None
        return None
    except (OSError, msgspec.MsgspecError) as error:
        raise SealError(f"{path}: no sealed head: {' '.join(str(error).split())}") from None
    match verdict(settings, _SEALED, found.sealed, found.seal):
        case SealVerdict.BROKEN:
            raise SealError(f"{path}: its seal is not that of {key_file(settings, _SEALED)}: somebody else wrote it")
        case SealVerdict.GOOD if found.head != ORIGIN:
            return found.head
    return None
