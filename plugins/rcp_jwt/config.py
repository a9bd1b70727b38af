"""`[[jwt]]`: issuers of JSON Web Tokens, their keys, and the roles granted by claims."""

from __future__ import annotations

import re
from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from rcp_jwt.login_config import LoginConfig, check_logins
from rcp_jwt.urls import is_private_url
from rcp_kernel.config.file import GatewayConfig
from rcp_kernel.config.identity import Granting, check_grants, needs_role
from rcp_kernel.config.role import BUILTIN_ROLES
from rcp_kernel.errors import ConfigError

__all__ = ["Algorithm", "JwtConfig", "JwtTables", "check_tables"]

Algorithm = Literal["RS256", "ES256", "EdDSA"]
_FETCH = 15.0  # s that a fetch may be late, including the delay before it


class JwtConfig(Granting, frozen=True, kw_only=True):
    """An issuer of JSON Web Tokens: its keys, and the roles of its claims; times in s."""

    issuer: Annotated[str, Meta(min_length=1)]
    """Exact value of `iss`."""
    audience: Annotated[str, Meta(min_length=1)] | tuple[str, ...]
    """`aud` must contain one of them."""
    algorithms: Annotated[tuple[Algorithm, ...], Meta(min_length=1)] = ("RS256", "ES256", "EdDSA")
    keys: str | tuple[str, ...] = ()
    """Public keys: PEM, JWK or JWKS, each as text or as a file path."""
    jwks_url: str | None = None
    discovery: bool = False
    """Find the issuer's keys by OpenID Connect Discovery."""
    refresh: Annotated[float, Meta(ge=1)] = 300.0
    """Time between fetches; a key withdrawn by the issuer stays valid until the next one."""
    lifetime: Annotated[float, Meta(ge=1)] = 86_400.0
    """How long fetched keys, and tokens signed with them, stay valid without a new fetch."""
    leeway: Annotated[float, Meta(ge=0, le=600)] = 30.0
    """Tolerated clock difference."""
    max_age: Annotated[float, Meta(gt=0)] | None = None
    """Maximum time since `iat`, whatever `exp` is."""
    name_claim: str = "sub"
    """Claim with the principal's name; dots select nested fields, here and in the two below."""
    prefix: str = ""
    """Prefix of the name, to keep the users of two issuers apart."""
    role_claim: str | None = None
    """Claim with a string or list of strings, looked up in `by_claim`."""
    by_claim: dict[str, Granting] = msgspec.field(default_factory=dict[str, Granting])
    """Roles for each value of `role_claim`, in addition to those of the table."""
    tenant_claim: str | None = None
    """Claim with a tenant or list of tenants to which the roles are restricted."""
    login: LoginConfig | None = None
    """The login of people in their browsers."""


class JwtTables(msgspec.Struct, frozen=True, kw_only=True):
    """All `[[jwt]]` tables, and what they refer to."""

    jwt: tuple[JwtConfig, ...] = ()
    tenants: tuple[str, ...] = ()
    """All tenants of the gateway."""
    effective_roles: frozenset[str] = frozenset()
    """The roles that grant anything."""


def check_tables(tables: JwtTables, gateway: GatewayConfig) -> None:
    """Check what the types of the tables cannot.

    :raises ConfigError: a table is incomplete, or refers to something unknown.
    """
    roles = {**BUILTIN_ROLES, **gateway.roles}
    for table in tables.jwt:
        where = f"[[jwt]] '{table.issuer}'"
        _check_issuer(table, where)
        check_grants(table.grants, where, gateway.tenant_names, roles)
        for value, one in table.by_claim.items():
            check_grants(one.grants, f"{where} by_claim '{value}'", gateway.tenant_names, roles)
        if table.login is not None and not table.discovery:
            raise ConfigError(f"{where}: `login` needs `discovery = true`, to find its endpoints")
    logins = [(f"[[jwt]] '{one.issuer}' login", one.login) for one in tables.jwt if one.login]
    check_logins(logins, gateway)


def _check_issuer(issuer: JwtConfig, where: str) -> None:
    for value, one in issuer.by_claim.items():
        needs_role(one, f"{where} by_claim '{value}'")
    if (issuer.role_claim is None) != (not issuer.by_claim):
        raise ConfigError(f"{where}: `role_claim` and `by_claim` must be used together")
    if not issuer.by_claim:
        needs_role(issuer, where)
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
