"""TLS on the links of a fleet, with a certificate at both ends."""

from __future__ import annotations

import re
import stat
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import msgspec
from msgspec import Meta

from rcp_gateway.api import others_may
from rcp_kernel.errors import ConfigError

if TYPE_CHECKING:
    from cryptography import x509

__all__ = ["TlsConfig", "check_links", "check_name"]

_ENCRYPTED = ("tls/", "quic/")
_BY_HOST = ("tcp", "tls", "quic", "udp", "ws")
_OTHERS = ("serial", "unixpipe", "unixsock-stream", "vsock")
_LAST_PORT = 65_535
_File = Annotated[str, Meta(min_length=1)]


class TlsConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The files, all PEM; the other end must have a certificate of the same CA."""

    ca: _File
    """Certificates of the fleet's CA."""
    certificate: _File
    """Its own, with the name of the gateway or hub as common name."""
    key: _File

    @property
    def settings(self) -> dict[str, object]:
        """The settings of Zenoh."""
        files = {
            name: str(Path(file).expanduser().absolute())
            for name, file in (
                ("root_ca_certificate", self.ca),
                ("listen_certificate", self.certificate),
                ("listen_private_key", self.key),
                ("connect_certificate", self.certificate),
                ("connect_private_key", self.key),
            )
        }
        return {**files, "enable_mtls": True, "close_link_on_expiration": True}


def check_links(endpoints: Iterable[str], tls: TlsConfig | None) -> None:
    """Check that endpoints and files fit together.

    :raises ConfigError: an endpoint is none or lacks what it needs, or a file cannot be used.
    """
    for endpoint in endpoints:
        _check_endpoint(endpoint)
        if endpoint.startswith(_ENCRYPTED) and tls is None:
            raise ConfigError(f"'{endpoint}' needs `tls` with `ca`, `certificate` and `key`")
        if tls is not None and not endpoint.startswith(_ENCRYPTED):
            raise ConfigError(f"'{endpoint}' is not encrypted: write tls/… or quic/…")
    if tls is not None:
        _check_files(tls)


def check_name(name: str, tls: TlsConfig | None) -> None:
    """Check that a certificate is that of a gateway: routers drop what others say in its name.

    :raises ConfigError: its common name is another one.
    """
    if tls is None:
        return
    from cryptography.x509.oid import NameOID

    names = _certificates("certificate", tls.certificate)[0].subject.get_attributes_for_oid(
        NameOID.COMMON_NAME
    )
    found = [str(one.value) for one in names]
    if found != [name]:
        shown = ", ".join(found) or "none"
        raise ConfigError(
            f"`tls.certificate` '{tls.certificate}' is not that of the gateway '{name}': its common "
            f"name is {shown}"
        )


def _check_endpoint(endpoint: str) -> None:
    protocol, _, address = endpoint.partition("/")
    known = (*_BY_HOST, *_OTHERS)
    if protocol not in known or not address:
        raise ConfigError(
            f"'{endpoint}' is not an endpoint: write tls/HOST:PORT; protocols: {', '.join(known)}"
        )
    host, _, port = re.split(r"[?#]", address)[0].rpartition(":")
    if protocol in _BY_HOST and not (host and port.isdecimal() and int(port) <= _LAST_PORT):
        raise ConfigError(
            f"'{endpoint}' is not an endpoint: write {protocol}/HOST:PORT with a port up to "
            f"{_LAST_PORT}"
        )


def _check_files(tls: TlsConfig) -> None:
    from cryptography.exceptions import UnsupportedAlgorithm
    from cryptography.hazmat.primitives.serialization import load_pem_private_key

    _certificates("ca", tls.ca)
    own = _certificates("certificate", tls.certificate)[0]
    data = _content("key", tls.key)
    if others_may(Path(tls.key).expanduser(), stat.S_IROTH | stat.S_IWOTH):
        raise ConfigError(
            f"other users can read or write the key '{tls.key}': run `chmod 600 {tls.key}`"
        )
    try:
        key = load_pem_private_key(data, None)
    except (ValueError, TypeError, UnsupportedAlgorithm):
        raise ConfigError(
            f"`tls.key` '{tls.key}' is not a private key in PEM, unencrypted"
        ) from None
    if key.public_key() != own.public_key():
        raise ConfigError(
            f"`tls.key` '{tls.key}' is not the key of the certificate '{tls.certificate}'"
        )


def _certificates(name: str, file: str) -> list[x509.Certificate]:
    """Read certificates in PEM, at least one."""
    from cryptography import x509

    try:
        return x509.load_pem_x509_certificates(_content(name, file))
    except ValueError:
        raise ConfigError(f"`tls.{name}` '{file}' has no certificate in PEM") from None


def _content(name: str, file: str) -> bytes:
    try:
        return Path(file).expanduser().read_bytes()
    except OSError as error:
        raise ConfigError(f"`tls.{name}` '{file}': {error.strerror}") from None
