"""Client certificates, and the principals that they prove.

The transport verifies and parses a certificate; this module looks it up. `cryptography` is imported
on demand: it comes with the extra `tls`.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from importlib.util import find_spec
from typing import TYPE_CHECKING

from rcp_kernel.clock import Clock
from rcp_kernel.contract.identity import Principal
from rcp_kernel.contract.peer import Certificate, Serial
from rcp_kernel.errors import ConfigError, TokenExpired, Unauthenticated

if TYPE_CHECKING:
    from rcp_kernel.config.file import CertificateConfig

__all__ = ["Certificates", "require_certificates"]

_STOPS = {"DNS": ".", "URI": "/", "email": "@"}
"""Separators that a `*` in a pattern does not match."""
_KNOWN = 4096  # certificates stored to re-evaluate them under a new configuration


def require_certificates(where: str) -> None:
    """Make sure that certificates can be read.

    :raises ConfigError: the library for them is not installed.
    """
    if find_spec("cryptography") is None:
        raise ConfigError(
            f"{where} certificates cannot be read (No module named 'cryptography'); try: "
            "pip install 'rcp-gateway[tls]'"
        )


class Certificates:
    """The certificates of a configuration."""

    def __init__(
        self,
        configs: Iterable[CertificateConfig],
        clock: Clock,
        before: Certificates | None = None,
    ) -> None:
        """Compile the tables; the state of `before` is taken over.

        :raises ConfigError: a table contains something that no certificate can match, or
            certificates cannot be read.
        """
        self._clock = clock
        self._rules = [_Rule(config) for config in configs]
        self.known: dict[str, Certificate] = {} if before is None else before.known
        self.revoked: frozenset[Serial] = frozenset() if before is None else before.revoked
        """The revoked certificates."""

    def find(self, certificate: Certificate) -> Principal | None:
        """Return the principal of a certificate; None if no table names it.

        :raises TokenExpired: it has expired, although its connection is still open.
        :raises Unauthenticated: it was revoked.
        """
        if certificate.expires <= self._clock.now():
            raise TokenExpired(
                "the client certificate has expired", remedy="Connect with a new certificate."
            )
        if (certificate.issuer, certificate.serial) in self.revoked:
            raise Unauthenticated(
                "the client certificate was revoked", remedy="Connect with a new certificate."
            )
        principal = self._look_up(certificate)
        if principal is not None and certificate.fingerprint not in self.known:
            if len(self.known) >= _KNOWN:
                del self.known[next(iter(self.known))]
            self.known[certificate.fingerprint] = certificate
        return principal

    def renewed(self, principal: Principal) -> Principal | None:
        """Return the principal that the certificate proves now; None if it proves none."""
        certificate = self.known.get(principal.credential or "")
        if certificate is None or (certificate.issuer, certificate.serial) in self.revoked:
            return None
        return self._look_up(certificate)

    def _look_up(self, certificate: Certificate) -> Principal | None:
        return next(
            (rule.made(certificate) for rule in self._rules if rule.fits(certificate)), None
        )


class _Rule:
    """One `[[certificates]]` table, compiled."""

    def __init__(self, config: CertificateConfig) -> None:
        require_certificates(f"[[certificates]] '{config.name}':")
        subject = config.subject
        self._whole = subject is not None and "=" in subject
        self._subject = _canonical(config, subject) if self._whole else subject
        self._issuer = _canonical(config, config.issuer)
        self._san = None if config.san is None else _pattern(config.san)
        self._config = config

    def fits(self, certificate: Certificate) -> bool:
        subject = certificate.subject if self._whole else certificate.common_name
        return (
            (self._subject is None or self._subject == subject)
            and (self._issuer is None or self._issuer == certificate.issuer)
            and (self._san is None or any(map(self._san.fullmatch, certificate.sans)))
        )

    def made(self, certificate: Certificate) -> Principal:
        given = self._config
        proved = certificate.fingerprint
        return Principal(given.name, given.grants, "certificate", proved, certificate.expires)


def _canonical(config: CertificateConfig, text: str | None) -> str | None:
    if text is None:
        return None
    from cryptography import x509

    try:
        return x509.Name.from_rfc4514_string(text).rfc4514_string()
    except ValueError:
        raise ConfigError(
            f"[[certificates]] '{config.name}': {text!r} is not an RFC 4514 name: "
            "write it as `openssl x509 -noout -subject -nameopt RFC2253` does"
        ) from None


def _pattern(text: str) -> re.Pattern[str]:
    kind, _, rest = text.partition(":")
    if kind == "DNS":
        rest = rest.lower()
    star = f"[^{re.escape(_STOPS[kind])}]+"
    return re.compile(re.escape(kind + ":") + star.join(map(re.escape, rest.split("*"))))
