"""Signatures of what the daemon says, and proofs of who commands it. Pure functions of bytes.

The daemon signs with a key of its run (Ed25519), so that nobody else on the same router can answer for it. A command is
proven with HMAC-SHA256 over its bytes: under the run's operator key, which the operators' users can read on the
daemon's computer, and under the lease's key. Neither key is ever sent. The lease's key comes from the operator key
(`derived_key`), or over TLS from an X25519 exchange (`exchanged_key`).
"""

from __future__ import annotations

import hashlib
import hmac
import struct
from typing import Annotated

import msgspec
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey, X25519PublicKey

from rigctl.config.built_type import built
from rigctl.wire.lease import ID_BYTES

KEY_BYTES = 32
NONCE_BYTES = 16
SIGNATURE_BYTES = 64
ATTACHMENT_BYTES = 1024
"""The longest attachment of a query."""
_STAMP = struct.Struct("<Q")
_ANSWER, _MESSAGE, _COMMAND, _LEASE = b"rigctl answer", b"rigctl message", b"rigctl command", b"rigctl lease"
_SEAL = b'{"seal":"'  # an error reply has no attachment, so its signature is the first value of its JSON
_SEAL_BYTES = len(_SEAL) + 2 * SIGNATURE_BYTES + 2

_Hex16 = Annotated[str, msgspec.Meta(pattern="^[0-9a-f]{32}$")]
_Hex32 = Annotated[str, msgspec.Meta(pattern="^[0-9a-f]{64}$")]


@built
class Attachment(msgspec.Struct, omit_defaults=True):
    """What a query carries beside its payload, as JSON.

    ``nonce``: chosen anew for each query; the answer's signature includes it. ``stamp``: CLOCK_MONOTONIC of the
    daemon's host, as far as the client knows it. ``operator``, ``lease``: proofs of a command under the operator key
    and under the lease's key. ``public``: key of the client for `exchanged_key`.
    """

    nonce: _Hex16
    stamp: Annotated[int, msgspec.Meta(ge=0, le=2**63 - 1)] = 0
    operator: _Hex32 | None = None
    lease: _Hex32 | None = None
    public: _Hex32 | None = None


def attachment_of(data: bytes | None) -> Attachment | None:
    """The attachment of a query; None without one, or for anything else."""
    if not data or len(data) > ATTACHMENT_BYTES:
        return None
    try:
        return msgspec.json.decode(data, type=Attachment)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError):
        return None


def _parts(*parts: bytes) -> bytes:
    """Parts with their lengths, so that no two lists of parts give the same bytes."""
    return b"".join(len(part).to_bytes(8, "little") + part for part in parts)


# -- what the daemon says -----------------------------------------------------------------------------------
def answer_signature(private: Ed25519PrivateKey, nonce: str, key: str, payload: bytes, *, good: bool) -> bytes:
    """Signature of the answer to the query with ``nonce``; ``good``: a reply, else an error reply."""
    return private.sign(_answer(nonce, key, payload, good=good))


def is_answer(
    public: Ed25519PublicKey, signature: bytes | None, nonce: str, key: str, payload: bytes, *, good: bool
) -> bool:
    """Whether the daemon gave this answer to the query with ``nonce``."""
    return _is_signed(public, signature, _answer(nonce, key, payload, good=good))


def _answer(nonce: str, key: str, payload: bytes, *, good: bool) -> bytes:
    return _parts(_ANSWER, nonce.encode(), key.encode(), bytes([good]), payload)


def sealed(payload: bytes, signature: bytes) -> bytes:
    """A JSON object with the signature as its first value."""
    return _SEAL + signature.hex().encode() + b'",' + payload[1:]


def unsealed(payload: bytes) -> tuple[bytes, bytes | None]:
    """The JSON object without its signature, and the signature; None for an object without one."""
    if not payload.startswith(_SEAL) or payload[_SEAL_BYTES - 2 : _SEAL_BYTES] != b'",':
        return payload, None
    try:
        signature = bytes.fromhex(payload[len(_SEAL) : _SEAL_BYTES - 2].decode())
    except (ValueError, UnicodeDecodeError):
        return payload, None
    return b"{" + payload[_SEAL_BYTES:], signature


def message_seal(private: Ed25519PrivateKey, stamp: int, key: str, payload: bytes) -> bytes:
    """Attachment of a published message: ``stamp``, which rises with each message of a key, and the signature."""
    head = _STAMP.pack(stamp)
    return head + private.sign(_parts(_MESSAGE, head, key.encode(), payload))


def stamp_of(public: Ed25519PublicKey, seal: bytes | None, key: str, payload: bytes) -> int | None:
    """The stamp of a published message; None if the daemon did not publish it."""
    if seal is None or len(seal) != _STAMP.size + SIGNATURE_BYTES:
        return None
    head, signature = seal[: _STAMP.size], seal[_STAMP.size :]
    if not _is_signed(public, signature, _parts(_MESSAGE, head, key.encode(), payload)):
        return None
    return int(_STAMP.unpack(head)[0])


def _is_signed(public: Ed25519PublicKey, signature: bytes | None, data: bytes) -> bool:
    if signature is None:
        return False
    try:
        public.verify(signature, data)
    except InvalidSignature:
        return False
    return True


# -- who commands it ----------------------------------------------------------------------------------------
def command_proof(secret: bytes, attachment: Attachment, key: str, payload: bytes) -> str:
    """Proof of a command under the operator key or a lease's key; ``key``: the command's own, ``rigctl/RIG/cmd/VERB``.

    It covers the exchange's public key too, so that nobody can put another in its place.
    """
    parts = (attachment.nonce.encode(), _STAMP.pack(attachment.stamp), (attachment.public or "").encode())
    return hmac.new(secret, _parts(_COMMAND, *parts, key.encode(), payload), hashlib.sha256).hexdigest()


def is_proof(secret: bytes, proof: str | None, attachment: Attachment, key: str, payload: bytes) -> bool:
    """Whether ``proof`` is that of this command under this key."""
    return proof is not None and hmac.compare_digest(proof, command_proof(secret, attachment, key, payload))


def lease_secret(lease: str) -> bytes:
    """The key behind a lease's id, for `command_proof`."""
    return bytes.fromhex(lease)


def derived_key(secret: bytes, operator: str, nonce: str, other_nonce: str) -> str:
    """A lease's id from a secret that both sides have, the nonce of the client's query, and one of the daemon's."""
    parts = _parts(_LEASE, operator.encode(), nonce.encode(), other_nonce.encode())
    return hmac.new(secret, parts, hashlib.sha256).digest()[:ID_BYTES].hex()


def exchange() -> tuple[X25519PrivateKey, str]:
    """One side of a key exchange: its private key, and its public key as hexadecimal text."""
    private = X25519PrivateKey.generate()
    return private, private.public_key().public_bytes_raw().hex()


def exchanged_key(private: X25519PrivateKey, public: str) -> bytes:
    """The secret that both sides of an exchange have.

    Raises:
        ValueError: ``public`` is no key of the other side.
    """
    return private.exchange(X25519PublicKey.from_public_bytes(bytes.fromhex(public)))
