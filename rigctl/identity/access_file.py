"""``access.json`` of a key folder: every certificate issued, with its role, dates and revocation.

The gateway makes its access list from it. What it does not name is refused, however well it is signed.
"""

from __future__ import annotations

import datetime
import re

import msgspec

from rigctl.config.built_type import built
from rigctl.identity.roles import Role, common_name, is_name

VERSION = 1
_SERIAL = re.compile(r"[0-9a-f]{16}")


class AccessFileError(ValueError):
    """An access file that cannot be used; ``str()`` is one line without the file's name."""


class Certified(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A certificate issued; times are UTC. ``revoked``: since when it is refused, None while it is not."""

    name: str
    role: Role
    serial: str
    not_before: datetime.datetime
    not_after: datetime.datetime
    revoked: datetime.datetime | None = None

    @property
    def common_name(self) -> str:
        """The common name in the certificate."""
        return common_name(self.name, self.serial)

    def is_valid(self, now: datetime.datetime) -> bool:
        """Whether it is neither revoked nor past its end."""
        return self.revoked is None and now < self.not_after

    def standing(self, now: datetime.datetime) -> str:
        """``valid``, ``not yet valid``, ``expired`` or ``revoked``."""
        if self.revoked is not None:
            return "revoked"
        return "expired" if not self.is_valid(now) else "valid" if self.not_before <= now else "not yet valid"


@built
class _Document(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    version: int
    certificates: list[Certified]


def encode(certificates: list[Certified]) -> bytes:
    """The file's bytes."""
    return msgspec.json.format(msgspec.json.encode(_Document(VERSION, certificates)), indent=2) + b"\n"


def decode(data: bytes) -> list[Certified]:
    """The certificates of a file's bytes, in the order of their issue.

    Raises:
        AccessFileError: it is damaged, or of another version.
    """
    try:
        found = msgspec.json.decode(data, type=_Document)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise AccessFileError(f"found damaged content ({' '.join(str(error).split())})") from None
    if found.version != VERSION:
        raise AccessFileError(f"found version {found.version}, expected {VERSION}")
    for one in found.certificates:
        if not is_name(one.name) or not _SERIAL.fullmatch(one.serial):
            raise AccessFileError(f"found a certificate of {one.name[:40]!r} with serial {one.serial[:20]!r}")
        if any(time is not None and time.tzinfo is None for time in (one.not_before, one.not_after, one.revoked)):
            raise AccessFileError(f"found a time without zone in the certificate of {one.name}")
    return found.certificates
