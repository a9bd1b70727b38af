"""What was verified: tokens of programs, and the ID tokens that people have logged in with."""

from __future__ import annotations

from typing import Any

import msgspec
import structlog

from rcp_jwt.webtokens import Claims, Read
from rcp_kernel.clock import Clock
from rcp_kernel.contract.identity import Principal
from rcp_store.plugin_store import PluginStore

__all__ = ["LoginProofs", "Verified", "VerifiedTokens"]

log = structlog.get_logger("rcp.jwt")
_KNOWN = 20_000
_S = 1_000_000_000  # ns


class Verified(msgspec.Struct, frozen=True):
    """A verified token."""

    claims: Claims
    key: str
    """Thumbprint of the key that signed it."""
    read: Read
    client: str | None = None
    """The client id to which it was given for a login."""
    principal: Principal | None = None
    """Not stored: it follows from the claims and the tables."""
    tables: object = None
    """The tables under which the principal was determined."""

    def expired(self, moment: int) -> bool:
        """Return whether it has expired."""
        return int(self.claims["exp"]) * _S < moment


class VerifiedTokens:
    """Verified tokens by their hash; beyond a number, the oldest are verified again."""

    def __init__(self, clock: Clock) -> None:
        self._now = clock.now
        self._found: dict[str, Verified] = {}

    def get(self, digest: str) -> Verified | None:
        """Return one of them."""
        return self._found.get(digest)

    def keep(self, digest: str, found: Verified) -> None:
        """Keep one of them."""
        if len(self._found) >= _KNOWN:
            moment = self._now()
            for one in [one for one, each in self._found.items() if each.expired(moment)]:
                self.forget(one)
            if len(self._found) >= _KNOWN:
                self.forget(next(iter(self._found)))
        self._found[digest] = found

    def forget(self, digest: str) -> None:
        """Forget one of them."""
        self._found.pop(digest, None)


class LoginProofs(VerifiedTokens):
    """What people have logged in with, by the `credential` of the login.

    Kept apart, so that no flood of other tokens ends a login. With a store, they outlive a restart.
    """

    def __init__(self, clock: Clock, store: PluginStore | None) -> None:
        super().__init__(clock)
        self._store = store

    def load(self) -> set[str]:
        """Take over those of earlier runs; return their issuers."""
        moment = self._now()
        for digest, row in ({} if self._store is None else self._store.load()).items():
            try:
                found = msgspec.convert(row, Verified)
            except msgspec.ValidationError as error:
                log.warning("login_unreadable", error=str(error))
                self._put(digest, None)
                continue
            if found.expired(moment):
                self._put(digest, None)
            else:
                self._found[digest] = found
        return {found.read.issuer for found in self._found.values()}

    def keep(self, digest: str, found: Verified) -> None:
        """Keep one of them, and store it if it is new."""
        if digest not in self._found:
            facts = msgspec.structs.replace(found, principal=None, tables=None)
            self._put(digest, msgspec.to_builtins(facts))
        super().keep(digest, found)

    def forget(self, digest: str) -> None:
        """Forget one of them for good."""
        if self._found.pop(digest, None) is not None:
            self._put(digest, None)

    def _put(self, digest: str, row: Any) -> None:
        if self._store is not None:
            self._store.put(digest, row)
