"""A key file: private key, certificate and the authority's certificate of one holder, in one file of PEM blocks.

Name, role and dates stand in words above the blocks, so that a client needs no library to read them. They are for
the client's own use: the daemon believes only the certificate.
"""

from __future__ import annotations

import datetime
import os
import pathlib
import re
import stat
from dataclasses import dataclass, field

from rigctl.identity.roles import Role, is_name

_BLOCK = re.compile(r"-----BEGIN ([A-Z ]+)-----\n[A-Za-z0-9+/=\n]+-----END \1-----\n")
_BLOCKS = ["PRIVATE KEY", "CERTIFICATE", "CERTIFICATE"]
_LONGEST = 65_536
_FORM = "a key file from rigctl keys add"


class CredentialsError(ValueError):
    """A key file that cannot be used; ``str()`` is one line that names it."""


@dataclass(frozen=True)
class Credentials:
    """What one holder proves its name with; ``key``, ``certificate`` and ``authority`` are PEM."""

    name: str
    role: Role
    not_after: datetime.datetime
    key: str = field(repr=False)
    certificate: str = field(repr=False)
    authority: str = field(repr=False)

    def as_text(self) -> str:
        """The key file's text."""
        return (
            f"name: {self.name}\nrole: {self.role.value}\nuntil: {self.not_after.isoformat()}\n"
            f"{self.key}{self.certificate}{self.authority}"
        )


def of_text(text: str, where: str) -> Credentials:
    """Credentials from a key file's text; ``where``: the file, for the message.

    Raises:
        CredentialsError: it is no key file.
    """
    said = dict(re.findall(r"^([a-z]+): (\S+)$", text, re.MULTILINE))
    blocks = list(_BLOCK.finditer(text))
    if [block[1] for block in blocks] != _BLOCKS:
        found = ", ".join(block[1].lower() for block in blocks) or "no key"
        raise CredentialsError(f"{where}: found {found}, expected {_FORM}")
    try:
        name, role = said["name"], Role(said["role"])
        not_after = datetime.datetime.fromisoformat(said["until"])
    except (KeyError, ValueError) as error:
        raise CredentialsError(f"{where}: found no valid name, role or date ({error}), expected {_FORM}") from None
    if not is_name(name) or not_after.tzinfo is None:
        raise CredentialsError(f"{where}: found no valid name or date, expected {_FORM}")
    return Credentials(name, role, not_after, blocks[0][0], blocks[1][0], blocks[2][0])


def read(file: pathlib.Path) -> Credentials:
    """Read a key file.

    Raises:
        CredentialsError: it cannot be read, others may read it, or it is no key file.
    """
    return of_text(read_private(file), str(file))


def read_private(file: pathlib.Path) -> str:
    """The text of a file that only its owner may read: this user, or root.

    Raises:
        CredentialsError: it cannot be read, is no plain file or no ASCII text, or belongs to or is open to others.
    """
    try:
        fd = os.open(file, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except (OSError, ValueError) as error:
        raise CredentialsError(f"{file}: cannot be read: {getattr(error, 'strerror', None) or error}") from None
    about = os.fstat(fd)
    if not stat.S_ISREG(about.st_mode):
        os.close(fd)  # a folder cannot be made a file object
        raise CredentialsError(f"{file}: found no plain file, expected {_FORM}")
    with os.fdopen(fd, "rb") as opened:
        if about.st_uid not in (os.geteuid(), 0):
            raise CredentialsError(f"{file}: found a file of uid {about.st_uid}, expected one of uid {os.geteuid()}")
        if about.st_mode & 0o077:
            mode = stat.S_IMODE(about.st_mode)
            raise CredentialsError(f"{file}: found mode {mode:04o}, expected 0600: others may read the key (chmod 600)")
        try:
            return opened.read(_LONGEST).decode("ascii")
        except UnicodeDecodeError as error:
            raise CredentialsError(
                f"{file}: found bytes that are no text (at {error.start}), expected {_FORM}"
            ) from None
