"""TLS on the links of a fleet, with a certificate at both ends."""

from __future__ import annotations

import stat
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

import msgspec
from msgspec import Meta

from rcp_kernel.api import others_may
from rcp_kernel.errors import ConfigError

__all__ = ["TlsConfig", "check_links"]

_ENCRYPTED = ("tls/", "quic/")
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


def check_links(endpoints: Iterable[str], tls: TlsConfig | None, where: str) -> None:
    """Check that endpoints and files fit together.

    :raises ConfigError: an endpoint lacks what it needs, or a file cannot be used.
    """
    for endpoint in endpoints:
        if endpoint.startswith(_ENCRYPTED) and tls is None:
            raise ConfigError(
                f"{where}: '{endpoint}' needs `tls` with `ca`, `certificate` and `key`"
            )
        if tls is not None and not endpoint.startswith(_ENCRYPTED):
            raise ConfigError(f"{where}: '{endpoint}' is not encrypted: write tls/… or quic/…")
    if tls is None:
        return
    for name, file in (("ca", tls.ca), ("certificate", tls.certificate), ("key", tls.key)):
        try:
            Path(file).expanduser().read_bytes()
        except OSError as error:
            raise ConfigError(f"{where}: `tls.{name}` '{file}': {error.strerror}") from None
    if others_may(Path(tls.key).expanduser(), stat.S_IROTH | stat.S_IWOTH):
        raise ConfigError(
            f"{where}: other users can read or write the key '{tls.key}': run `chmod 600 {tls.key}`"
        )
