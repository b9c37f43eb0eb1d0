"""Certificates (X.509, P-256) of the rig's own authority. Pure functions: time and serial numbers are passed in.

P-256 rather than Ed25519, because browsers accept no Ed25519 certificate and the page shall use the same authority.
"""

from __future__ import annotations

import datetime
import ipaddress
from collections.abc import Sequence
from dataclasses import dataclass

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from rigctl.identity.roles import Role, common_name

BACKDATED = datetime.timedelta(minutes=5)  # clocks of the rig's computers differ
_AUTHORITY = "rigctl authority"


@dataclass(frozen=True)
class IssuedKey:
    """A private key and its certificate, in PEM."""

    key: str
    certificate: str


def _pem(key: ec.EllipticCurvePrivateKey, certificate: x509.Certificate) -> IssuedKey:
    private = key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )
    return IssuedKey(private.decode(), certificate.public_bytes(serialization.Encoding.PEM).decode())


def _usage(*, authority: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not authority, key_cert_sign=authority, crl_sign=authority, content_commitment=False,
        key_encipherment=False, data_encipherment=False, key_agreement=False, encipher_only=False, decipher_only=False,
    )  # fmt: skip


def authority(not_before: datetime.datetime, not_after: datetime.datetime) -> IssuedKey:
    """A new authority, which signs itself and issues no other authorities."""
    key = ec.generate_private_key(ec.SECP256R1())
    serial = x509.random_serial_number()
    name = x509.Name([
        x509.NameAttribute(NameOID.COMMON_NAME, f"{_AUTHORITY} {serial % 2**32:08x}"),
    ])  # fmt: skip
    builder = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(key.public_key())
        .serial_number(serial)
        .not_valid_before(not_before)
        .not_valid_after(not_after)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(_usage(authority=True), critical=True)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
    )
    return _pem(key, builder.sign(key, hashes.SHA256()))


def _host(text: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(text))
    except ValueError:
        return x509.DNSName(text)


def issue(
    issuer: IssuedKey,
    name: str,
    role: Role,
    serial: str,
    not_before: datetime.datetime,
    not_after: datetime.datetime,
    hosts: Sequence[str] = (),
) -> IssuedKey:
    """A new key with a certificate signed by ``issuer``.

    ``serial``: hexadecimal. ``hosts``: names and addresses at which a gateway or page is reached; only their
    certificates are good for a server, so that no person can stand in for the daemon. A page's is good for nothing
    else: it opens no connection to the gateway.

    Raises:
        ValueError: ``issuer`` is not a key with its certificate.
    """
    ca_key = serialization.load_pem_private_key(issuer.key.encode(), None)
    ca = x509.load_pem_x509_certificate(issuer.certificate.encode())
    if not isinstance(ca_key, ec.EllipticCurvePrivateKey) or ca_key.public_key() != ca.public_key():
        raise ValueError("key and certificate of the authority do not belong together")
    key = ec.generate_private_key(ec.SECP256R1())
    usages = [ExtendedKeyUsageOID.CLIENT_AUTH] if role is not Role.PAGE else []
    usages += [ExtendedKeyUsageOID.SERVER_AUTH] if role.is_server else []
    subject = x509.Name([
        x509.NameAttribute(NameOID.ORGANIZATIONAL_UNIT_NAME, role.value),
        x509.NameAttribute(NameOID.COMMON_NAME, common_name(name, serial)),
    ])  # fmt: skip
    builder = (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(ca.subject)
        .public_key(key.public_key())
        .serial_number(int(serial, 16))
        .not_valid_before(not_before)
        .not_valid_after(min(not_after, ca.not_valid_after_utc))
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(_usage(authority=False), critical=True)
        .add_extension(x509.ExtendedKeyUsage(usages), critical=True)
        .add_extension(x509.AuthorityKeyIdentifier.from_issuer_public_key(ca_key.public_key()), critical=False)
    )
    if role.is_server:
        names = x509.SubjectAlternativeName([_host(host) for host in hosts])
        builder = builder.add_extension(names, critical=False)
    return _pem(key, builder.sign(ca_key, hashes.SHA256()))


def last_day(certificate: str) -> datetime.datetime:
    """End of a certificate's validity, UTC."""
    return x509.load_pem_x509_certificate(certificate.encode()).not_valid_after_utc


def hosts_of(certificate: str) -> list[str]:
    """Names and addresses for which the certificate of a gateway or page is good."""
    found = x509.load_pem_x509_certificate(certificate.encode()).extensions
    names = found.get_extension_for_class(x509.SubjectAlternativeName).value
    addresses = [str(address) for address in names.get_values_for_type(x509.IPAddress)]
    return [*names.get_values_for_type(x509.DNSName), *addresses]
