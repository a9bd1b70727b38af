"""One client over time: what it subscribed to, what it commanded, and what it has not been told yet."""

from __future__ import annotations

import asyncio
import secrets
from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Protocol

from rcp_kernel.access.acl import Rights
from rcp_kernel.clock import Clock, iso
from rcp_kernel.contract.identity import Principal
from rcp_kernel.contract.peer import Peer
from rcp_kernel.errors import RcpError
from rcp_kernel.sessions.hello import Hello
from rcp_kernel.streams.notices import notice
from rcp_kernel.streams.subscription import Subscription
from rcp_kernel.values import Encoding
from rcp_kernel.wire import Reply, Request, encode_reply

if TYPE_CHECKING:
    from rcp_kernel.contract.pending import Pending
    from rcp_kernel.sessions.account import SessionAccount
    from rcp_kernel.streams.outbound import Backlog
    from rcp_kernel.streams.outbox import Outbox

__all__ = ["Answer", "Handler", "Link", "OwnCommand", "Session"]

Answer = Callable[[Reply], None]
_MISSED = 4096  # replies kept for a client that is away
_NEWS = 256  # notices kept for a client that is away


class Handler(Protocol):
    """Handle one request: `answer` is called for each reply, the last one final."""

    def __call__(self, session: Session, request: Request, answer: Answer, /) -> None:
        """Take the request in; never raises, never blocks."""
        ...


class OwnCommand(Protocol):
    """What a session knows of a command that it follows."""

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


class Link(Protocol):
    """The connection that a session has its client by."""

    session: Session
    closed: bool
    expelled: bool
    one_way: bool
    on_hello: Callable[[Hello], dict[str, Any]] | None

    @property
    def outbox(self) -> Outbox:
        """What waits to be sent."""
        ...

    @property
    def peer(self) -> Peer:
        """Who is at the other end."""
        ...

    @property
    def encoding(self) -> Encoding:
        """How messages are written."""
        ...

    @property
    def limit(self) -> int:
        """Longest message that the client may send now, in bytes."""
        ...

    def send(self, reply: Reply) -> None:
        """Queue a reply."""
        ...


class Session:
    """One principal's subscriptions, commands and replies not yet delivered."""

    __slots__ = (
        "_monotonic",
        "account",
        "away",
        "commands",
        "connection",
        "created",
        "cut",
        "encoding",
        "endings",
        "expiry",
        "greeted",
        "id",
        "inflight",
        "lapse",
        "missed",
        "missed_bytes",
        "news",
        "one_way",
        "overflowed",
        "principal",
        "read_key",
        "rights",
        "secret",
        "shared",
        "subscriptions",
        "successor",
        "tenant",
        "transport",
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
        self.read_key = (transport, "read", "ok")
        """Under what the gateway counts a read that went well."""
        self.encoding = Encoding.JSON
        self.connection: Link | None = None
        self.successor: Link | None = None
        """Its connection when it was replaced by another session: unanswered requests are answered there."""
        self.subscriptions: dict[str, Subscription] = {}
        self.commands: dict[str, OwnCommand] = {}
        self.inflight: dict[str, Pending | None] = {}
        self.created = clock.now()
        self._monotonic = clock.monotonic
        self.cut: int | None = None
        """When the connection was lost, ns; None while there is one."""
        self.expiry: asyncio.TimerHandle | None = None
        self.greeted = False
        """The client knows the session's id, so it may come back to it."""
        self.one_way = False
        """Its connection takes no requests (SSE): it is told things, and commands nothing."""
        self.account: SessionAccount | None = None
        """What its requests, subscriptions and commands are counted by; None: by nothing."""
        self.missed: deque[tuple[Reply, int]] = deque()
        """Replies for a client that is away, and about how long each is."""
        self.missed_bytes = 0
        self.away: Backlog | None = None
        """Counts these while the client is away."""
        self.news: deque[tuple[str, dict[str, Any]]] = deque(maxlen=_NEWS)
        """Notices for the client's return."""
        self.overflowed = 0
        self.lapse: asyncio.TimerHandle | None = None
        """The next look at how long the principal's proof holds."""
        self.endings: set[Callable[[RcpError], None]] = set()
        """Whom to tell that the proof is not good any more, beside the connection."""

    @property
    def holder(self) -> str:
        """As whom the session holds what it acquires: itself, or its principal if it is shared."""
        return self.holders[0]

    @property
    def holders(self) -> tuple[str, ...]:
        """Whose holdings are the session's: its own, and those of its principal as a whole."""
        whole = f"{self.principal.proof}:{self.principal.name}"
        return (whole,) if self.shared else (self.id, whole)

    @property
    def stateless(self) -> bool:
        """Whether the session belongs to a transport without connections (HTTP)."""
        return self.connection is None and self.cut is None

    def charge(self) -> None:
        """Count a request that comes in no envelope.

        :raises RateLimited: it is one too many now.
        """
        account = self.account
        if account is not None and not account.take(moment := self._monotonic()):
            raise account.refusal(moment)

    def check_pace(self) -> None:
        """Refuse a request that is too long to be one that stops something, before it is read.

        It counts for nothing yet: that comes when it is handled.

        :raises RateLimited: it would be one too many now.
        """
        account = self.account
        if account is not None and not account.allows(moment := self._monotonic()):
            raise account.refusal(moment)

    @property
    def waiting_bytes(self) -> int:
        """How many bytes wait for the client, but for samples."""
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
        if self.away is None:  # nobody comes back to it
            return
        if reply.status == "in_progress" and reply.command is not None:
            for old in [kept for kept in self.missed if _replaces(reply, kept[0])]:
                self.missed.remove(old)
                self._count_missed(-old[1])
        size = _length(reply)
        self.missed.append((reply, size))
        self._count_missed(size)
        while self.missed and (len(self.missed) > _MISSED or self.away.overfull):
            self.lose()

    def _count_missed(self, size: int) -> None:
        self.missed_bytes += size
        if self.away is not None:
            self.away.set(self.missed_bytes)

    def lose(self) -> None:
        """Let go of the oldest reply that waits for a client that is away; it will be told."""
        self._count_missed(-self.missed.popleft()[1])
        self.overflowed += 1

    def let_missed_go(self) -> None:
        """Keep nothing more for the client's return: it is back, or will not come."""
        self.missed.clear()
        self.missed_bytes = 0
        if self.away is not None:
            self.away.close()
            self.away = None

    def tell(self, code: str, **facts: Any) -> None:
        """Send a notice now, or keep it for the client's return."""
        if self.connection is not None:
            notice(self.connection.outbox, code, **facts)
        elif self.cut is not None:
            self.news.append((code, facts))

    def plain(self) -> dict[str, Any]:
        """Describe the session for `/system/sessions`."""
        return {
            "session": self.id[:8],  # whoever knows the whole id may come back to the session
            "principal": self.principal.name,
            "tenant": self.tenant,
            "transport": self.transport,
            "connected": self.connection is not None,
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
