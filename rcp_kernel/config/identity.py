"""`[[keys]]`, `[[certificates]]`, `[anonymous]`: credentials and the roles they grant."""

from __future__ import annotations

from collections.abc import Iterable
from datetime import UTC, datetime
from typing import Annotated

import msgspec
from msgspec import Meta

from rcp_kernel.config.role import Role
from rcp_kernel.contract.identity import Grants, granted
from rcp_kernel.errors import ConfigError
from rcp_protocol.similarity import closest

__all__ = [
    "Anonymous",
    "CertificateConfig",
    "Granting",
    "KeyConfig",
    "check_grants",
    "check_identity",
    "instant",
    "needs_role",
]


class Granting(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Base of tables that grant roles: one `role` in some `tenants`, or `roles` by tenant."""

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
    """Client certificates and their principals; the first matching table applies."""

    name: str
    subject: Annotated[str, Meta(min_length=1)] | None = None
    """The common name, or the whole subject as RFC 4514 text: `CN=arm-3,O=Example`."""
    san: Annotated[str, Meta(pattern="^(DNS|URI|email):.+$")] | None = None
    """A subject alternative name; `*` is any text without `.` (DNS), `/` (URI), `@` (email)."""
    issuer: Annotated[str, Meta(min_length=1)] | None = None
    """RFC 4514 text, if there are several CAs."""


class Anonymous(Granting, frozen=True):
    """The roles of anonymous clients; `anonymous = false` refuses them."""

    role: str | tuple[str, ...] | None = "viewer"


def instant(text: str) -> int:
    """Return the ns since the UNIX epoch of a day or time of ISO 8601; UTC unless it says otherwise.

    :raises ValueError: it is neither.
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


def check_grants(
    grants: Grants, where: str, tenants: Iterable[str], roles: dict[str, Role]
) -> None:
    """Check that the tenants and roles of grants exist.

    :raises ConfigError: one does not exist.
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
    near = closest(word, words)
    if near:
        return f"; did you mean '{near}'?"
    return f"; known: {', '.join(words)}" if words else ""


def check_identity(
    keys: Iterable[KeyConfig],
    certificates: Iterable[CertificateConfig],
    source: str,
) -> list[tuple[Granting, str]]:
    """Check the tables of credentials; return those that grant roles, each with its location.

    :raises ConfigError: one of them is incomplete.
    """
    found: list[tuple[Granting, str]] = []
    for key in keys:
        where = f"{source}: key '{key.name}'"
        found.append((key, where))
        needs_role(key, where)
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
        needs_role(one, where)
        if one.subject is None and one.san is None:
            raise ConfigError(f"{where} needs a `subject` or a `san`")
    return found


def needs_role(given: Granting, where: str) -> None:
    """Check that a table grants a role.

    :raises ConfigError: it grants none.
    """
    if not given.roles and given.role is None:
        raise ConfigError(f"{where} needs a `role`, or `roles` by tenant")
