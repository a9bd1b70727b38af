"""What was verified: tokens of programs, and the ID tokens that people have logged in with."""

from __future__ import annotations

from typing import Any

import msgspec
import structlog

from rcp_jwt.webtokens import Claims, Read
from rcp_kernel.clock import Clock
from rcp_kernel.contract.identity import Principal
from rcp_kernel.errors import QueueFull
from rcp_store.plugin_store import PluginStore

__all__ = ["LoginProofs", "Verified", "VerifiedTokens"]

log = structlog.get_logger("rcp.jwt")
_KNOWN = 20_000
_PER_PERSON, _LOGINS = 1_000, 100_000  # the most that the feature `logins` can be told to keep
_FULL = 60.0  # s
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
            self.drop_expired()
            if len(self._found) >= _KNOWN:
                self.forget(next(iter(self._found)))
        self._found[digest] = found

    def drop_expired(self) -> None:
        """Forget those that have expired."""
        moment = self._now()
        for one in [one for one, each in self._found.items() if each.expired(moment)]:
            self.forget(one)

    def forget(self, digest: str) -> None:
        """Forget one of them."""
        self._found.pop(digest, None)


class LoginProofs(VerifiedTokens):
    """What people have logged in with, by the `credential` of the login.

    Kept apart, so that no flood of other tokens ends a login; nor do the logins of one person end those of
    others. With a store, they outlive a restart.
    """

    def __init__(self, clock: Clock, store: PluginStore | None) -> None:
        super().__init__(clock)
        self._store = store
        self._of: dict[tuple[str, str], dict[str, None]] = {}
        """Those of each person, oldest first."""

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
        """Keep one of them, and store it if it is new; in place of the person's oldest if they have many.

        :raises QueueFull: there are too many of all.
        """
        known = self._found.get(digest)
        if known is None:
            self._make_room(found)
            facts = msgspec.structs.replace(found, principal=None, tables=None)
            self._put(digest, msgspec.to_builtins(facts))
        else:
            self._disown(digest, known)
        self._found[digest] = found
        if found.principal is not None:
            self._of.setdefault(found.principal.identity, {})[digest] = None

    def _make_room(self, found: Verified) -> None:
        own = {} if found.principal is None else self._of.get(found.principal.identity, {})
        if len(own) >= _PER_PERSON:
            self.forget(next(iter(own)))
        elif len(self._found) >= _LOGINS:
            raise QueueFull(
                f"there are already {len(self._found)} logins",
                remedy="Try again later.",
                retry_after=_FULL,
            )

    def forget(self, digest: str) -> None:
        """Forget one of them for good."""
        found = self._found.pop(digest, None)
        if found is not None:
            self._disown(digest, found)
            self._put(digest, None)

    def _disown(self, digest: str, found: Verified) -> None:
        person = None if found.principal is None else found.principal.identity
        if person is not None and person in self._of:
            self._of[person].pop(digest, None)
            if not self._of[person]:
                del self._of[person]

    def _put(self, digest: str, row: Any) -> None:
        if self._store is not None:
            self._store.put(digest, row)
