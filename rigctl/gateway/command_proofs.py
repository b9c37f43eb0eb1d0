"""Who gives a command: checks its proofs, and that it is neither old nor given twice.

A proof covers the command's bytes, a nonce and a stamp. A stamp is valid for ``FRESH_NS`` and not before this gateway
started, and a nonce counts once in that time, so a command that somebody kept cannot be given again.
"""

from __future__ import annotations

import secrets
import threading
from dataclasses import dataclass
from enum import Enum

from rigctl.gateway.run_keys import RunKeys
from rigctl.wire import proof
from rigctl.wire.lease import NewLease
from rigctl.wire.proof import NONCE_BYTES, Attachment

FRESH_NS = 5_000_000_000  # a busy computer takes seconds between proof and check; a client repeats a refused stamp once


class ProofStanding(Enum):
    """What the proofs of a command show; the value is the refusal's ``reason``."""

    PROVEN = "proven"
    UNPROVEN = "no_proof"
    OLD = "proof_old"


@dataclass(frozen=True)
class Shown:
    """What a command shows. ``holder``: it was given under the lease in force. ``new``: the lease it may be granted."""

    standing: ProofStanding
    holder: bool = False
    claims_lease: bool = False
    new: NewLease | None = None


class CommandProofs:
    """Checks the proofs of commands; every method may be called from any thread."""

    def __init__(self, keys: RunKeys, now_ns: int, *, certified: bool) -> None:
        """``certified``: commands come over TLS, whose access list says who may command."""
        self._keys, self._started_ns, self._certified = keys, now_ns, certified
        self._lock = threading.Lock()
        self._used: dict[str, int] = {}  # nonce: stamp, in the order of their arrival

    def shown(
        self, attachment: Attachment | None, operator: str, key: str, payload: bytes, lease: str | None, now_ns: int
    ) -> Shown:
        """What a command shows; ``lease``: id of the lease in force, if any."""
        if attachment is None:
            return Shown(ProofStanding.UNPROVEN)
        by_key = proof.is_proof(self._keys.operator, attachment.operator, attachment, key, payload)
        holder = lease is not None and proof.is_proof(
            proof.lease_secret(lease), attachment.lease, attachment, key, payload
        )
        claims = attachment.lease is not None
        if not (by_key or (self._certified and (holder or attachment.public is not None))):
            return Shown(ProofStanding.UNPROVEN, claims_lease=claims)
        if not self._is_fresh(attachment, now_ns):
            return Shown(ProofStanding.OLD, claims_lease=claims)
        return Shown(ProofStanding.PROVEN, holder, claims, self._new_lease(attachment, operator, by_key=by_key))

    def _is_fresh(self, attachment: Attachment, now_ns: int) -> bool:
        """Whether this is the first command with this nonce, and its stamp is of now."""
        stamp = attachment.stamp
        if stamp < self._started_ns or abs(now_ns - stamp) > FRESH_NS:
            return False
        with self._lock:
            if attachment.nonce in self._used:
                return False
            while self._used:
                nonce, oldest = next(iter(self._used.items()))
                if now_ns - oldest <= 2 * FRESH_NS:
                    break
                del self._used[nonce]
            self._used[attachment.nonce] = stamp
            return True

    def _new_lease(self, attachment: Attachment, operator: str, *, by_key: bool) -> NewLease | None:
        nonce, public, secret = secrets.token_hex(NONCE_BYTES), "", self._keys.operator
        if not by_key:
            if attachment.public is None:
                return None
            private, public = proof.exchange()
            try:
                secret = proof.exchanged_key(private, attachment.public)
            except ValueError:
                return None
        return NewLease(proof.derived_key(secret, operator, attachment.nonce, nonce), nonce, public)


def refusal_text(standing: ProofStanding) -> str:
    """Why a command is refused, in one line."""
    if standing is ProofStanding.OLD:
        return "found a proof that is old or was used before, expected one made for this command now"
    return (
        "found no proof of who gives it, expected one with the operator key of this run: give it as the daemon's user "
        "on the daemon's computer, or with a certificate over TLS; HOLD needs none"
    )
