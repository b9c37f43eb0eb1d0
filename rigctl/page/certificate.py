"""Certificate and key of a page that is served by HTTPS."""

from __future__ import annotations

import os
import pathlib
import ssl
import stat


class CertificateError(ValueError):
    """Files that give no HTTPS; ``str()`` is one line."""


def context(cert: pathlib.Path, key: pathlib.Path) -> ssl.SSLContext:
    """TLS 1.2 or later with a certificate chain and its key, both PEM.

    Raises:
        CertificateError: a file cannot be read, others may read the key, or the key is not the certificate's.
    """
    for file in (cert, key):
        try:
            mode = file.stat().st_mode
        except OSError as error:
            raise CertificateError(f"{file}: cannot be read: {error.strerror}") from None
        if file == key and mode & 0o077:
            raise CertificateError(f"{key}: found mode {stat.S_IMODE(mode):04o}, expected 0600: others can use the key")
        if not stat.S_ISREG(mode) or not os.access(file, os.R_OK):
            raise CertificateError(f"{file}: cannot be read by this user, or is no file")
    made = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    made.minimum_version = ssl.TLSVersion.TLSv1_2
    made.set_alpn_protocols(["http/1.1"])

    def no_password() -> str:
        raise CertificateError(f"{key}: found a key with a password, expected one without")

    try:
        made.load_cert_chain(cert, key, no_password)
    except ssl.SSLError as error:
        why = "is not the key of" if error.reason == "KEY_VALUES_MISMATCH" else "gives no PEM key for"
        raise CertificateError(f"{key} {why} the certificate {cert}: {error.reason or 'no PEM'}") from None
    return made
