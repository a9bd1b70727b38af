"""What the gateway asks about JSON Web Tokens, answered by the issuers of the present tables."""

from __future__ import annotations

from collections.abc import AsyncGenerator, Sequence
from contextlib import asynccontextmanager
from typing import Any

from rcp_jwt.config import JwtTables
from rcp_jwt.issuers import Issuer, Issuers
from rcp_jwt.webtokens import is_jwt
from rcp_kernel.access.authenticator import Authenticator, TokenIssuer
from rcp_kernel.contract.identity import Principal

__all__ = ["JwtAuthenticator"]


class JwtAuthenticator(Authenticator):
    """Verifies JSON Web Tokens; `proof` is `jwt <issuer>`."""

    name = "jwt"
    signed = True

    def __init__(self, tables: JwtTables) -> None:
        """Compile the tables.

        :raises ConfigError: a static key is none, or two tables are of one issuer.
        """
        super().__init__()
        self._running = False
        self._tables = tables
        self._issuers = Issuers(tables.jwt, tables.tenants)

    @asynccontextmanager
    async def running(self) -> AsyncGenerator[None]:
        """Fetch the issuers' keys while entered."""
        self._running = True
        self._issuers.start(self._changed)
        try:
            yield
        finally:
            self._running = False
            self._issuers.stop()

    def reconfigure(self, tables: JwtTables) -> None:
        """Take over other tables; what was verified is weighed by them when it comes again.

        :raises ConfigError: as the constructor does.
        """
        fresh = Issuers(tables.jwt, tables.tenants, self._issuers)
        self._issuers.stop()
        self._tables, self._issuers = tables, fresh
        if self._running:
            fresh.start(self._changed)

    def _changed(self) -> None:
        for told in self.on_change:
            told()

    def recognises(self, token: str) -> bool:
        """Tell whether a token has the form of a JWT, and there are issuers."""
        return bool(self._issuers.issuers) and is_jwt(token)

    def verify(self, token: str, digest: str, *, fetched: bool = False) -> Principal | None:
        """Return whom a token proves; None: the keys of its issuer have to be fetched."""
        if fetched:
            return self._issuers.insist(token, digest)
        found = self._issuers.find(token, digest)
        return found if isinstance(found, Principal) else None

    async def fetch(self, token: str, digest: str) -> None:
        """Have the keys of a token's issuer fetched, if they are needed."""
        found = self._issuers.find(token, digest)
        if isinstance(found, Issuer):
            await found.ask()

    def proves(self, digest: str) -> Principal | None:
        """Return whom a token proved when it was verified, if its key is still valid."""
        return self._issuers.kept(digest)

    def renewed(self, principal: Principal) -> Principal | None:
        """Return what a token is worth under the present tables and keys."""
        return self._issuers.renewed(principal)

    @property
    def serves(self) -> bool:
        """Whether a token of some issuer may do anything."""
        given = [one for table in self._tables.jwt for one in (table, *table.by_claim.values())]
        held = {role for one in given for _, roles in one.grants for role in roles}
        return not held.isdisjoint(self._tables.effective_roles)

    @property
    def issuers(self) -> Sequence[TokenIssuer]:
        """The issuers, in the order of their tables."""
        return [TokenIssuer(one.issuer, one.discovery) for one in self._tables.jwt]

    @property
    def facts(self) -> Sequence[dict[str, Any]]:
        """How each issuer is."""
        return [issuer.facts for issuer in self._issuers.issuers.values()]
