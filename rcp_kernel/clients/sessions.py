"""What a principal holds over time, and the connections it comes in by.

Subscriptions and commands live in the session. A connection can be cut: the session waits for its
return, notes what it would have said, and says it then; it expires if nobody comes.
"""

from __future__ import annotations

import asyncio
import secrets
from collections import Counter, deque
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Protocol

from rcp_kernel.access.acl import Rights
from rcp_kernel.access.identity import Principal, same
from rcp_kernel.access.lapsing import Lapsing
from rcp_kernel.access.peer import UNKNOWN, Peer
from rcp_kernel.clients.returning import Kept, hashed
from rcp_kernel.clock import iso, now
from rcp_kernel.errors import Gap, RcpError, TokenExpired, Unauthenticated
from rcp_kernel.streaming.hub import Hub
from rcp_kernel.streaming.notices import notice
from rcp_kernel.streaming.streams import Subscription
from rcp_kernel.values import Encoding
from rcp_kernel.wire import (
    VERSION,
    Reply,
    Request,
    encode_reply,
    error_body,
    failure,
)

if TYPE_CHECKING:
    from rcp_kernel.access.meter import Meter
    from rcp_kernel.clients.connections import Connection, Hello
    from rcp_kernel.gateway import Gateway
    from rcp_kernel.operations.command import Command
    from rcp_kernel.operations.pending import Pending

__all__ = ["Answer", "Handler", "Session", "Sessions"]

Answer = Callable[[Reply], None]
_STATELESS = 10_000  # principals whose shared session is kept at hand
_MISSED = 4096  # replies kept for a client that is away
_NEWS = 256  # notices kept for a client that is away
_MISSED_BYTES = 16 * 1024 * 1024  # that these may have together
_RECENT = 30_000_000_000  # ns: final replies sent this shortly before a cut are said again


class Handler(Protocol):
    """Handle one request: `answer` is called for each reply, the last one final."""

    def __call__(self, session: Session, request: Request, answer: Answer, /) -> None:
        """Take the request in; never raises, never blocks."""
        ...


class Session:
    """One principal's subscriptions, commands and replies not yet delivered."""

    __slots__ = (
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
        "listening",
        "meter",
        "missed",
        "missed_bytes",
        "news",
        "overflowed",
        "principal",
        "read_key",
        "rights",
        "secret",
        "shared",
        "subscriptions",
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
        self.connection: Connection | None = None
        self.subscriptions: dict[str, Subscription] = {}
        self.commands: dict[str, Command] = {}
        self.inflight: dict[str, Pending | None] = {}
        self.created = now()
        self.cut: int | None = None
        """When the connection was lost, ns; None while there is one."""
        self.expiry: asyncio.TimerHandle | None = None
        self.greeted = False
        """The client knows the session's id, so it may come back to it."""
        self.listening = False
        """Its connection takes no requests (SSE): it is told things, and commands nothing."""
        self.meter: Meter | None = None
        """What its requests are counted by; None if no quota concerns it."""
        self.missed: deque[tuple[Reply, int]] = deque()
        """Replies for a client that is away, and about how long each is."""
        self.missed_bytes = 0
        self.news: deque[tuple[str, dict[str, Any]]] = deque(maxlen=_NEWS)
        """Notices for the client's return."""
        self.overflowed = 0
        self.lapse: asyncio.TimerHandle | None = None
        """The next look at how long the principal's proof holds."""
        self.endings: set[Callable[[RcpError], None]] = set()
        """Whom to tell that the proof is not good any more, beside the connection."""

    @property
    def holder(self) -> str:
        """As whom the session acquires leases: itself, or its principal if it is shared."""
        return self.holders[0]

    @property
    def holders(self) -> tuple[str, ...]:
        """Whose leases are the session's: its own, and those of its principal as a whole."""
        whole = f"{self.principal.proof}:{self.principal.name}"
        return (whole,) if self.shared else (self.id, whole)

    @property
    def stateless(self) -> bool:
        """Whether the session belongs to a transport without connections (HTTP)."""
        return self.connection is None and self.cut is None

    def deliver(self, reply: Reply) -> None:
        """Send a reply now, or keep it for the client's return."""
        if self.connection is not None:
            self.connection.send(reply)
            return
        if reply.status == "in_progress" and reply.command is not None:
            for old in [kept for kept in self.missed if _replaces(reply, kept[0])]:
                self.missed.remove(old)
                self.missed_bytes -= old[1]
        size = _length(reply)
        self.missed.append((reply, size))
        self.missed_bytes += size
        while len(self.missed) > _MISSED or self.missed_bytes > _MISSED_BYTES:
            self.lose()

    def lose(self) -> None:
        """Let go of the oldest reply that waits for a client that is away; it will be told."""
        self.missed_bytes -= self.missed.popleft()[1]
        self.overflowed += 1

    def tell(self, code: str, **facts: Any) -> None:
        """Send a notice now, or keep it for the client's return."""
        if self.connection is not None:
            notice(self.connection.mailbox, code, **facts)
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
            "backlog": self.connection.mailbox.backlog if self.connection else len(self.missed),
        }


class Sessions:
    """Every session, by id."""

    def __init__(self, gateway: Gateway) -> None:
        self._gateway = gateway
        self.known: dict[str, Session] = {}
        self.updates: dict[str, int] = {}
        """Updates sent over connections that are closed, by transport."""
        self._stateless: dict[tuple[Principal, str | None, str], Session] = {}
        self._lapsing = Lapsing(gateway.loop, self._expel)

    def _hub(self) -> Hub:
        return self._gateway.hub

    def open(
        self,
        principal: Principal,
        transport: str,
        tenant: str | None = None,
        peer: Peer = UNKNOWN,
    ) -> Session:
        """Make a session.

        :raises Forbidden: the principal does not act in `tenant`.
        :raises QueueFull: there are too many sessions.
        """
        gateway = self._gateway
        chosen = gateway.identities.tenant_for(principal, tenant)
        if len(self.known) >= gateway.limits.sessions:
            self._make_room()
        gateway.check_sessions(len(self.known))
        session = Session(principal, gateway.rules.rights(principal), chosen, transport)
        gateway.accounts.enter(session)
        self.known[session.id] = session
        self._logged_in(session, peer)
        return session

    def everyone(self) -> list[Session]:
        """List the sessions of connections, and those that requests without one share."""
        return [*self.known.values(), *self._stateless.values()]

    def holding(self, key: str) -> list[Session]:
        """List the sessions whose a holder's leases are: one, or all that its principal has."""
        own = self.known.get(key)
        return [own] if own else [s for s in self.everyone() if key in s.holders]

    def tell(self, key: str, code: str, **facts: Any) -> None:
        """Send a notice to whoever acts for a holder of leases."""
        for session in self.holding(key):
            session.tell(code, **facts)

    def _logged_in(self, session: Session, peer: Peer) -> None:
        principal = session.principal
        self._lapsing.watch(session)
        if not principal.anonymous:
            self._gateway.audit.note(
                "login",
                principal=principal,
                session=session,
                transport=session.transport,
                address=peer.address,
            )

    def _make_room(self) -> None:
        """Drop the session that has waited longest for its client, of the tenant that has most.

        Who is here goes first, and nobody loses his place to a tenant that takes them all.
        """
        held = Counter(session.tenant for session in self.known.values())
        waiting = [session for session in self.known.values() if session.cut is not None]
        if waiting:
            self.drop(min(waiting, key=lambda s: (-held[s.tenant], s.cut or 0)))

    def stateless(
        self, principal: Principal, transport: str, tenant: str | None, peer: Peer = UNKNOWN
    ) -> Session:
        """Return the session that all HTTP requests of a principal share; it holds nothing."""
        key = (principal, tenant, transport)
        session = self._stateless.get(key)
        if session is None:
            gateway = self._gateway
            chosen = gateway.identities.tenant_for(principal, tenant)
            rights = gateway.rules.rights(principal)
            session = Session(principal, rights, chosen, transport, shared=True)
            gateway.accounts.attach(session)
            if len(self._stateless) >= _STATELESS:
                self._lapsing.forget(self._stateless.pop(next(iter(self._stateless))))
            self._stateless[key] = session
            self._logged_in(session, peer)
        return session

    def offered(self, hello: Hello) -> str | None:
        """Return the token of `hello` that is to prove who it is, if there is one.

        A resume token in its place proves the session alone.
        """
        returning = self._returning(hello)
        if hello.token is None or (returning and _proves(hello.token, returning)):
            return None
        return hello.token

    def greet(
        self, connection: Connection, hello: Hello, principal: Principal | None = None
    ) -> dict[str, Any]:
        """Carry out `hello`, whose token proved `principal`: resume or keep the session, agree.

        :raises Unauthenticated: the resume token is not known.
        :raises Gap: the session is not there any more.
        """
        gateway = self._gateway
        session = connection.session
        returning = self._returning(hello)
        if principal is not None and principal != session.principal:
            if same(principal, session.principal):
                self._renew(session, principal)
                self._logged_in(session, connection.peer)
                gateway.leases.review()
            else:
                opened = self.open(principal, session.transport, hello.tenant, connection.peer)
                self._replace(connection, opened)
        session = connection.session
        if hello.tenant is not None:
            tenant = gateway.identities.tenant_for(session.principal, hello.tenant)
            gateway.accounts.change_tenant(session, tenant)
        if hello.session is not None and returning is not connection.session:
            self._resume(connection, hello, returning)
        facts = connection.on_hello(hello) if connection.on_hello is not None else {}
        session = connection.session
        session.greeted = True
        gateway.returning.note(session)
        limits = gateway.limits
        agreed = {
            "message": limits.message,
            "subscriptions": limits.subscriptions,
            "in_flight": limits.in_flight,
            **facts.pop("limits", {}),
        }
        return {
            "version": VERSION,
            "session": session.id,
            "resume_token": session.secret,
            "principal": session.principal.name,
            "roles": list(session.principal.roles),
            "tenant": session.tenant,
            "tenants": gateway.identities.tenants_of(session.principal),
            "heartbeat": limits.heartbeat,
            "limits": agreed,
            **facts,
        }

    def _replace(self, connection: Connection, session: Session) -> None:
        old = connection.session
        old.connection = None
        self.drop(old)
        connection.session = session
        session.connection = connection
        session.encoding = connection.encoding

    def _returning(self, hello: Hello) -> Session | Kept | None:
        """Find the session that `hello` names, by its id or by its resume token."""
        named = hello.session
        if named is None:
            return None
        found = self.known.get(named)
        if found is None:
            found = next((s for s in self.known.values() if _proves(named, s)), None)
        return found or self._gateway.returning.find(named)

    def _resume(self, connection: Connection, hello: Hello, session: Session | Kept | None) -> None:
        if session is None:
            raise _gone()
        offered = (hello.resume_token, hello.token, hello.session)
        proof = next((t for t in offered if t is not None and _proves(t, session)), None)
        present = connection.session.principal
        known = same(session.principal, present)
        if proof is None and (hello.resume_token is not None or not known):
            raise Unauthenticated(
                "the session belongs to somebody else, or the resume token is wrong",
                remedy="Send the `resume_token` that the first `hello` was answered with.",
            )
        if isinstance(session, Kept):
            self._revive(connection, hello, session, proof)
            return
        if session.connection is not None:
            self._takeover(session)
        have = hello.resume_from
        if isinstance(have, int):
            have = _for_all(session, have)
        if known and present != session.principal:
            self._renew(session, present)
        self._replace(connection, session)
        self._attach(session, connection, have)

    def _revive(self, connection: Connection, hello: Hello, kept: Kept, proof: str | None) -> None:
        """Make a session again of what is kept of one of an earlier run."""
        gateway = self._gateway
        principal = gateway.returning.take(kept)
        present = connection.session.principal
        if same(kept.principal, present):
            principal = present
        if principal is None:
            raise _gone()
        tenant = kept.tenant if kept.tenant in gateway.identities.tenants_of(principal) else None
        tenant = gateway.identities.tenant_for(principal, tenant)
        session = Session(principal, gateway.rules.rights(principal), tenant, kept.transport)
        if hello.session is not None and not _proves(hello.session, kept):
            session.id = hello.session
        session.secret = proof or session.secret
        session.created, session.cut = kept.created, kept.cut or gateway.returning.ended
        name = hashed(session.id)
        session.commands = {c.id: c for c in gateway.commands.every() if c.session == name}
        self.known[session.id] = session
        self._lapsing.watch(session)
        self._replace(connection, session)
        gateway.accounts.move(session)
        self._attach(session, connection, None)
        gateway.returning.restore(session, kept)

    def _takeover(self, session: Session) -> None:
        """Cut the old connection: its client came back before the gateway saw it leave."""
        old = session.connection
        assert old is not None
        old.expelled = True
        old.mailbox.flush()
        old.closed = True
        self.tally(old)
        old.mailbox.close()
        self.cut(session)

    def _attach(
        self, session: Session, connection: Connection, have: dict[str, int] | None
    ) -> None:
        if session.expiry is not None:
            session.expiry.cancel()
            session.expiry = None
        cut, session.cut = session.cut or now(), None
        said = {reply.command for reply, _ in session.missed if reply.final}
        tell = self._gateway.recording.follower(session.deliver)
        for command in session.commands.values():
            ended = command.finished
            if command.id not in said and (ended is None or ended > cut - _RECENT):
                tell(command.reply())
        if session.overflowed:
            lost = session.overflowed
            gap = Gap(f"{lost} replies were lost while the client was away")
            connection.send(failure(gap, "hello"))
            session.overflowed = 0
        while session.missed:
            connection.send(session.missed.popleft()[0])
        session.missed_bytes = 0
        while session.news:
            code, facts = session.news.popleft()
            notice(connection.mailbox, code, **facts)
        for subscription in session.subscriptions.values():
            self._hub().attach(subscription, connection.mailbox, have)

    def review(self) -> None:
        """Bring every session under new rules; end those whose proof is not good any more."""
        gateway = self._gateway
        for command in gateway.commands.running.values():  # what is under way in somebody's name
            if (asker := command.asker) is not None:
                principal = gateway.identities.renewed(asker.principal)
                asker.rights = (
                    Rights((), {}) if principal is None else gateway.rules.rights(principal)
                )
        shared = list(self._stateless.items())
        self._stateless.clear()
        gateway.accounts.recount()
        for (_, tenant, transport), session in shared:
            if self._reviewed(session):
                tenants = gateway.identities.tenants_of(session.principal)
                if tenant is None:  # as for a request that comes first
                    session.tenant = tenants[0] if tenants else None
                elif tenant not in tenants:
                    self._lapsing.forget(session)
                    continue
                self._stateless[session.principal, tenant, transport] = session
        for session in list(self.known.values()):
            self._reviewed(session)
        gateway.leases.review()

    def _reviewed(self, session: Session) -> bool:
        principal = self._gateway.identities.renewed(session.principal)
        if principal is None:
            self._expel(session)
            return False
        self._renew(session, principal)
        return True

    def _renew(self, session: Session, principal: Principal) -> None:
        """Have a session go on under what its principal's proof gives now."""
        gateway = self._gateway
        session.principal = principal
        session.rights = gateway.rules.rights(principal)
        tenants = gateway.identities.tenants_of(principal)
        if session.tenant not in tenants:
            session.tenant = tenants[0] if tenants else None
        gateway.accounts.move(session)
        gateway.drop_forbidden(session)
        self._lapsing.watch(session)

    def _expel(self, session: Session) -> None:
        """End a session whose proof is not good any more, and all that it holds."""
        told = TokenExpired("the proof of this session is not good any more")
        connection = session.connection
        if connection is not None:
            for id_ in session.subscriptions:
                notice(
                    connection.mailbox,
                    "subscription_ended",
                    id=id_,
                    reason=told.code,
                    error=error_body(told),
                    message=told.message,
                )
            connection.send(failure(told, "hello"))
            connection.expelled = True
            connection.mailbox.mark()
        for ending in list(session.endings):
            ending(told)
        session.rights = Rights((), {})  # for what is under way to the gateway
        self._lapsing.forget(session)
        if session.id in self.known or not self._elsewhere(session):
            self.drop(session)

    def _elsewhere(self, session: Session) -> bool:
        """Take a shared session out; tell whether its principal has another, by a newer proof."""
        for key in [k for k, shared in self._stateless.items() if shared is session]:
            del self._stateless[key]
        return any(same(s.principal, session.principal) for s in self._stateless.values())

    def tally(self, connection: Connection) -> None:
        """Add a closing connection's updates to its transport's sum."""
        name = connection.session.transport
        self.updates[name] = self.updates.get(name, 0) + connection.mailbox.updates

    def cut(self, session: Session) -> None:
        """Take notice that the connection is gone; the session waits if its client knows it."""
        gateway = self._gateway
        session.connection = None
        session.cut = now()
        for command in list(session.commands.values()):
            entry = command.entry
            if entry is not None and not entry.resource.outlives:
                gateway.commands.cancel(command, "its session was cut")
        if not session.greeted or gateway.closing:
            self.drop(session)
            return
        for subscription in session.subscriptions.values():
            self._hub().detach(subscription)
        session.expiry = gateway.hub.loop.call_later(gateway.limits.session_ttl, self.drop, session)
        gateway.returning.note(session)

    def drop(self, session: Session) -> None:
        """End a session and its leases; its commands go on."""
        self.known.pop(session.id, None)
        self._gateway.leases.ended(session)
        self._gateway.returning.forget(session)
        self._gateway.accounts.leave(session)
        self._lapsing.forget(session)
        if session.expiry is not None:
            session.expiry.cancel()
        for subscription in session.subscriptions.values():
            self._hub().forget(subscription)
        session.subscriptions.clear()
        session.missed.clear()
        session.missed_bytes = 0


def _proves(text: str, session: Session | Kept) -> bool:
    """Tell whether a text is the resume token of a session."""
    if isinstance(session, Kept):
        text = hashed(text)
    return secrets.compare_digest(session.secret.encode(), text.encode())


def _gone() -> Gap:
    return Gap(
        "the session has expired or never was",
        remedy="Say `hello` without `session`, then subscribe afresh.",
    )


def _replaces(newer: Reply, older: Reply) -> bool:
    return older.command == newer.command and not older.final


def _length(reply: Reply) -> int:
    """Return about how many bytes a reply is; one that cannot be written becomes a short error."""
    try:
        return len(encode_reply(reply, Encoding.JSON))
    except Exception:
        return 256


def _for_all(session: Session, seq: int) -> dict[str, int]:
    paths = [path for sub in session.subscriptions.values() for path in sub.feeds]
    return dict.fromkeys(paths, seq)
