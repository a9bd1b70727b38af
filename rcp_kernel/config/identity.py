"""`[[keys]]`, `[[certificates]]`, `[[jwt]]`, `[anonymous]`: who may prove what, and which roles it gives."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable
from datetime import UTC, datetime
from ipaddress import ip_address
from typing import Annotated, Literal
from urllib.parse import urlsplit

import msgspec
from msgspec import Meta

from rcp_kernel.access.identity import Grants, granted
from rcp_kernel.config.role import Role
from rcp_kernel.errors import ConfigError

__all__ = [
    "Algorithm",
    "Anonymous",
    "CertificateConfig",
    "Granting",
    "JwtConfig",
    "KeyConfig",
    "check_grants",
    "check_identity",
    "instant",
    "is_private_url",
]

Algorithm = Literal["RS256", "ES256", "EdDSA"]
_FETCH = 15.0  # s that a fetch may be late, with the wait before it


class Granting(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Base of what gives roles: one `role` in some `tenants`, or `roles` tenant by tenant."""

    role: str | tuple[str, ...] | None = None
    tenants: tuple[str, ...] = ("*",)
    roles: dict[str, str | tuple[str, ...]] = {}
    """By tenant, instead of `role` and `tenants`: `{ alpha = "operator", beta = "viewer" }`."""

    @property
    def grants(self) -> Grants:
        """The roles in each tenant."""
        if self.roles:
            return tuple((tenant, _several(role)) for tenant, role in self.roles.items())
        return granted(self.tenants, _several(self.role or ()))


def _several(role: str | tuple[str, ...]) -> tuple[str, ...]:
    return (role,) if isinstance(role, str) else role


class KeyConfig(Granting, frozen=True, kw_only=True):
    """A static API key: the text itself (by `${NAME}`) or its SHA-256 in hex."""

    name: str
    key: Annotated[str, Meta(min_length=16)] | None = None
    sha256: Annotated[str, Meta(pattern="^[0-9a-f]{64}$")] | None = None
    expires: str | None = None
    """A date or ISO 8601 time, UTC by default."""


class CertificateConfig(Granting, frozen=True, kw_only=True):
    """Client certificates and whom they prove; the first table that fits counts."""

    name: str
    subject: Annotated[str, Meta(min_length=1)] | None = None
    """The common name, or the whole subject as RFC 4514 text: `CN=arm-3,O=Example`."""
    san: Annotated[str, Meta(pattern="^(DNS|URI|email):.+$")] | None = None
    """A subject alternative name; `*` is any text without `.` (DNS), `/` (URI), `@` (email)."""
    issuer: Annotated[str, Meta(min_length=1)] | None = None
    """RFC 4514 text, if there are several CAs."""


class JwtConfig(Granting, frozen=True, kw_only=True):
    """An issuer of JSON Web Tokens, where its keys are, and what its claims give; times in seconds."""

    issuer: Annotated[str, Meta(min_length=1)]
    """Exact value of `iss`."""
    audience: Annotated[str, Meta(min_length=1)] | tuple[str, ...]
    """One of them must be in `aud`."""
    algorithms: Annotated[tuple[Algorithm, ...], Meta(min_length=1)] = ("RS256", "ES256", "EdDSA")
    keys: str | tuple[str, ...] = ()
    """Public keys: PEM, JWK or JWKS, each as a text or as the path of a file."""
    jwks_url: str | None = None
    discovery: bool = False
    """Find the issuer's keys by OpenID Connect Discovery."""
    refresh: Annotated[float, Meta(ge=1)] = 300.0
    """Between fetches; a key that the issuer withdrew stays valid until the next one."""
    lifetime: Annotated[float, Meta(ge=1)] = 86_400.0
    """How long fetched keys, and tokens signed with them, stay valid without a new fetch."""
    leeway: Annotated[float, Meta(ge=0, le=600)] = 30.0
    """Tolerated difference between the clocks."""
    max_age: Annotated[float, Meta(gt=0)] | None = None
    """Maximum time since `iat`, whatever `exp` is."""
    name_claim: str = "sub"
    """Claim with the principal's name; dots reach into objects, as in the two below."""
    prefix: str = ""
    """Prefix of the name, to keep the users of two issuers apart."""
    role_claim: str | None = None
    """Claim with a string or list of strings, looked up in `by_claim`."""
    by_claim: dict[str, Granting] = {}
    """Roles for each value of `role_claim`, in addition to those of the table."""
    tenant_claim: str | None = None
    """Claim with a tenant or list of tenants: the roles apply only there."""


class Anonymous(Granting, frozen=True):
    """What those may do who prove nothing; `anonymous = false` refuses them."""

    role: str | tuple[str, ...] | None = "viewer"


def instant(text: str) -> int:
    """Return the ns since the UNIX epoch of a day or time of ISO 8601; UTC unless it says otherwise.

    :raises ValueError: it is none.
    """
    try:
        found = datetime.fromisoformat(text)
    except ValueError:
        raise ValueError(
            f"'{text[:40]}' is not a date or time: write 2027-01-31 or 2027-01-31T12:00:00Z"
        ) from None
    if found.tzinfo is None:
        found = found.replace(tzinfo=UTC)
    return int(found.timestamp()) * 1_000_000_000


def is_private_url(url: str) -> bool:
    """Tell whether what is fetched from a URL cannot be read or changed on the way.

    That is `https`, or `http` to this machine itself; without a user or password in it.
    """
    try:
        parts = urlsplit(url)
        host, _ = parts.hostname, parts.port
    except ValueError:
        return False
    if host is None or "@" in parts.netloc:
        return False
    return parts.scheme == "https" or (parts.scheme == "http" and _is_here(host))


def _is_here(host: str) -> bool:
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def check_grants(
    grants: Grants, where: str, tenants: Iterable[str], roles: dict[str, Role]
) -> None:
    """Make sure that there are the tenants and roles that are given.

    :raises ConfigError: one is not there.
    """
    there = list(tenants)
    for tenant, held in grants:
        if tenant != "*" and tenant not in there:
            advice = _near(tenant, there)
            raise ConfigError(f"{where} refers to the unknown tenant '{tenant}'{advice}")
        for role in held:
            if role not in roles:
                raise ConfigError(
                    f"{where} refers to the unknown role '{role}'{_near(role, [*roles])}"
                )


def _near(word: str, words: list[str]) -> str:
    near = difflib.get_close_matches(word, words, n=1)
    if near:
        return f"; did you mean '{near[0]}'?"
    return f"; known: {', '.join(words)}" if words else ""


def check_identity(
    keys: Iterable[KeyConfig],
    certificates: Iterable[CertificateConfig],
    issuers: Iterable[JwtConfig],
    source: str,
) -> list[tuple[Granting, str]]:
    """Check the tables of proofs; return all that give roles, each with where it stands.

    :raises ConfigError: one of them does not say what it needs to.
    """
    found: list[tuple[Granting, str]] = []
    for key in keys:
        where = f"{source}: key '{key.name}'"
        found.append((key, where))
        _needs_role(key, where)
        if (key.key is None) == (key.sha256 is None):
            raise ConfigError(f"{where} needs either `key` or `sha256`")
        if key.expires is not None:
            try:
                instant(key.expires)
            except ValueError as error:
                raise ConfigError(f"{where}: expires = {error}") from None
    for one in certificates:
        where = f"{source}: [[certificates]] '{one.name}'"
        found.append((one, where))
        _needs_role(one, where)
        if one.subject is None and one.san is None:
            raise ConfigError(f"{where} needs a `subject` or a `san`")
    for issuer in issuers:
        where = f"{source}: [[jwt]] '{issuer.issuer}'"
        found.append((issuer, where))
        found += [(one, f"{where} by_claim '{value}'") for value, one in issuer.by_claim.items()]
        _check_issuer(issuer, where)
    return found


def _needs_role(given: Granting, where: str) -> None:
    if not given.roles and given.role is None:
        raise ConfigError(f"{where} needs a `role`, or `roles` by tenant")


def _check_issuer(issuer: JwtConfig, where: str) -> None:
    for value, one in issuer.by_claim.items():
        _needs_role(one, f"{where} by_claim '{value}'")
    if (issuer.role_claim is None) != (not issuer.by_claim):
        raise ConfigError(f"{where}: `role_claim` and `by_claim` must be used together")
    if not issuer.by_claim:
        _needs_role(issuer, where)
    if not issuer.audience:
        raise ConfigError(f"{where}: `audience` is empty: set the issuer's name for this gateway")
    sources = [bool(issuer.keys), issuer.jwks_url is not None, issuer.discovery]
    if sources.count(True) != 1:
        raise ConfigError(f"{where} needs one of `keys`, `jwks_url` and `discovery = true`")
    url = issuer.jwks_url if issuer.jwks_url is not None else issuer.issuer
    if not issuer.keys and not is_private_url(url):
        key = "issuer" if issuer.discovery else "jwks_url"
        raise ConfigError(
            f"{where}: `{key}` must be an https URL (or http on loopback) without a user name"
        )
    if not issuer.keys and issuer.lifetime < issuer.refresh + _FETCH:
        raise ConfigError(
            f"{where}: `lifetime` = {issuer.lifetime:g} must exceed `refresh` = "
            f"{issuer.refresh:g} by {_FETCH:g} s, or keys expire between two fetches"
        )
    for claim in (issuer.name_claim, issuer.role_claim, issuer.tenant_claim):
        if claim is not None and not re.fullmatch(r"[^.]+(\.[^.]+)*", claim):
            raise ConfigError(
                f"{where}: {claim!r} is not a claim: write `sub`, or `a.b` for `b` in `a`"
            )
