"""Who asks: principals, and the static keys that prove them."""

from __future__ import annotations

import hashlib
import hmac
from collections.abc import Iterable

import msgspec

from rcp_kernel.errors import Unauthenticated

__all__ = ["Grants", "Keyring", "Principal", "fingerprint", "granted"]


Grants = tuple[tuple[str, tuple[str, ...]], ...]
"""Roles by tenant, in order; `*` is every tenant."""


def granted(tenants: Iterable[str], roles: Iterable[str]) -> Grants:
    """Give the same roles in several tenants."""
    held = tuple(roles)
    return tuple((tenant, held) for tenant in tenants)


class Principal(msgspec.Struct, frozen=True):
    """An identity with its roles in each tenant, and how it proved itself."""

    name: str
    grants: Grants
    """The first tenant resolves its relative paths."""
    proof: str = "none"
    """`none`, `key`, or what an authenticator of a plugin says."""
    credential: str | None = None
    """Hash of what proved it; never shown to anybody."""
    expires: int | None = None
    """When the proof is not good any more, ns since the UNIX epoch; None: it stays good."""

    @property
    def tenants(self) -> tuple[str, ...]:
        """The tenants it acts in."""
        return tuple(tenant for tenant, _ in self.grants)

    @property
    def roles(self) -> tuple[str, ...]:
        """Every role that it has in some tenant."""
        return tuple(dict.fromkeys(role for _, roles in self.grants for role in roles))

    @property
    def identity(self) -> tuple[str, str]:
        """What tells it from others: a name proved in another way is somebody else's."""
        return self.name, self.proof

    @property
    def anonymous(self) -> bool:
        """Whether nothing was proved."""
        return self.proof == "none"


def fingerprint(key: str) -> str:
    """Return the hash of a key; keys themselves are kept nowhere."""
    return hashlib.sha256(key.encode()).hexdigest()


class Keyring:
    """Static API keys by their hashes."""

    def __init__(self, principals: dict[str, Principal]) -> None:
        self._principals = principals

    def renewed(self, principal: Principal) -> Principal | None:
        """Return what a principal's key proves now, or None if it proves nothing any more."""
        return self._principals.get(principal.credential or "")

    def find(self, key: str) -> Principal:
        """Return the principal of a key, in a time that does not tell which keys there are.

        :raises Unauthenticated: nobody has this key.
        """
        wanted = fingerprint(key)
        found: Principal | None = None
        for known, principal in self._principals.items():
            if hmac.compare_digest(known, wanted):
                found = principal
        if found is None:
            raise Unauthenticated("the token is not known")
        return found
