"""`/system/keys`: the keys in the store, and their revocation."""

from __future__ import annotations

from collections.abc import Generator
from typing import Any, cast

import msgspec

from rcp_kernel.clock import iso
from rcp_kernel.errors import UnknownPath
from rcp_kernel.features import FeatureHost
from rcp_kernel.model import Operation
from rcp_kernel.sessions.session import Session
from rcp_store.tokens import Token
from rcp_tokens.authenticator import PATH, TokenAuthenticator
from rcp_tokens.messages import ListedKey, Revocation

__all__ = ["KeyDirectory"]


class KeyDirectory:
    """Lists and revokes keys, for those whose role allows it in every tenant that a key is for."""

    def __init__(self, keys: TokenAuthenticator, host: FeatureHost) -> None:
        self._keys = keys
        self._host = host

    def view(self, session: Session) -> Generator[Any]:
        """List the keys that a reader may revoke, oldest first."""
        for key in self._visible(session):
            yield msgspec.to_builtins(self._listed(key))

    async def revoke(self, session: Session, wanted: Revocation, *, dry_run: bool) -> ListedKey:
        """Revoke a key for good; all its sessions and logins end.

        :raises UnknownPath: there is none that this session may revoke.
        """
        key = next((one for one in self._visible(session) if one.id == wanted.revoke), None)
        if key is None:
            raise UnknownPath(
                f"there is no key '{wanted.revoke}' that you may revoke",
                path=PATH,
                remedy=f"Read {PATH}. Keys of the configuration file are removed there.",
            )
        if not dry_run and key.revoked is None:
            self._host.note(
                "token",
                principal=session.principal,
                session=session,
                path=PATH,
                outcome="revocation",
                name=key.name,
                id=key.id,
            )
            await self._keys.revoke(key)
            key = next((one for one in self._keys.every if one.id == key.id), key)
        return self._listed(key)

    def _visible(self, session: Session) -> Generator[Token]:
        places = session.rights.places(PATH, Operation.EXECUTE)
        for key in self._keys.every:
            tenants = {tenant for tenant, _ in key.grants}
            if "*" in places or (tenants and tenants <= set(places)):
                yield key

    def _listed(self, key: Token) -> ListedKey:
        return ListedKey(
            key=key.id,
            principal=key.name,
            grants={tenant: list(roles) for tenant, roles in key.grants},
            state=cast("Any", key.state(self._host.clock.now())),
            created=iso(key.created),
            expires=None if key.expires is None else iso(key.expires),
            revoked=None if key.revoked is None else iso(key.revoked),
        )
