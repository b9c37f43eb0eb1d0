"""The folder of a rig's keys: authority, the gateway's key, the access file, and keys to be handed to people.

``authority.key`` signs; it may be kept elsewhere, since the daemon does not need it. The gateway reads ``gateway.pem``
and ``access.json``.
"""

from __future__ import annotations

import datetime
import os
import pathlib
import stat

from rigctl.identity import access_file, credentials
from rigctl.identity.access_file import AccessFileError, Certified
from rigctl.identity.credentials import Credentials, CredentialsError
from rigctl.identity.roles import GATEWAY_NAME
from rigctl.ipc import wall_clock

AUTHORITY_KEY, AUTHORITY = "authority.key", "authority.pem"
ACCESS = "access.json"
ISSUED = "issued"
_GATEWAY = f"{GATEWAY_NAME}.pem"


class KeyFolderError(ValueError):
    """A key folder that cannot be used; ``str()`` is one line that names it."""


class HostError(KeyFolderError):
    """A host for which there can be no certificate; ``str()`` is one line."""


class KeyFolder:
    """Reads a key folder."""

    def __init__(self, path: pathlib.Path) -> None:
        self.path = path

    @property
    def gateway(self) -> pathlib.Path:
        """The gateway's key file."""
        return self.path / _GATEWAY

    @property
    def access(self) -> pathlib.Path:
        """The access file."""
        return self.path / ACCESS

    def issued(self, name: str) -> pathlib.Path:
        """The key file to hand to a person."""
        return self.path / ISSUED / f"{name}.pem"

    def check(self) -> None:
        """Check that only this user, or root, can enter or change the folder.

        Raises:
            KeyFolderError: it is missing, no folder, or of or open to others.
        """
        try:
            found = self.path.lstat()
        except OSError as error:
            raise KeyFolderError(f"{self.path}: {error.strerror}; make it with rigctl keys init") from None
        if not stat.S_ISDIR(found.st_mode):
            raise KeyFolderError(f"{self.path}: found no folder, expected one from rigctl keys init")
        if found.st_uid not in (os.geteuid(), 0):
            raise KeyFolderError(f"{self.path}: found a folder of uid {found.st_uid}, expected uid {os.geteuid()}")
        if found.st_mode & 0o077:
            mode = stat.S_IMODE(found.st_mode)
            raise KeyFolderError(f"{self.path}: found mode {mode:04o}, expected 0700: others may enter it (chmod 700)")

    def certificates(self) -> list[Certified]:
        """Every certificate issued, in the order of their issue.

        Raises:
            KeyFolderError: the folder or its access file cannot be used.
        """
        self.check()
        try:
            return access_file.decode(self.access.read_bytes())
        except OSError as error:
            raise KeyFolderError(f"{self.access}: {error.strerror}; make it with rigctl keys init") from None
        except AccessFileError as error:
            raise KeyFolderError(f"{self.access}: {error}, expected one from rigctl keys init") from None

    def gateway_credentials(self) -> Credentials:
        """The gateway's key, certificate and authority.

        Raises:
            KeyFolderError: the folder or the key file cannot be used.
        """
        self.check()
        try:
            return credentials.read(self.gateway)
        except CredentialsError as error:
            raise KeyFolderError(str(error)) from None

    def check_gateway(self, now: datetime.datetime) -> None:
        """Check that a gateway can be started with the folder.

        Raises:
            KeyFolderError: the folder or a file in it cannot be used, or the gateway's certificate has expired by a
                clock that can be right. By another one TLS refuses everyone, but this computer's users need the rig.
        """
        self.certificates()
        until = self.gateway_credentials().not_after
        if until <= now and not wall_clock.unset(now):
            raise KeyFolderError(f"{self.gateway}: expired on {until:%Y-%m-%d}: rigctl keys renew {GATEWAY_NAME}")

    def edition(self) -> tuple[int, int, int]:
        """Changes whenever the access file does; zeros while there is none."""
        try:
            found = self.access.stat()
        except OSError:
            return 0, 0, 0
        return found.st_ino, found.st_mtime_ns, found.st_size
