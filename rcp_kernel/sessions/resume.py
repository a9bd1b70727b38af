"""Sessions that can be resumed after a restart of the gateway.

Stored for each: hashes of its id and resume token, never these themselves; its principal and its
subscriptions. It becomes a session again when its client returns and proves to be its owner.
"""

from __future__ import annotations

import asyncio
import hmac
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import msgspec
import structlog

from rcp_kernel.clock import Clock
from rcp_kernel.config.settings import Settings
from rcp_kernel.contract.identity import Principal, fingerprint
from rcp_kernel.contract.shutdown import Shutdown
from rcp_kernel.sessions.notices import notice
from rcp_store.store import Store

if TYPE_CHECKING:
    from rcp_kernel.sessions.session import Session, SessionSubscription

__all__ = ["SessionResume", "StoredSession"]

Subscribe = Callable[["Session", str, dict[str, Any]], None]
log = structlog.get_logger("rcp.store")
_TABLE = "sessions"
_SUBSCRIPTIONS = "subscriptions"
_LIFE = "life"
_BEAT = 5.0  # s between notes that the gateway is alive: how exactly the moment of a crash is known


class StoredSession(msgspec.Struct):
    """The stored part of a session."""

    secret: str
    """Hash of its resume token."""
    principal: Principal
    tenant: str | None
    transport: str
    created: int
    cut: int | None = None
    """When its connection was lost, ns; None: it had one when the gateway was last alive."""
    subscriptions: dict[str, Any] = {}


class SessionResume:
    """The stored sessions of earlier runs, and those of this one."""

    def __init__(
        self,
        store: Store,
        settings: Settings,
        shutdown: Shutdown,
        loop: asyncio.AbstractEventLoop,
        clock: Clock,
    ) -> None:
        self._now = clock.now
        self._store = store
        self._settings = settings
        self._shutdown = shutdown
        self._loop = loop
        self._kept: dict[str, StoredSession] = {}
        self.ended: int = 0
        """When the earlier run was last known to be alive, ns."""
        self._beat: asyncio.TimerHandle | None = None
        if store.keeps:
            self._load()

    def _load(self) -> None:
        store = self._store
        rows = store.load(_TABLE)
        self.ended = store.load(_LIFE).get("alive", 0)
        limit = int(self._settings.limits.session_ttl * 1e9)
        subscriptions = store.load(_SUBSCRIPTIONS)
        for name, row in rows.items():
            try:
                kept = msgspec.convert(row, StoredSession)
            except msgspec.ValidationError as error:
                log.warning("store_row_unreadable", table=_TABLE, error=str(error))
                self._delete(name, [])
                continue
            # No longer than that, though the clock was set back since.
            moment = self._now()
            cut = min(kept.cut or self.ended, moment)
            left = cut + limit - moment
            own = {key: row for key, row in subscriptions.items() if key.startswith(name)}
            if left <= 0:
                self._delete(name, list(own))
                continue
            if kept.cut != cut:  # or the next start would give it the full time again
                kept.cut = cut
                store.put(_TABLE, name, _row(kept))
            kept.subscriptions = {key.partition("/")[2]: row for key, row in own.items()}
            self._kept[name] = kept
            self._loop.call_later(left / 1e9, self._expire, name)

    def start(self) -> None:
        """Store periodically that the gateway is alive."""
        self._store.put(_LIFE, "alive", self._now())
        self._beat = self._loop.call_later(_BEAT, self.start)

    def stop(self) -> None:
        """Store it for the last time."""
        if self._beat is not None:
            self._beat.cancel()
        self._store.put(_LIFE, "alive", self._now())

    # -- sessions of this run -------------------------------------------------------------------

    def note(self, session: Session) -> None:
        """Store a session that its client knows, as it is now."""
        store = self._store
        if not store.keeps or not session.resumable:
            return
        kept = StoredSession(
            fingerprint(session.secret),
            session.principal,
            session.tenant,
            session.transport,
            session.created,
            session.cut,
        )
        row = msgspec.to_builtins(kept)
        del row["subscriptions"]
        store.put(_TABLE, fingerprint(session.id), row)
        if session.cut is None:
            for subscription in session.subscriptions.values():
                self.subscribed(session, subscription)

    def subscribed(self, session: Session, subscription: SessionSubscription) -> None:
        """Keep a subscription of a session that its client knows."""
        if not self._store.keeps or not session.resumable:
            return
        row = subscription.stored()
        if row is not None:
            self._store.put(_SUBSCRIPTIONS, f"{fingerprint(session.id)}/{subscription.id}", row)

    def unsubscribed(self, session: Session, id_: str) -> None:
        """Delete a stored subscription."""
        if self._store.keeps and session.resumable:
            self._store.put(_SUBSCRIPTIONS, f"{fingerprint(session.id)}/{id_}", None)

    def forget(self, session: Session) -> None:
        """Remove a session that has ended; one that ends with the gateway can be resumed."""
        if self._store.keeps and not self._shutdown.begun:
            name = fingerprint(session.id)
            self._delete(name, [f"{name}/{id_}" for id_ in session.subscriptions])

    def _delete(self, name: str, subscriptions: list[str]) -> None:
        self._store.put(_TABLE, name, None)
        for key in subscriptions:
            self._store.put(_SUBSCRIPTIONS, key, None)

    # -- resuming ------------------------------------------------------------------------------

    def find(self, named: str) -> StoredSession | None:
        """Return the session of an earlier run that a client names by its id or its token."""
        text = fingerprint(named)
        found = self._kept.get(text)
        return found or next((kept for kept in self._kept.values() if _same(kept, text)), None)

    def take(self, kept: StoredSession) -> None:
        """Remove a session that is being resumed."""
        self._expire(next(name for name, other in self._kept.items() if other is kept))

    def _expire(self, name: str) -> None:
        kept = self._kept.pop(name, None)
        if kept is not None:
            self._delete(name, [f"{name}/{id_}" for id_ in kept.subscriptions])

    def restore(self, session: Session, kept: StoredSession, subscribe: Subscribe) -> None:
        """Restart a session's subscriptions by `subscribe`, with a notice about lost samples."""
        connection = session.connection
        assert connection is not None
        for id_, row in kept.subscriptions.items():
            try:
                subscribe(session, id_, row)
            except Exception as error:  # one that cannot be had again must not keep the others
                log.warning("subscription_lost", subscription=id_, error=str(error))
                notice(connection.outbox, "subscription_ended", id=id_, reason="restart")
                continue
            notice(
                connection.outbox,
                "gap",
                id=id_,
                reason="restart",
                message="the gateway was restarted: samples in between are lost, and sample "
                "numbers start again",
            )


def _row(kept: StoredSession) -> dict[str, Any]:
    row = msgspec.to_builtins(kept)
    del row["subscriptions"]
    return row


def _same(kept: StoredSession, text: str) -> bool:
    return hmac.compare_digest(kept.secret, text)
