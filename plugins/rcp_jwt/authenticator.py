"""The authenticator for JSON Web Tokens, using the issuers of the current configuration."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Sequence
from contextlib import asynccontextmanager, suppress
from typing import Any

from rcp_jwt.config import JwtTables
from rcp_jwt.issuers import Issuer, Issuers, source_of
from rcp_jwt.kept_keys import KeptKeys
from rcp_jwt.verified import LoginProofs
from rcp_jwt.webtokens import is_jwt
from rcp_kernel.access.authenticator import Authenticator, TokenIssuer
from rcp_kernel.clock import Clock
from rcp_kernel.contract.identity import Principal
from rcp_protocol.timeouts import timeout
from rcp_store.plugin_store import PluginStore

__all__ = ["JwtAuthenticator"]

_START = 3.0  # s that the start may wait for issuers
_LOOK = 60.0  # s between looks for what has expired


class JwtAuthenticator(Authenticator):
    """Verifies JSON Web Tokens; `proof` is `jwt <issuer>`."""

    name = "jwt"
    signed = True

    def __init__(
        self,
        tables: JwtTables,
        clock: Clock,
        store: PluginStore | None = None,
        keys: PluginStore | None = None,
    ) -> None:
        """Create the issuers; `store` has what people have logged in with, `keys` the issuers' keys.

        :raises ConfigError: a static key is invalid, or two tables have the same issuer.
        """
        super().__init__()
        self._running = False
        self._clock = clock
        self._tables = tables
        self._proofs = LoginProofs(clock, store)
        self._kept = KeptKeys(clock, keys)
        self._issuers = Issuers(tables.jwt, tables.tenants, clock, None, self._proofs, self._kept)

    @asynccontextmanager
    async def running(self) -> AsyncGenerator[None]:
        """Fetch the issuers' keys while entered."""
        self._running = True
        self._kept.load({source_of(table) for table in self._tables.jwt})
        self._issuers.recall()
        self._issuers.start(self._changed)
        looking = asyncio.create_task(self._look(), name="jwt proofs")
        try:
            await self._wait_for_keys(self._proofs.load())
            yield
        finally:
            looking.cancel()
            self._running = False
            self._issuers.stop()

    async def _look(self) -> None:
        while True:
            await asyncio.sleep(_LOOK)
            self._proofs.drop_expired()

    async def _wait_for_keys(self, names: set[str]) -> None:
        """Wait for the keys of issuers with logins: one of them may have been withdrawn meanwhile."""
        found = [one for name, one in self._issuers.issuers.items() if name in names]
        with suppress(TimeoutError):
            async with timeout(_START):
                await asyncio.gather(*[issuer.ask() for issuer in found])

    def reconfigure(self, tables: JwtTables) -> None:
        """Apply new tables; verified tokens are checked against them when used again.

        :raises ConfigError: as for the constructor.
        """
        fresh = Issuers(
            tables.jwt, tables.tenants, self._clock, self._issuers, self._proofs, self._kept
        )
        self._issuers.stop()
        self._tables, self._issuers = tables, fresh
        if self._running:
            fresh.start(self._changed)

    @property
    def current(self) -> Issuers:
        """The issuers of the current configuration."""
        return self._issuers

    def _changed(self) -> None:
        for callback in self.on_change:
            callback()

    def recognises(self, token: str) -> bool:
        """Return whether a token has the form of a JWT and issuers are configured."""
        return bool(self._issuers.issuers) and is_jwt(token)

    def verify(self, token: str, digest: str, *, fetched: bool = False) -> Principal | None:
        """Return the token's principal; None if the keys of its issuer must be fetched first."""
        if fetched:
            return self._issuers.verify_after_fetch(token, digest)
        found = self._issuers.find(token, digest)
        return found if isinstance(found, Principal) else None

    async def fetch(self, token: str, digest: str) -> None:
        """Fetch the keys of a token's issuer, if required."""
        found = self._issuers.find(token, digest)
        if isinstance(found, Issuer):
            await found.ask()

    def proves(self, digest: str) -> Principal | None:
        """Return the principal of a verified token, if its key is still valid."""
        return self._issuers.kept(digest)

    def release(self, credential: str) -> None:
        """Forget what a person has logged in with."""
        self._proofs.forget(credential)

    def renewed(self, principal: Principal) -> Principal | None:
        """Return a principal with its rights under the current tables and keys."""
        return self._issuers.renewed(principal)

    @property
    def serves(self) -> bool:
        """Whether the tokens of any issuer grant anything."""
        given = [one for table in self._tables.jwt for one in (table, *table.by_claim.values())]
        held = {role for one in given for _, roles in one.grants for role in roles}
        return not held.isdisjoint(self._tables.effective_roles)

    @property
    def issuers(self) -> Sequence[TokenIssuer]:
        """The issuers, in the order of their tables."""
        return [TokenIssuer(one.issuer, one.discovery) for one in self._tables.jwt]

    @property
    def facts(self) -> Sequence[dict[str, Any]]:
        """The status of each issuer."""
        return [issuer.facts for issuer in self._issuers.issuers.values()]
