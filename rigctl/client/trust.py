"""Which daemon a client believes, and how it proves an operator's command.

On the daemon's computer the run-time folder is the root of trust: the daemon signs every answer and every message with
a key of its run, whose public half is there, and an operator's command is proven with the operator key that is there.
A liveliness token, a reply's replier id or a name in a message prove nothing, since any session may state them.

Over TLS the gateway's access list says who may answer. Without TLS from another computer, and for a user who may not
read the folder, nothing is verified: such a client reads, and the daemon refuses its commands but HOLD.
"""

from __future__ import annotations

import contextlib
import secrets
import time
from collections.abc import Iterator
from dataclasses import dataclass

import msgspec
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

from rigctl.client.local_hold import same_endpoint
from rigctl.config import layout
from rigctl.config.address import is_local
from rigctl.ipc.runtime_folder import Runtime
from rigctl.ipc.trusted_folders import trusted_folders
from rigctl.wire import proof
from rigctl.wire.proof import NONCE_BYTES, Attachment
from rigctl.wire.run_keys import OPERATOR_KEY, PUBLIC_KEY, KeyFile

_READ_NS = 200_000_000  # at most one look at the folders in this time, whatever a hostile session sends


@dataclass(frozen=True)
class LocalDaemon:
    """A daemon whose run-time folder this user believes. ``operator``: None if this user may not command."""

    rig: str
    listen: str
    folder: str
    public: bytes
    operator: bytes | None


def _key(folder: Runtime, name: str) -> KeyFile | None:
    with contextlib.suppress(OSError, msgspec.MsgspecError):
        return msgspec.convert(folder.read_json(name), KeyFile)
    return None


def local_daemons() -> Iterator[LocalDaemon]:
    """The daemons of this computer that this user may believe."""
    for folder in trusted_folders():
        found = Runtime(folder)
        if (public := _key(found, PUBLIC_KEY)) is not None:
            operator = _key(found, OPERATOR_KEY)
            secret = operator.secret if operator is not None and operator.run_id == public.run_id else None
            yield LocalDaemon(public.rig, public.listen, str(folder), public.secret, secret)


class Trust:
    """What one client believes of one rig at one endpoint."""

    def __init__(self, rig: str, endpoint: str) -> None:
        self.rig, self.endpoint = rig, endpoint
        self._daemons: list[LocalDaemon] = []
        self._verifiers: list[Ed25519PublicKey] = []
        self._read_ns = 0
        self._clock_ns = 0  # the daemon's clock less this computer's
        self._stamp = 0
        self._read()

    def _read(self) -> None:
        """Find the daemon's keys; another start of the daemon has others."""
        self._read_ns = time.monotonic_ns() + _READ_NS
        named = [one for one in local_daemons() if one.rig == self.rig]
        here = [one for one in named if same_endpoint(self.endpoint, one.listen)]
        # A rig of this computer may also be reached through the router of another one that it joined.
        found = here or (named if is_local(self.endpoint) else [])
        if found or not self._daemons:  # between two runs there is no folder, and nobody else is believed meanwhile
            self._daemons = found
            self._verifiers = [Ed25519PublicKey.from_public_bytes(one.public) for one in found]

    def _read_again(self) -> bool:
        if time.monotonic_ns() < self._read_ns:
            return False
        before = self._daemons
        self._read()
        return self._daemons != before

    @property
    def verifies(self) -> bool:
        """Whether answers and messages are verified."""
        return bool(self._verifiers)

    @property
    def certified(self) -> bool:
        """Whether the endpoint's certificates say who may answer."""
        return self.endpoint.startswith("tls/")

    @property
    def words(self) -> str:
        """Why nothing is verified, or why no command can be proven, in one line; empty if all is well."""
        if self.certified:
            return ""
        where = f"{layout.RUN} or {layout.SHARED_MEMORY}, rigctl-{self.rig}"
        if not self.verifies:
            return (
                f"{self.rig} at {self.endpoint} is not verified, and its daemon takes no command but HOLD from here: "
                f"this user can read no key of it (expected in {where})"
            )
        if self._secret is None:
            return f"{self.rig} takes no command but HOLD from this user, who cannot read {OPERATOR_KEY} (in {where})"
        return ""

    @property
    def _secret(self) -> bytes | None:
        return next((one.operator for one in self._daemons if one.operator is not None), None)

    # -- what the daemon says -------------------------------------------------------------------------------
    def is_answer(self, signature: bytes | None, nonce: str, key: str, payload: bytes, *, good: bool) -> bool:
        """Whether the daemon gave this answer; without a key every answer counts."""
        while self._verifiers:
            if any(proof.is_answer(one, signature, nonce, key, payload, good=good) for one in self._verifiers):
                return True
            if not self._read_again():
                return False
        return True

    def stamp_of(self, seal: bytes | None, key: str, payload: bytes) -> int | None:
        """The stamp of a published message, None if it is not the daemon's; without a key every message has stamp 0."""
        while self._verifiers:
            for one in self._verifiers:
                if (stamp := proof.stamp_of(one, seal, key, payload)) is not None:
                    return stamp
            if not self._read_again():
                return None
        return 0

    # -- who commands it ------------------------------------------------------------------------------------
    def attachment(self, key: str, payload: bytes, lease: str | None = None, public: str | None = None) -> Attachment:
        """The attachment of a command: its proofs under the operator key and under the lease."""
        self._stamp = max(self._stamp + 1, time.monotonic_ns() + self._clock_ns)
        made = Attachment(secrets.token_hex(NONCE_BYTES), self._stamp, public=public)
        if (secret := self._secret) is not None:
            made.operator = proof.command_proof(secret, made, key, payload)
        if lease is not None:
            made.lease = proof.command_proof(proof.lease_secret(lease), made, key, payload)
        return made

    def is_renewed(self, secret: bytes | None) -> bool:
        """Whether the operator key is another than ``secret`` by now: the daemon has been started anew."""
        self._read()
        return self._secret != secret

    def set_clock(self, daemon_ns: int) -> None:
        """Take over the daemon's clock from an answer, for the stamps of commands."""
        self._clock_ns = daemon_ns - time.monotonic_ns()
        self._stamp = 0

    @property
    def secret(self) -> bytes | None:
        """The operator key, from which a lease's key is derived."""
        return self._secret
