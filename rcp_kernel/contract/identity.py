"""Principals, and the keys that prove them."""

from __future__ import annotations

import hashlib
import hmac
from collections.abc import Iterable

import msgspec

from rcp_kernel.errors import TokenExpired

__all__ = [
    "NAMED_BY_OPERATOR",
    "Grants",
    "Keyring",
    "Principal",
    "check_time",
    "fingerprint",
    "granted",
    "same",
    "same_rights",
]

NAMED_BY_OPERATOR = ("key", "token", "certificate")
"""Proofs whose names the operator assigns, so that equal names mean the same person."""


Grants = tuple[tuple[str, tuple[str, ...]], ...]
"""Roles by tenant, in order; `*` is every tenant."""


def granted(tenants: Iterable[str], roles: Iterable[str]) -> Grants:
    """Grant the same roles in several tenants."""
    held = tuple(roles)
    return tuple((tenant, held) for tenant in tenants)


class Principal(msgspec.Struct, frozen=True, cache_hash=True):
    """An identity with its roles in each tenant, and how it proved itself."""

    name: str
    grants: Grants
    """The first tenant resolves its relative paths."""
    proof: str = "none"
    """`none`, `key`, `token`, `certificate`, `jwt <issuer>`, or the name of a plugin's
    authenticator."""
    credential: str | None = None
    """Hash of the credential; never shown to clients."""
    expires: int | None = None
    """When the credential expires, ns since the UNIX epoch; None: never."""
    via: str | None = None
    """The hub that asserted it, for records; the same person may come through several hubs."""
    login: str | None = None
    """The id of the login that represents the credential, and that may end before it."""

    @property
    def tenants(self) -> tuple[str, ...]:
        """The tenants it acts in."""
        return tuple([tenant for tenant, _ in self.grants])

    @property
    def roles(self) -> tuple[str, ...]:
        """Every role that it has in some tenant."""
        return tuple(dict.fromkeys(role for _, roles in self.grants for role in roles))

    @property
    def identity(self) -> tuple[str, str]:
        """The identity: a name proved in another way is a different principal."""
        return self.name, self.proof

    @property
    def anonymous(self) -> bool:
        """Whether nothing was proved."""
        return self.proof == "none"


def fingerprint(key: str) -> str:
    """Return the hash of a key; keys themselves are kept nowhere."""
    return hashlib.sha256(key.encode()).hexdigest()


class Keyring:
    """Keys and tokens by their hashes."""

    def __init__(self, principals: dict[str, Principal]) -> None:
        self._principals = principals

    def proves(self, digest: str) -> Principal | None:
        """Return the principal proved by the secret with this hash; None if there is none.

        The look-up time can reveal only something about the hash, from which no secret can be
        derived.
        """
        found = self._principals.get(digest)
        if found is None or not hmac.compare_digest(found.credential or "", digest):
            return None
        return found


def same(one: Principal, other: Principal) -> bool:
    """Return whether two principals are one person: the same name, assigned by the same authority."""
    return one.name == other.name and _voucher(one) == _voucher(other)


def same_rights(one: Principal, other: Principal) -> bool:
    """Return whether two principals are the same person with the same roles."""
    return same(one, other) and one.grants == other.grants


def _voucher(principal: Principal) -> str:
    return "house" if principal.proof in NAMED_BY_OPERATOR else principal.proof


def check_time(principal: Principal, moment: int) -> Principal:
    """Check that a principal has not expired, and return it.

    :raises TokenExpired: it has expired.
    """
    if principal.expires is not None and principal.expires <= moment:
        raise TokenExpired("the credentials have expired")
    return principal
