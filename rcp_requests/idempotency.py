"""Idempotency keys: a repeated request under the same key is never executed again.

A key is committed before the robot receives its request, and the outcome before the client does.
After a crash, a known key therefore returns its outcome, or reports that there is none.
"""

from __future__ import annotations

import asyncio
import hashlib
from collections import OrderedDict
from collections.abc import Callable
from typing import Any

import msgspec
import structlog

from rcp_kernel.clock import Clock, now
from rcp_kernel.errors import DuplicateRequest, InternalError
from rcp_kernel.model import tenant_of
from rcp_kernel.sessions.command import Command, Record
from rcp_kernel.sessions.session import Session
from rcp_kernel.values import Encoding
from rcp_kernel.wire import NO_BODY, Reply, Request, encode_reply, failure
from rcp_store.store import Store

__all__ = ["Keys", "Outcome", "committed"]

log = structlog.get_logger("rcp.store")
_KEPT = 20_000
_BYTES = 16 * 1024 * 1024  # of outcomes
_LONGEST = 64 * 1024  # bytes of one outcome; a longer one is kept without its body
_AGE = 86_400.0  # s
_TABLE = "keys"
_UNKEPT = ("outcome", "since")
"""What the store does not have of a key."""

Outcome = Command | asyncio.Future[Reply]
"""What a key has led to: the command of an `execute`, or the reply to a write."""


class _Seen:
    """A key with its request and the outcome."""

    __slots__ = (
        "command",
        "created",
        "digest",
        "number",
        "outcome",
        "path",
        "reply",
        "since",
        "type",
    )

    def __init__(
        self, digest: bytes, created: int, type_: str, path: str, since: float = 0.0
    ) -> None:
        self.digest = digest
        self.created = created
        self.since = since
        """When this run came to know it, by `Clock.monotonic`: wall time may be set at any moment."""
        self.number = 0
        """Its place in the order of all keys: wall time may have gone back in between."""
        self.type = type_
        self.path = path
        self.command: str | None = None
        self.reply: bytes | None = None
        self.outcome: Outcome | None = None

    def row(self) -> dict[str, Any]:
        return {name: getattr(self, name) for name in self.__slots__ if name not in _UNKEPT}

    @property
    def size(self) -> int:
        return len(self.reply or b"")


class Keys:
    """The first outcome of each key, by principal, for a day in which the gateway runs."""

    def __init__(self, store: Store, loop: asyncio.AbstractEventLoop, clock: Clock) -> None:
        self._now, self._monotonic = clock.now, clock.monotonic
        self._store = store
        self._loop = loop
        self._known: OrderedDict[str, _Seen] = OrderedDict()
        self._bytes = 0
        self._number = 0

    def find(self, session: Session, request: Request, path: str) -> Outcome | None:
        """Return the pending or final outcome of the request's key, or None.

        :raises DuplicateRequest: the key was used for a different request.
        :raises InternalError: the stored outcome cannot be read.
        """
        if request.idempotency_key is None:
            return None
        found = self._known.get(_name(session, request.idempotency_key, path))
        if found is None or found.since < self._monotonic() - _AGE:
            return None
        if found.outcome is None:
            raise _unreadable(path)
        if found.digest != _digest(request, path):
            raise DuplicateRequest(
                "the idempotency key was used for a different request", path=path
            )
        return found.outcome

    def note(self, session: Session, request: Request, path: str, outcome: Outcome) -> None:
        """Store a request that has a key; `settle` adds its outcome."""
        if request.idempotency_key is None:
            return
        name = _name(session, request.idempotency_key, path)
        if name in self._known:
            self._drop(name)
        seen = _Seen(_digest(request, path), self._now(), request.type, path, self._monotonic())
        seen.outcome = outcome
        self._number = seen.number = self._number + 1
        if isinstance(outcome, Command):
            seen.command = outcome.id
        self._known[name] = seen
        self._store.put(_TABLE, name, seen.row())
        self._bound()

    def settle(self, session: Session, request: Request, path: str, reply: Reply) -> None:
        """Remember the final reply to a request that has a key."""
        if request.idempotency_key is None:
            return
        name = _name(session, request.idempotency_key, path)
        seen = self._known.get(name)
        if seen is None:  # there were too many since
            return
        seen.reply = _encoded(reply)
        self._bytes += seen.size
        if isinstance(seen.outcome, Command):
            seen.outcome = _ended(seen, reply)  # of the command itself nothing more is needed
        self._store.put(_TABLE, name, seen.row())
        self._bound()

    def forget(self, session: Session, request: Request, path: str) -> None:
        """Let the key go: the request was refused before it could have done anything."""
        if request.idempotency_key is not None:
            name = _name(session, request.idempotency_key, path)
            if name in self._known:
                self._drop(name)

    async def committed(self) -> None:
        """Wait until the keys noted so far are kept."""
        await committed(self._store)

    def _drop(self, name: str) -> None:
        self._bytes -= self._known.pop(name).size
        self._store.put(_TABLE, name, None)

    def _bound(self) -> None:
        oldest = self._monotonic() - _AGE
        while len(self._known) > _KEPT or self._bytes > _BYTES:
            self._drop(next(iter(self._known)))
        while self._known and self._known[next(iter(self._known))].since < oldest:
            self._drop(next(iter(self._known)))

    def load(self, command: Callable[[str], Command | None]) -> None:
        """Load the keys of earlier runs; `command` finds a command of the history."""
        rows = self._store.load(_TABLE, unreadable={})
        found, since = [(name, _read(row)) for name, row in rows.items()], self._monotonic()
        # Rows of former versions have no number. What cannot be read is kept for longest.
        for name, seen in sorted(
            found, key=lambda item: (not item[1].digest, item[1].number, item[1].created)
        ):
            seen.since = since
            self._number = max(self._number, seen.number)
            self._known[name] = seen
            self._bytes += seen.size
            if not seen.digest:
                continue
            reply = _cut_off(seen) if seen.reply is None else _decoded(seen)
            if seen.command is not None:
                seen.outcome = command(seen.command) or _ended(seen, reply)
            else:
                seen.outcome = self._loop.create_future()
                seen.outcome.set_result(reply)
        self._bound()


async def committed(store: Store) -> None:
    """Wait until all that was put into a store so far is kept."""
    if not store.idle:
        done = asyncio.get_running_loop().create_future()
        store.settled(lambda: done.done() or done.set_result(None))
        await done


def _name(session: Session, key: str, path: str) -> str:
    """Name a key: that of a principal, by its proof, in one tenant."""
    name, proof = session.principal.identity
    text = f"{len(name)}:{name}:{proof}:{tenant_of(path)}:{key}"
    return hashlib.sha256(text.encode()).hexdigest()


def _digest(request: Request, path: str) -> bytes:
    text = b"\0".join((request.type.encode(), path.encode(), bytes(request.body)))
    return hashlib.sha256(text).digest()


def _encoded(reply: Reply) -> bytes:
    """Write a reply without what belongs to its request."""
    kept = msgspec.structs.replace(reply, id=None, custom=None)
    try:
        data = encode_reply(kept, Encoding.MSGPACK)
    except Exception:  # a body that cannot be encoded was not shown to the first client either
        data = b""
    if not data or len(data) > _LONGEST:
        kept.body = NO_BODY
        data = encode_reply(kept, Encoding.MSGPACK)
    return data


def _decoded(seen: _Seen) -> Reply:
    fields: dict[str, Any] = msgspec.msgpack.decode(seen.reply or b"\x80")
    return Reply(**fields)


def _read(row: Any) -> _Seen:
    """Return the key of a row; one that cannot be read has no digest: it fits no request."""
    try:
        seen = _Seen(row["digest"], row["created"], row["type"], row["path"])
        seen.command, seen.reply = row["command"], row["reply"]
        seen.number = row.get("number", 0)
        if seen.reply is not None:
            _decoded(seen)
    except (msgspec.DecodeError, TypeError, KeyError) as error:
        log.warning("store_row_unreadable", table=_TABLE, error=str(error))
        return _Seen(b"", now(), "", "")
    return seen


def _unreadable(path: str) -> InternalError:
    """Refuse an unreadable key: its request may have been executed, so it is not executed again."""
    return InternalError(
        "what came of this idempotency key cannot be read; the request was not sent again",
        path=path,
        remedy="Check the state of the robot, then send it with a new key if it is still needed.",
    )


def _cut_off(seen: _Seen) -> Reply:
    error = InternalError(
        "the gateway stopped during the request; it was not sent again",
        path=seen.path,
        remedy="Check the state of the robot, then send it with a new key if it is still needed.",
    )
    return failure(error, seen.type, path=seen.path, command=seen.command)


def _ended(seen: _Seen, reply: Reply) -> Command:
    """Create a command from its final reply alone."""
    last = Record(reply.status, now(), reply.body, message=reply.message, error=reply.error)
    return Command(
        id=seen.command or "",
        path=seen.path,
        principal="",
        tenant=None,
        created=seen.created,
        finished=last.time,
        history=[last],
    )
