"""Seals of a rig's files: a file that somebody else has edited is noticed when it is read.

A seal is HMAC-SHA256 over the content under a key of the rig, which lies in the folder of the sealed file (0600, of the
user who runs the daemon). Who can read the key can seal. A user who cannot, reads a file without its seal verified. In
the installed service the daemon's other processes read the key too (0640), but only the one that writes the file can
write into its folder.
"""

from __future__ import annotations

import contextlib
import hashlib
import hmac
import os
import pathlib
import secrets
import stat
from enum import Enum

from rigctl.config import input_file, layout
from rigctl.config.settings import RigSettings
from rigctl.ipc import whole_file

KEY_BYTES = 32
LEDGER = "ledger"
"""What the ledger is called."""


class SealError(RuntimeError):
    """The key cannot be read or made, or is not its owner's alone; ``str()`` is one line."""


class SealVerdict(Enum):
    """What a seal says of a file."""

    GOOD = "sealed"
    BROKEN = "edited since it was sealed"
    UNSEALED = "never sealed"  # and there is no key yet
    UNKNOWN = "its seal cannot be verified by this user"


def key_file(settings: RigSettings, name: str) -> pathlib.Path:
    """The rig's key for what is called ``name``: beside the ledger, that of the audit log beside the last stroke.

    Each name has a key of its own: a file from before there were seals is believed until its own first seal.
    """
    beside = settings.ledger if name == LEDGER and settings.ledger is not None else settings.last_stroke
    return beside.with_name(f"{settings.rig}.{name}.key")


def _mode(settings: RigSettings) -> int:
    return 0o640 if layout.is_installed(settings.directory) else 0o600


def _key(path: pathlib.Path, allowed: int) -> bytes:
    """The key. ``allowed``: its mode.

    Raises:
        OSError: it cannot be read, or there is none.
        SealError: it is not its owner's alone, or no key.
    """
    found = path.lstat()
    # Who owns the folder can replace key and file together.
    owners = (0, os.geteuid(), path.parent.stat().st_uid)
    if found.st_mode & 0o777 & ~allowed or not stat.S_ISREG(found.st_mode) or found.st_uid not in owners:
        mode = f"user {found.st_uid} and mode {stat.S_IMODE(found.st_mode):04o}"
        raise SealError(f"{path}: found {mode}, expected a file of user {os.geteuid()} with mode {allowed:04o}")
    key = input_file.read(path, largest=4 * KEY_BYTES).strip()
    if len(key) != 2 * KEY_BYTES:
        raise SealError(f"{path}: found {len(key)} bytes, expected a key of {2 * KEY_BYTES}")
    return key


def _mac(key: bytes, name: str, data: bytes) -> str:
    return hmac.new(key, len(name).to_bytes(4, "little") + name.encode() + data, hashlib.sha256).hexdigest()


def seal(settings: RigSettings, name: str, data: bytes) -> str:
    """The seal of ``data``, the content of what is called ``name``; the first seal makes the key.

    Raises:
        SealError: the key cannot be read or made.
    """
    path = key_file(settings, name)
    try:
        with contextlib.suppress(FileExistsError):
            path.parent.mkdir(parents=True, exist_ok=True)
            fd = os.open(path, whole_file.NEW, _mode(settings))
            with os.fdopen(fd, "wb") as file:
                file.write(secrets.token_hex(KEY_BYTES).encode() + b"\n")
                file.flush()
                os.fsync(fd)
            whole_file.sync_folder(path.parent)
        return _mac(_key(path, _mode(settings)), name, data)
    except OSError as error:
        raise SealError(f"{path}: cannot be used: {error.strerror}") from None


def verdict(settings: RigSettings, name: str, data: bytes, found: str) -> SealVerdict:
    """What the seal ``found`` says of ``data``.

    Raises:
        SealError: the key is not its owner's alone, or no key.
    """
    try:
        key = _key(key_file(settings, name), _mode(settings))
    except FileNotFoundError:
        return SealVerdict.BROKEN if found else SealVerdict.UNSEALED
    except OSError:
        return SealVerdict.UNKNOWN
    return (
        SealVerdict.GOOD if hmac.compare_digest(_mac(key, name, data).encode(), found.encode()) else SealVerdict.BROKEN
    )
