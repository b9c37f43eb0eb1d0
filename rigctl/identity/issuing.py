"""Issues, renews and revokes: what ``rigctl keys`` does to a key folder. Time is passed in."""

from __future__ import annotations

import contextlib
import datetime
import fcntl
import os
import pathlib
import secrets
import socket
from collections.abc import Iterator, Sequence

import msgspec

from rigctl.config.address import HOST_ALLOWED, is_host
from rigctl.identity import access_file, certificates
from rigctl.identity.access_file import Certified
from rigctl.identity.certificates import BACKDATED, IssuedKey
from rigctl.identity.credentials import Credentials, CredentialsError, read, read_private
from rigctl.identity.key_folder import AUTHORITY, AUTHORITY_KEY, HostError, KeyFolder, KeyFolderError
from rigctl.identity.roles import GATEWAY_NAME, NAME_ALLOWED, Role, is_name
from rigctl.ipc import whole_file

AUTHORITY_DAYS, GATEWAY_DAYS, PERSON_DAYS = 3650, 825, 365
_SERIAL_BITS = 63  # a serial number is positive
_LOCK = ".lock"


def own_hosts() -> list[str]:
    """Names and addresses by which this computer reaches itself, and its host name."""
    return [host for host in ("localhost", "127.0.0.1", "::1", socket.gethostname()) if is_host(host)]


def _check_hosts(hosts: Sequence[str]) -> None:
    for host in hosts:
        if not is_host(host):
            raise HostError(f"--host: found {host[:40]!r}, expected {HOST_ALLOWED}")


class KeyIssuer:
    """Changes a key folder, one command at a time."""

    def __init__(self, path: pathlib.Path, now: datetime.datetime) -> None:
        self.folder = KeyFolder(path)
        self._now = now.replace(microsecond=0)

    @contextlib.contextmanager
    def _locked(self) -> Iterator[None]:
        self.folder.check()
        fd = os.open(self.folder.path / _LOCK, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)
        try:
            fcntl.flock(fd, fcntl.LOCK_EX)
            yield
        finally:
            os.close(fd)

    def _write(self, file: pathlib.Path, text: str | bytes) -> None:
        whole_file.replace(file, text.encode() if isinstance(text, str) else text, mode=0o600)

    def _authority(self) -> IssuedKey:
        path = self.folder.path
        try:
            key = read_private(path / AUTHORITY_KEY)
            return IssuedKey(key, (path / AUTHORITY).read_text(encoding="ascii"))
        except UnicodeDecodeError:
            raise KeyFolderError(f"{path / AUTHORITY}: found bytes that are no text, expected a certificate") from None
        except (CredentialsError, OSError) as error:
            raise KeyFolderError(f"{error} (the authority's key signs; put it back if it is kept elsewhere)") from None

    def _issue(
        self, issuer: IssuedKey, name: str, role: Role, days: int, hosts: Sequence[str] = ()
    ) -> tuple[Credentials, Certified]:
        serial = f"{secrets.randbits(_SERIAL_BITS) | 1:016x}"
        start, end = self._now - BACKDATED, self._now + datetime.timedelta(days=days)
        try:
            made = certificates.issue(issuer, name, role, serial, start, end, hosts)
        except ValueError as error:
            raise KeyFolderError(f"{self.folder.path}: {' '.join(str(error).split())}") from None
        end = certificates.last_day(made.certificate)
        owned = Credentials(name, role, end, made.key, made.certificate, issuer.certificate)
        return owned, Certified(name, role, serial, start, end)

    def init(self, hosts: Sequence[str], days: int = GATEWAY_DAYS) -> Certified:
        """Make the folder: authority, the gateway's key, an access file that names the gateway alone.

        ``hosts``: further names and addresses at which clients reach the gateway.

        Raises:
            KeyFolderError: there is one already, or its place cannot be used; a host is none (`HostError`).
            OSError: a file cannot be written; the folder is left without keys.
        """
        _check_hosts(hosts)
        path = self.folder.path
        path.mkdir(mode=0o700, parents=True, exist_ok=True)
        with self._locked():
            if self.folder.access.exists() or (path / AUTHORITY).exists():
                raise KeyFolderError(f"{path}: found keys, expected an empty folder: nothing was changed")
            made = certificates.authority(self._now - BACKDATED, self._now + datetime.timedelta(days=AUTHORITY_DAYS))
            owned, entry = self._issue(made, GATEWAY_NAME, Role.GATEWAY, days, [*own_hosts(), *hosts])
            files: dict[pathlib.Path, str | bytes] = {
                path / AUTHORITY_KEY: made.key, path / AUTHORITY: made.certificate,
                self.folder.gateway: owned.as_text(), self.folder.access: access_file.encode([entry]),
            }  # fmt: skip
            with contextlib.ExitStack() as undo:
                for file, text in files.items():
                    undo.callback(file.unlink, missing_ok=True)
                    self._write(file, text)
                undo.pop_all()
        return entry

    def add(self, name: str, role: Role, days: int = PERSON_DAYS, hosts: Sequence[str] = ()) -> Certified:
        """Issue the first key of a person's name, or of a page.

        ``hosts``: names and addresses at which browsers reach a page, beside those of this computer.

        Raises:
            KeyFolderError: the name is not valid or has a valid key, or the folder cannot be used; a host is none.
        """
        _check_hosts(hosts)
        if not is_name(name) or name == GATEWAY_NAME:
            raise KeyFolderError(f"found the name {name[:40]!r}, expected {NAME_ALLOWED}, and not {GATEWAY_NAME}")
        with self._locked():
            entries = self.folder.certificates()
            if any(one.name == name and one.is_valid(self._now) for one in entries):
                raise KeyFolderError(f"{name} has a valid key: rigctl keys renew {name}, or revoke it first")
            return self._add(entries, name, role, days, [*own_hosts(), *hosts] if role is Role.PAGE else ())

    def renew(self, name: str, days: int | None = None, hosts: Sequence[str] = ()) -> Certified:
        """Issue another key to a name, in its role; its earlier keys stay good until they expire or are revoked.

        ``hosts``: of the gateway or a page, in place of those of its certificate before.

        Raises:
            KeyFolderError: the name has no key or was revoked, or the folder cannot be used; a host is none.
        """
        _check_hosts(hosts)
        with self._locked():
            entries = self.folder.certificates()
            newest = next((one for one in reversed(entries) if one.name == name), None)
            if newest is None:
                raise KeyFolderError(f"{name[:40]!r} has no key: rigctl keys add NAME --role ROLE")
            if newest.revoked is not None:
                raise KeyFolderError(f"{name} was revoked: rigctl keys add {name} --role ROLE gives a new key")
            if hosts and not newest.role.is_server:
                raise KeyFolderError(
                    f"found --host for {name}, {newest.role.value}: expected for gateway and page alone"
                )
            usual = GATEWAY_DAYS if newest.role is Role.GATEWAY else PERSON_DAYS
            named = [*own_hosts(), *hosts] if hosts else self._hosts_before(newest)
            return self._add(entries, name, newest.role, days or usual, named)

    def _hosts_before(self, newest: Certified) -> list[str]:
        """Hosts in the certificate before, if it is one of a server and still here."""
        if newest.role is Role.GATEWAY:
            return certificates.hosts_of(self.folder.gateway_credentials().certificate)
        if newest.role is not Role.PAGE:
            return []
        try:
            return certificates.hosts_of(read(self.folder.issued(newest.name)).certificate)
        except CredentialsError as error:
            raise KeyFolderError(f"{error}; name the hosts of the page with --host") from None

    def _add(self, entries: list[Certified], name: str, role: Role, days: int, hosts: Sequence[str] = ()) -> Certified:
        owned, entry = self._issue(self._authority(), name, role, days, hosts)
        file = self.folder.gateway if name == GATEWAY_NAME else self.folder.issued(name)
        file.parent.mkdir(mode=0o700, exist_ok=True)
        self._write(file, owned.as_text())
        self._write(self.folder.access, access_file.encode([*entries, entry]))
        return entry

    def revoke(self, name: str) -> int:
        """Refuse every key of a name from now on; returns how many were valid.

        Raises:
            KeyFolderError: the name has no valid key, or the folder cannot be used.
        """
        with self._locked():
            entries = self.folder.certificates()
            good = [one for one in entries if one.name == name and one.is_valid(self._now)]
            if not good or name == GATEWAY_NAME:
                why = "rigctl keys renew gateway" if name == GATEWAY_NAME else "rigctl keys list shows the names"
                raise KeyFolderError(f"{name[:40]!r} has no valid key that can be revoked: {why}")
            changed = [msgspec.structs.replace(one, revoked=self._now) if one in good else one for one in entries]
            self._write(self.folder.access, access_file.encode(changed))
        return len(good)
