"""The listener's certificates: loaded once, and again whenever their files change.

A connection keeps its context; new ones get the latest. If files fail to load, the previous context
stays in use, because they may be only partly written.
"""

from __future__ import annotations

import ssl
import stat
from pathlib import Path
from typing import Any

import structlog

from rcp_asgi.certificates import read_pem, revoked_by
from rcp_asgi.config import TlsConfig
from rcp_gateway.api import Serial, others_may, require_certificates
from rcp_kernel.clock import iso, now
from rcp_kernel.errors import ConfigError

__all__ = ["Tls"]

log = structlog.get_logger("rcp.asgi")
_SOON = 14 * 86_400  # s before expiry from which a certificate is reported
_VERIFY = {"none": ssl.CERT_NONE, "optional": ssl.CERT_OPTIONAL, "required": ssl.CERT_REQUIRED}


class Tls:
    """The TLS context for new connections."""

    def __init__(self, config: TlsConfig) -> None:
        """Load the files.

        :raises ConfigError: a file cannot be read, certificate and key do not match, or the
            library for certificates is not installed.
        """
        require_certificates("[transports.asgi] `tls`:")
        self._config = config
        self._files = [
            Path(name).expanduser()
            for name in (config.certificate, config.key, config.client_ca, config.crl)
            if name is not None
        ]
        self._seen = self._stamps()
        self.context = _context(config)
        self.revoked = _revoked(config)
        """Revoked certificates."""
        self.facts: dict[str, Any] = {}
        """What the status tells of the certificate, kept up to date."""

    def refresh(self) -> bool:
        """Reload files that have changed; return whether any had."""
        stamps = self._stamps()
        if stamps == self._seen:
            return False
        self._seen = stamps
        try:
            context, revoked = _context(self._config), _revoked(self._config)
        except ConfigError as error:
            log.error("certificates_refused", reason=str(error))
            return False
        self.context, self.revoked = context, revoked
        log.info("certificates_renewed", certificate=self._config.certificate)
        self.warn()
        return True

    def warn(self) -> None:
        """Log certificates that have expired or soon will, and a key that everybody can read."""
        if others_may(_path(self._config.key), stat.S_IROTH):  # group access may be intended
            log.warning("key_readable", key=self._config.key)
        found = read_pem(_read("certificate", _path(self._config.certificate)))
        if found is not None:
            self.facts["expires"] = iso(found.expires)
        left = 0 if found is None else (found.expires - now()) / 1e9
        if found is not None and left < _SOON:
            log.warning(
                "certificate_expires",
                certificate=self._config.certificate,
                at=iso(found.expires),
                days=round(left / 86_400, 1),
            )

    def _stamps(self) -> list[tuple[int, int, int] | None]:
        return [_stamp(file) for file in self._files]


def _stamp(file: Path) -> tuple[int, int, int] | None:
    try:
        facts = file.stat()
    except OSError:
        return None
    return facts.st_mtime_ns, facts.st_ino, facts.st_size


def _context(config: TlsConfig) -> ssl.SSLContext:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    context.options |= ssl.OP_NO_RENEGOTIATION
    context.set_alpn_protocols(["http/1.1"])
    _own(context, config)
    if config.client_certificates == "none":
        if config.client_ca is not None or config.crl is not None:
            raise _fault(
                "client_certificates = 'none' contradicts `client_ca` or `crl`: "
                "use 'optional' or 'required'"
            )
        return context
    if config.client_ca is None:
        raise _fault(
            f"client_certificates = '{config.client_certificates}' needs `client_ca`: "
            "the file with the CA that signs them"
        )
    context.verify_mode = _VERIFY[config.client_certificates]
    _trust(context, "client_ca", config.client_ca)
    if config.crl is not None:
        _trust(context, "crl", config.crl)
        context.verify_flags |= ssl.VERIFY_CRL_CHECK_LEAF
    # A resumed session would not verify the certificate again.
    context.options |= ssl.OP_NO_TICKET
    context.num_tickets = 0
    return context


def _own(context: ssl.SSLContext, config: TlsConfig) -> None:
    certificate, key = _path(config.certificate), _path(config.key)
    for name, path in (("certificate", certificate), ("key", key)):
        _read(name, path)
    try:
        # Never None: OpenSSL would prompt for the password on the terminal.
        context.load_cert_chain(certificate, key, password=config.key_password or "")
    except (ssl.SSLError, ValueError) as error:
        raise _fault(
            f"`certificate` = '{certificate}' and `key` = '{key}' cannot be loaded: "
            f"{_why(error)}; both "
            "must be PEM and match, and `key_password` must be correct if the key is encrypted"
        ) from None


def _trust(context: ssl.SSLContext, name: str, text: str) -> None:
    path = _path(text)
    _read(name, path)
    try:
        context.load_verify_locations(path)
    except (ssl.SSLError, OSError) as error:
        raise _fault(
            f"`{name}` = '{path}' cannot be loaded: {_why(error)}; it must be PEM"
        ) from None


def _revoked(config: TlsConfig) -> frozenset[Serial]:
    if config.crl is None:
        return frozenset()
    data = _read("crl", _path(config.crl))
    try:
        return revoked_by(data)
    except ValueError as error:
        raise _fault(f"`crl` = '{config.crl}' cannot be loaded: {error}") from None


def _path(text: str) -> Path:
    return Path(text).expanduser()


def _read(name: str, path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise _fault(f"`{name}` = '{path}' cannot be read: {error.strerror}") from None


def _why(error: Exception) -> str:
    return (getattr(error, "reason", None) or str(error)).lower().replace("_", " ")


def _fault(text: str) -> ConfigError:
    return ConfigError(f"[transports.asgi.tls] {text}")
