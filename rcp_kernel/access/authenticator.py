"""The interface of features that authenticate clients by their own kind of token."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any

import msgspec

from rcp_kernel.contract.identity import Principal

__all__ = ["Authenticator", "TokenIssuer"]


class TokenIssuer(msgspec.Struct, frozen=True):
    """An issuer of the tokens that an authenticator verifies, for descriptions of the gateway."""

    url: str
    discovery: bool
    """Whether it describes itself by OpenID Connect Discovery."""


class Authenticator(ABC):
    """Verifies tokens other than the keys of the configuration. For the event loop's thread.

    The gateway checks those keys first. Any other token goes to the first authenticator, by name,
    that recognises it. The gateway limits how often an address may try invalid tokens, checks
    `expires`, and compares the principal with the client certificate of the connection.
    """

    name: str
    """The feature's name. The `proof` of every principal is this word, or this word, a space and
    more; two principals with different proofs are two persons. Only `logins` proves principals of
    other proofs, each with its `login`."""
    signed: bool = False
    """Whether its tokens cannot be guessed: an address that has sent too many invalid ones may then
    still try others, at a slow pace."""

    local: bool = False
    """Whether the operator of this gateway assigns the names it proves, as for keys: only then may
    it be called `token`, whose principals are the same persons as those of keys."""

    def __init__(self) -> None:
        self.on_change: list[Callable[[], None]] = []
        """To be called after the rights or validity of a principal may have changed: the gateway then
        calls `renewed` for every session, and ends those whose principal is no longer valid."""

    @abstractmethod
    def recognises(self, token: str) -> bool:
        """Return whether a token is of this kind, by its form alone; must be very fast."""

    @abstractmethod
    def verify(self, token: str, digest: str, *, fetched: bool = False) -> Principal | None:
        """Return the principal of a token; `digest` is its SHA-256, the principal's `credential`.

        Must not block. None means that something must be fetched first: the gateway then awaits
        `fetch` and calls this again with `fetched`.

        :raises Unauthenticated: the token is not valid.
        :raises TokenExpired: it has expired.
        :raises Forbidden: it is valid, but grants no role here.
        :raises AdapterUnavailable: the fetch failed.
        """

    async def fetch(self, token: str, digest: str) -> None:  # noqa: B027 - most have nothing to fetch
        """Fetch what `verify` lacked for a token, within a bound."""

    def proves(self, digest: str) -> Principal | None:
        """Return the principal of a verified token that is still valid, by its hash."""
        return None

    def renewed(self, principal: Principal) -> Principal | None:
        """Return a principal with its current rights; None if its token is no longer valid."""
        return principal

    @property
    def serves(self) -> bool:
        """Whether it can authenticate any principal with rights."""
        return True

    @property
    def issuers(self) -> Sequence[TokenIssuer]:
        """The issuers of its tokens, if known."""
        return ()

    @property
    def facts(self) -> Sequence[dict[str, Any]]:
        """Its parts for `/system/status`, each with `name` and `state`."""
        return ()
