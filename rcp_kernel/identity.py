"""Who asks: principals, and the static keys that prove them."""

from __future__ import annotations

import hashlib
import hmac

import msgspec

from rcp_kernel.errors import Unauthenticated

__all__ = ["Keyring", "Principal", "fingerprint"]


class Principal(msgspec.Struct, frozen=True):
    """An identity with its tenants and roles, and how it proved itself."""

    name: str
    tenants: tuple[str, ...]
    """The tenants it acts in; the first one resolves its relative paths. `*` is every tenant."""
    roles: tuple[str, ...]
    proof: str = "none"
    """`none`, `key`, or what an authenticator of a plugin says."""
    credential: str | None = None
    """Hash of the key that proved it; never shown to anybody."""

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
