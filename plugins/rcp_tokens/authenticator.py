"""The authenticator: from the hash of a key to the principal that the store names."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager, closing
from pathlib import Path

import msgspec
import structlog

from rcp_kernel.access.authenticator import Authenticator
from rcp_kernel.contract.identity import Grants, Keyring, Principal
from rcp_kernel.features import FeatureHost
from rcp_store.tokens import Token, TokenFile
from rcp_tokens.watch import TokenWatch, changes

__all__ = ["PATH", "TokenAuthenticator", "TokenTables"]

log = structlog.get_logger("rcp.identity")
PATH = "/system/keys"


class TokenTables(msgspec.Struct, frozen=True):
    """The tenants and roles of the gateway, without which a key grants nothing."""

    tenants: tuple[str, ...]
    roles: tuple[str, ...]


class TokenAuthenticator(Authenticator):
    """Knows the keys in the store by their hashes, and follows their changes."""

    name = "token"
    local = True

    def __init__(self, tables: TokenTables, host: FeatureHost) -> None:
        super().__init__()
        self._tables = tables
        self._host = host
        self._tokens: list[Token] = []
        self._keyring = Keyring({})

    @asynccontextmanager
    async def running(self) -> AsyncGenerator[None]:
        """Watch the keys while entered.

        :raises ConfigError: the store cannot be opened.
        """
        path = self._host.ledger.path
        if path is None:
            yield
            return
        loop = self._host.loop

        def on_change(tokens: list[Token]) -> None:
            loop.call_soon_threadsafe(self._take, tokens)

        watch = TokenWatch(path, on_change)
        self._tokens = watch.tokens
        self.reconfigure(self._tables)
        watch.start()
        try:
            yield
        finally:
            watch.close()

    def _take(self, tokens: list[Token]) -> None:
        news, self._tokens = changes(self._tokens, tokens), tokens
        self.reconfigure(self._tables)
        for outcome, token in news:
            log.info("token", name=token.name, id=token.id, outcome=outcome)
            self._host.note("token", principal=None, outcome=outcome, name=token.name, id=token.id)
        for changed in self.on_change:
            changed()

    def reconfigure(self, tables: TokenTables) -> None:
        """Apply the tenants and roles of another configuration; the caller reviews the sessions."""
        self._tables = tables
        valid = (token for token in self._tokens if token.revoked is None)
        self._keyring = Keyring({one.hash: self._principal(one) for one in valid})
        self._host.changed(PATH)

    @property
    def every(self) -> list[Token]:
        """All keys, also those that are not valid any more, oldest first."""
        return self._tokens

    async def revoke(self, token: Token) -> None:
        """Revoke a key in the store, and end its sessions.

        :raises ConfigError: the store cannot be opened.
        """
        path = self._host.ledger.path
        assert path is not None  # it has the key
        self._take(await asyncio.to_thread(_revoked, path, token.id))

    def _principal(self, token: Token) -> Principal:
        return Principal(token.name, self._granted(token), self.name, token.hash, token.expires)

    def _granted(self, token: Token) -> Grants:
        """Return the grants of a key whose tenants and roles are still configured."""
        tenants = ("*", *self._tables.tenants)
        held = tuple(
            (tenant, tuple(role for role in roles if role in self._tables.roles))
            for tenant, roles in token.grants
            if tenant in tenants
        )
        if held != token.grants:
            log.warning("token_grants_missing", name=token.name, id=token.id)
        return held

    def recognises(self, token: str) -> bool:
        """Tell that no key is known by its form: `proves` has found those that are there."""
        return False

    def verify(self, token: str, digest: str, *, fetched: bool = False) -> Principal | None:
        """Return the principal of a key."""
        return self.proves(digest)

    def proves(self, digest: str) -> Principal | None:
        """Return the principal of a key that was not revoked, by its hash."""
        return self._keyring.proves(digest)

    def renewed(self, principal: Principal) -> Principal | None:
        """Return the principal with its current rights; None if its key was revoked."""
        return self._keyring.proves(principal.credential or "")

    @property
    def serves(self) -> bool:
        """Whether any key is valid."""
        now = self._host.clock.now()
        return any(token.state(now) == "good" for token in self._tokens)


def _revoked(path: Path, id_: str) -> list[Token]:
    """Revoke a key, and return all as they are then. Blocks."""
    with closing(TokenFile(path, there=True)) as table:
        table.revoke(id_)
        return table.every()
