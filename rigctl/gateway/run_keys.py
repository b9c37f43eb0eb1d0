"""Makes the keys of this run, or continues with those of the gateway before this one: see `rigctl.wire.run_keys`."""

from __future__ import annotations

import secrets
from dataclasses import dataclass

import msgspec
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from rigctl.ipc.runtime_folder import Runtime
from rigctl.ipc.writers import OPERATORS, group_id
from rigctl.wire.proof import KEY_BYTES
from rigctl.wire.run_keys import GATEWAY_KEY, OPERATOR_KEY, PUBLIC_KEY, KeyFile


@dataclass(frozen=True)
class RunKeys:
    """``private`` signs what the daemon says; ``operator`` proves an operator's command."""

    private: Ed25519PrivateKey
    operator: bytes


def _kept(runtime: Runtime, name: str, like: KeyFile, mode: int = 0o600, group: int = -1) -> KeyFile:
    """The key in a file of this run, else a new one, which is written."""
    try:
        found = msgspec.convert(runtime.read_json(name), KeyFile)
        if (found.rig, found.run_id) == (like.rig, like.run_id):
            like.key = found.key
    except (OSError, msgspec.MsgspecError):
        pass
    runtime.write_json(name, like, mode, group)
    return like


def run_keys(runtime: Runtime, rig: str, listen: str, run_id: str) -> RunKeys:
    """The keys of this run, with every file written.

    Raises:
        OSError: a file cannot be written.
    """

    def new() -> KeyFile:
        return KeyFile(rig, listen, run_id, secrets.token_hex(KEY_BYTES))

    private = Ed25519PrivateKey.from_private_bytes(_kept(runtime, GATEWAY_KEY, new()).secret)
    group = group_id(OPERATORS) if runtime.file_mode & 0o040 else -1
    operator = _kept(runtime, OPERATOR_KEY, new(), 0o640 if group >= 0 else 0o600, group).secret
    public = private.public_key().public_bytes_raw().hex()
    runtime.write_json(PUBLIC_KEY, KeyFile(rig, listen, run_id, public), runtime.public_mode)
    return RunKeys(private, operator)
