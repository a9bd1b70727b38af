"""One client over time: its subscriptions, its commands, and messages not delivered yet.

A session owns its subscriptions, and what is kept for a client that is away. It only follows its
commands, which `rcp_requests.journal` owns: they go on without it. What a client has acquired, such
as a lease, belongs to the feature that gave it, under `Session.holder`; the socket to the connection.
"""

from __future__ import annotations

import asyncio
import secrets
from collections import deque
from collections.abc import Callable
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Protocol

from rcp_kernel.access.acl import Rights
from rcp_kernel.clock import Clock, iso
from rcp_kernel.contract.identity import Principal
from rcp_kernel.contract.peer import Peer
from rcp_kernel.errors import DuplicateRequest, QueueFull, RcpError
from rcp_kernel.sessions.hello import Hello
from rcp_kernel.sessions.notices import notice
from rcp_kernel.values import Encoding
from rcp_kernel.wire import Reply, Request, encode_reply

if TYPE_CHECKING:
    from rcp_kernel.sessions.account import SessionAccount
    from rcp_kernel.sessions.outbound import Backlog
    from rcp_kernel.sessions.outbox import Outbox

__all__ = [
    "Answer",
    "Handler",
    "OwnCommand",
    "Session",
    "SessionConnection",
    "SessionSubscription",
]

Answer = Callable[[Reply], None]
_MISSED = 4096  # replies stored for a disconnected client
_NOTICES = 256  # notices stored for a disconnected client


class Handler(Protocol):
    """Handle one request: `answer` is called for each reply, the last one final."""

    def __call__(self, session: Session, request: Request, answer: Answer, /) -> None:
        """Accept the request; never raises, never blocks."""
        ...


class OwnCommand(Protocol):
    """A session's view of a command that it follows."""

    finished: int | None

    @property
    def id(self) -> str:
        """The gateway's id."""
        ...

    @property
    def final(self) -> bool:
        """Whether it has ended."""
        ...

    def reply(self) -> Reply:
        """Write its latest step as a reply envelope."""
        ...


class SessionConnection(Protocol):
    """The connection of a session to its client."""

    session: Session
    closed: bool
    expelled: bool
    one_way: bool
    on_hello: Callable[[Hello], dict[str, Any]] | None

    @property
    def outbox(self) -> Outbox:
        """The messages waiting to be sent."""
        ...

    @property
    def peer(self) -> Peer:
        """Who is at the other end."""
        ...

    @property
    def encoding(self) -> Encoding:
        """The encoding of messages."""
        ...

    @property
    def limit(self) -> int:
        """Longest message that the client may send now, in bytes."""
        ...

    def send(self, reply: Reply) -> None:
        """Queue a reply."""
        ...


@lru_cache(maxsize=64)
def _read_key(transport: str) -> tuple[str, str, str]:
    """Return the same object for all sessions: a dictionary finds it without comparing its parts."""
    return transport, "read", "ok"


class SessionSubscription(Protocol):
    """A stream of samples that a session has asked for, as the session keeps it."""

    id: str
    skipped: int
    """Number of samples skipped on all paths since the start."""

    def stored(self) -> dict[str, Any] | None:
        """Return what starts it again after a restart of the gateway; None: nothing can."""
        ...

    def attach(self, outbox: Outbox, missed_from: dict[str, int] | None) -> None:
        """Resume sending, missed samples first; `missed_from` is the client's last sample by path."""
        ...

    def detach(self) -> None:
        """Stop sending because the connection is lost."""
        ...

    def forget(self) -> None:
        """Let go of all its paths: the session has ended."""
        ...


class Session:
    """One principal's subscriptions, commands and replies not yet delivered."""

    __slots__ = (
        "account",
        "commands",
        "connection",
        "created",
        "cut",
        "encoding",
        "endings",
        "expiry",
        "expiry_check",
        "former",
        "id",
        "inflight",
        "missed",
        "missed_backlog",
        "missed_bytes",
        "missed_notices",
        "monotonic",
        "one_way",
        "overflowed",
        "principal",
        "read_key",
        "resumable",
        "rights",
        "secret",
        "shared",
        "subscriptions",
        "successor",
        "tenant",
        "transport",
        "unattended",
    )

    def __init__(
        self,
        principal: Principal,
        rights: Rights,
        tenant: str | None,
        transport: str,
        *,
        clock: Clock,
        shared: bool = False,
    ) -> None:
        self.id = "s-" + secrets.token_hex(16)
        self.secret = secrets.token_urlsafe(24)
        self.shared = shared
        """All requests of a principal without a connection share it (HTTP)."""
        self.principal = principal
        self.rights = rights
        self.tenant = tenant
        self.transport = transport
        self.read_key = _read_key(transport)
        """Statistics of successful reads."""
        self.encoding = Encoding.JSON
        self.connection: SessionConnection | None = None
        self.successor: SessionConnection | None = None
        """Its connection when it was replaced by another session: unanswered requests are answered there."""
        self.subscriptions: dict[str, SessionSubscription] = {}
        self.commands: dict[str, OwnCommand] = {}
        """The latest commands that it follows, by the gateway's id."""
        self.inflight: set[str] = set()
        """The unanswered requests, by id."""
        self.created = clock.now()
        self.monotonic = clock.monotonic
        """The time by which its requests are paced."""
        self.cut: int | None = None
        """When the connection was lost, ns; None while there is one."""
        self.expiry: asyncio.TimerHandle | None = None
        self.resumable = False
        """Whether the client may resume it: since a `hello`, it knows its id."""
        self.one_way = False
        """Whether its connection accepts no requests (SSE)."""
        self.former: str | None = None
        """The session of another gateway that its client wanted to resume here."""
        self.unattended = False
        """Whether a feature uses it on behalf of an absent principal."""
        self.account: SessionAccount | None = None
        """Counts its requests, subscriptions and commands; None counts nothing."""
        self.missed: deque[tuple[Reply, int]] = deque()
        """Replies for a disconnected client, with their approximate sizes."""
        self.missed_bytes = 0
        self.missed_backlog: Backlog | None = None
        """Counts `missed` while the client is disconnected and may still resume; else None."""
        self.missed_notices: deque[tuple[str, dict[str, Any]]] = deque(maxlen=_NOTICES)
        """Notices for a disconnected client."""
        self.overflowed = 0
        self.expiry_check: asyncio.TimerHandle | None = None
        """The next check of the principal's expiry."""
        self.endings: set[Callable[[RcpError], None]] = set()
        """Called when the credentials become invalid, besides the connection."""

    @property
    def holder(self) -> str:
        """The holder of what the session acquires: itself, or its principal if others act for it too."""
        return self.holders[0]

    @property
    def holders(self) -> tuple[str, ...]:
        """The holders that the session acts for: itself, and its principal as a whole."""
        whole = f"{self.principal.proof}:{self.principal.name}"
        if (hub := self.principal.via) is not None:  # the hub distinguishes its own sessions itself
            return (f"{whole}@{hub}",)
        return (whole,) if self.shared else (self.id, whole)

    @property
    def stateless(self) -> bool:
        """Whether the session belongs to a transport without connections (HTTP)."""
        return self.connection is None and self.cut is None

    def in_flight_key(self, request: Request, most: int) -> str:
        """Return the key by which a request is kept in `inflight`, of at most `most` unanswered ones.

        :raises DuplicateRequest: the id is in use.
        :raises QueueFull: there are as many already.
        """
        inflight = self.inflight
        if len(inflight) >= most:
            raise QueueFull(f"this session already has {len(inflight)} unanswered requests")
        if request.id is None or (self.connection is None and self.stateless):
            return f"\0{secrets.token_hex(8)}"
        if request.id in inflight:
            raise DuplicateRequest(f"a request with the id '{request.id}' is still unanswered")
        return request.id

    def charge(self) -> None:
        """Count a request without an envelope.

        :raises RateLimited: the limit is exceeded.
        """
        account = self.account
        if account is not None and not account.take(moment := self.monotonic()):
            raise account.refusal(moment)

    def check_pace(self) -> None:
        """Check the rate limit before reading a long request (stops are short).

        The request is counted later, when it is handled.

        :raises RateLimited: the limit would be exceeded.
        """
        account = self.account
        if account is not None and not account.allows(moment := self.monotonic()):
            raise account.refusal(moment)

    @property
    def waiting_bytes(self) -> int:
        """Number of bytes queued for the client, without samples."""
        if self.connection is None:
            return self.missed_bytes
        outbox = self.connection.outbox
        return outbox.waiting + outbox.parked + outbox.buffered

    def deliver(self, reply: Reply) -> None:
        """Send a reply now, or keep it for the client's return."""
        link = self.connection or self.successor
        if link is not None:
            link.send(reply)
            return
        if self.missed_backlog is None:  # it cannot be resumed
            return
        if reply.status == "in_progress" and reply.command is not None:
            for old in [kept for kept in self.missed if _replaces(reply, kept[0])]:
                self.missed.remove(old)
                self._count_missed(-old[1])
        size = _length(reply)
        self.missed.append((reply, size))
        self._count_missed(size)
        while self.missed and (len(self.missed) > _MISSED or self.missed_backlog.overfull):
            self.drop_oldest()

    def _count_missed(self, size: int) -> None:
        self.missed_bytes += size
        if self.missed_backlog is not None:
            self.missed_backlog.set(self.missed_bytes)

    def drop_oldest(self) -> None:
        """Drop the oldest reply stored for a disconnected client, which will be notified."""
        self._count_missed(-self.missed.popleft()[1])
        self.overflowed += 1

    def discard_missed(self) -> None:
        """Discard the replies stored for the client: it has resumed, or cannot."""
        self.missed.clear()
        self.missed_bytes = 0
        if self.missed_backlog is not None:
            self.missed_backlog.close()
            self.missed_backlog = None

    def tell(self, code: str, **facts: Any) -> None:
        """Send a notice now, or keep it for the client's return."""
        if self.connection is not None:
            notice(self.connection.outbox, code, **facts)
        elif self.cut is not None:
            self.missed_notices.append((code, facts))

    def plain(self) -> dict[str, Any]:
        """Describe the session for `/system/sessions`."""
        return {
            "session": self.id[:8],  # the whole id would allow others to resume the session
            "principal": self.principal.name,
            "tenant": self.tenant,
            "transport": self.transport,
            "connected": self.connection is not None,
            "address": self.connection.peer.address if self.connection else None,
            "login": self.principal.login,
            "created": iso(self.created),
            "subscriptions": len(self.subscriptions),
            "commands": sum(1 for c in self.commands.values() if not c.final),
            "backlog": self.connection.outbox.depth if self.connection else len(self.missed),
        }


def _replaces(newer: Reply, older: Reply) -> bool:
    return older.command == newer.command and not older.final


def _length(reply: Reply) -> int:
    """Return about how many bytes a reply is; one that cannot be written becomes a short error."""
    try:
        return len(encode_reply(reply, Encoding.JSON))
    except Exception:
        return 256
