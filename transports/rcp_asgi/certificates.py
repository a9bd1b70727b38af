"""Certificates and revocation lists, parsed.

`cryptography` is imported on demand: it comes with the extra `tls`.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from typing import TYPE_CHECKING

from rcp_gateway.api import Certificate, Serial

if TYPE_CHECKING:
    from cryptography import x509

__all__ = ["read_certificate", "read_pem", "revoked_by"]


@lru_cache(maxsize=1024)
def read_certificate(der: bytes) -> Certificate | None:
    """Parse a certificate; None if it is malformed."""
    from cryptography import x509
    from cryptography.hazmat.primitives.hashes import SHA256
    from cryptography.x509.oid import NameOID

    try:
        found = x509.load_der_x509_certificate(der)
        names = found.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
        common = names[0].value if len(names) == 1 else None
        return Certificate(
            subject=found.subject.rfc4514_string(),
            common_name=common if isinstance(common, str) else None,
            sans=tuple(_sans(found)),
            issuer=found.issuer.rfc4514_string(),
            serial=found.serial_number,
            expires=int(found.not_valid_after_utc.timestamp()) * 1_000_000_000,
            fingerprint=found.fingerprint(SHA256()).hex(),
        )
    except ValueError:
        return None


def read_pem(pem: bytes) -> Certificate | None:
    """Read the first certificate of a file; None if there is none."""
    from cryptography import x509
    from cryptography.hazmat.primitives.serialization import Encoding

    try:
        return read_certificate(x509.load_pem_x509_certificates(pem)[0].public_bytes(Encoding.DER))
    except ValueError:
        return None


def _sans(found: x509.Certificate) -> Iterator[str]:
    from cryptography import x509

    try:
        extension = found.extensions.get_extension_for_class(x509.SubjectAlternativeName)
    except x509.ExtensionNotFound:
        return
    for name in extension.value:
        if isinstance(name, x509.DNSName):
            yield f"DNS:{name.value.lower()}"
        elif isinstance(name, x509.UniformResourceIdentifier):
            yield f"URI:{name.value}"
        elif isinstance(name, x509.RFC822Name):
            yield f"email:{name.value}"


def revoked_by(pem: bytes) -> frozenset[Serial]:
    """Read concatenated lists of revoked certificates (CRL).

    :raises ValueError: one of them is malformed.
    """
    from cryptography import x509

    begin = b"-----BEGIN X509 CRL-----"
    found: set[Serial] = set()
    for block in pem.split(begin)[1:]:
        listed = x509.load_pem_x509_crl(begin + block)
        found.update((listed.issuer.rfc4514_string(), one.serial_number) for one in listed)
    return frozenset(found)
