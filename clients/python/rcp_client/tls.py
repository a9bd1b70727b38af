"""TLS settings of a client, and protection of the token."""

from __future__ import annotations

import os
import ssl
from ipaddress import ip_address
from pathlib import Path

from rcp_client.address import Address

__all__ = ["check_secrecy", "secured", "tls_reason"]


def secured(
    address: Address, cacert: str | None, cert: str | None, key: str | None
) -> ssl.SSLContext | None:
    """Return the TLS context for an https address, which verifies certificate and host name.

    Defaults come from `RCP_CACERT`, `RCP_CERT` and `RCP_KEY`; None for http.

    :raises ValueError: a file does not load.
    """
    if not address.secure:
        return None
    cacert = cacert or os.environ.get("RCP_CACERT") or None
    if cert is None and key is None:
        cert, key = os.environ.get("RCP_CERT") or None, os.environ.get("RCP_KEY") or None
    if key is not None and cert is None:
        raise ValueError("the key needs its certificate: add `cert` (--cert, RCP_CERT)")
    for path in (cacert, cert, key):
        if path is not None and not Path(path).is_file():
            raise ValueError(f"file {path} not found")
    try:
        context = ssl.create_default_context(cafile=cacert)
    except (ssl.SSLError, OSError) as error:
        raise ValueError(f"cannot load CA certificates from {cacert}: {error}") from None
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    if cert is not None:
        try:
            context.load_cert_chain(cert, key)
        except (ssl.SSLError, OSError) as error:
            raise ValueError(f"cannot load {cert} and its key: {error}") from None
    return context


def check_secrecy(address: Address, token: str | None, *, plaintext: bool) -> None:
    """Refuse to send a token unencrypted.

    :raises ValueError: it would cross a network over plain http without permission.
    """
    if token is None or address.secure or plaintext or _is_loopback(address.host):
        return
    raise ValueError(
        f"the token would cross the network to {address.url} in plain text: use https, or allow "
        "it (--plaintext, plaintext=True)"
    )


def tls_reason(error: OSError) -> str | None:
    """Return why TLS failed; None for another error."""
    if isinstance(error, ssl.SSLCertVerificationError):
        return (
            f"its certificate is not trusted: {error.verify_message} "
            "(set its CA with --cacert FILE or RCP_CACERT)"
        )
    if isinstance(error, ssl.SSLError):
        return (error.reason or str(error)).lower().replace("_", " ")
    return None


def _is_loopback(host: str) -> bool:
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"
