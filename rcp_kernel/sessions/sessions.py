"""All sessions: start, waiting for a disconnected client, change of rules, and end.

Subscriptions and commands belong to the session. If a connection is lost, the session waits for its
client, stores messages, and delivers them on resume; it expires if the client does not return.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Callable
from typing import Any

from rcp_kernel.access.acl import Rights, Rules
from rcp_kernel.access.identities import Identities
from rcp_kernel.clock import Clock
from rcp_kernel.config.settings import Settings
from rcp_kernel.contract.events import EventBus
from rcp_kernel.contract.identity import Principal, same
from rcp_kernel.contract.peer import UNKNOWN, Peer
from rcp_kernel.contract.shutdown import Shutdown
from rcp_kernel.errors import QueueFull, RcpError, TokenExpired
from rcp_kernel.sessions.accounting import SessionAccounting
from rcp_kernel.sessions.backpressure import Relief
from rcp_kernel.sessions.command import CommandTable
from rcp_kernel.sessions.credential_expiry import CredentialExpiry
from rcp_kernel.sessions.notices import notice
from rcp_kernel.sessions.outbound import Outbound
from rcp_kernel.sessions.resume import SessionResume
from rcp_kernel.sessions.session import Session, SessionConnection
from rcp_kernel.wire import error_body, failure

__all__ = ["Sessions"]

_STATELESS = 10_000  # principals whose shared session is cached


class Sessions:
    """Every session, by id."""

    def __init__(
        self,
        known: dict[str, Session],
        *,
        settings: Settings,
        shutdown: Shutdown,
        rules: Rules,
        identities: Identities,
        accounting: SessionAccounting,
        commands: CommandTable,
        resume: SessionResume,
        events: EventBus,
        outbound: Outbound,
        loop: asyncio.AbstractEventLoop,
        clock: Clock,
    ) -> None:
        self.clock = clock
        self.known = known
        self._settings = settings
        self._shutdown = shutdown
        self._rules = rules
        self._identities = identities
        self._accounting = accounting
        self._commands = commands
        self._resume = resume
        self._events = events
        self._outbound = outbound
        self._loop = loop
        self.updates: dict[str, int] = {}
        """Updates sent over connections that are closed, by transport."""
        self._stateless: dict[tuple[Principal, str | None, str], Session] = {}
        self.on_begin: list[Callable[[Session], object]] = []
        """Called with each session that starts, or is authenticated again."""
        self.on_end: list[Callable[[Session], None]] = []
        """Called with each session that ends, first of all."""
        self.on_renewal: list[Callable[[Session], object]] = []
        """Called with a session whose rights have changed."""
        self.on_review: list[Callable[[], None]] = []
        """Called when the rights of holders may have changed."""
        self._credential_expiry = CredentialExpiry(loop, clock, self._expel)
        self.relief = Relief(loop, known.values, outbound)
        identities.on_change.append(self.review)

    def open(
        self,
        principal: Principal,
        transport: str,
        tenant: str | None = None,
        peer: Peer = UNKNOWN,
    ) -> Session:
        """Create a session.

        :raises Forbidden: the principal has no role in `tenant`.
        :raises QueueFull: there are too many sessions.
        """
        chosen = self._identities.tenant_for(principal, tenant)
        if len(self.known) >= self._settings.limits.sessions:
            self._make_room()
        if len(self.known) >= self._settings.limits.sessions:
            raise QueueFull("the gateway has reached its limit of sessions")
        session = Session(
            principal, self._rules.rights(principal), chosen, transport, clock=self.clock
        )
        self._accounting.enter(session, self.drop)
        self.known[session.id] = session
        self.relief.start()
        self.logged_in(session, peer)
        return session

    def everyone(self) -> list[Session]:
        """List the sessions of connections, and those that requests without one share."""
        return [*self.known.values(), *self._stateless.values()]

    def holding(self, key: str) -> list[Session]:
        """List the sessions that act for a holder: one, or all that its principal has."""
        own = self.known.get(key)
        return [own] if own else [s for s in self.everyone() if key in s.holders]

    def end(self, session: Session, reason: str) -> None:
        """End a session as one whose credentials are no longer valid."""
        self._expel(session, TokenExpired(reason))

    def tell(self, key: str, code: str, **facts: Any) -> None:
        """Send a notice to all sessions of a holder."""
        for session in self.holding(key):
            session.tell(code, **facts)

    def logged_in(self, session: Session, peer: Peer) -> None:
        """Record a login, and monitor the expiry of its credentials."""
        principal = session.principal
        self.watch(session)
        for began in self.on_begin:
            began(session)
        if not principal.anonymous:
            self._events.note(
                "login",
                principal=principal,
                session=session,
                transport=session.transport,
                address=peer.address,
            )

    def watch(self, session: Session) -> None:
        """End a session when the credentials of its principal expire."""
        self._credential_expiry.watch(session)

    def _make_room(self) -> None:
        """Drop the session that has waited longest for its client, of the tenant with the most.

        Connected clients take precedence, and no tenant can displace the sessions of others.
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
            chosen = self._identities.tenant_for(principal, tenant)
            rights = self._rules.rights(principal)
            session = Session(principal, rights, chosen, transport, clock=self.clock, shared=True)
            self._accounting.update(session)
            if len(self._stateless) >= _STATELESS:
                self._credential_expiry.forget(self._stateless.pop(next(iter(self._stateless))))
            self._stateless[key] = session
            self.logged_in(session, peer)
        return session

    def commanding(self, session: Session) -> Session:
        """Return the session in which a client commands: the shared one, if this one only listens."""
        if not session.one_way:
            return session
        return self.stateless(session.principal, session.transport, session.tenant)

    def review(self) -> None:
        """Apply new rules to every session; end those with invalid credentials."""
        for command in self._commands.running.values():  # pending work of principals
            if (requester := command.requester) is not None:
                principal = self._identities.renewed(requester.principal)
                if principal is None:
                    requester.rights = Rights((), {})
                else:
                    requester.principal, requester.rights = principal, self._rules.rights(principal)
        shared = list(self._stateless.items())
        self._stateless.clear()
        self._accounting.recount()
        # Renew the surviving sessions first: anything held by the principal is released when its last
        # session ends.
        ended: list[Session] = []
        for (_, tenant, transport), session in shared:
            if not self._renewed(session):
                ended.append(session)
                continue
            if tenant is None:  # as for a first request
                session.tenant = self._identities.tenant_for(session.principal, None)
            elif tenant not in self._identities.tenants_of(session.principal):
                self._credential_expiry.forget(session)
                continue
            self._stateless[session.principal, tenant, transport] = session
        ended += [session for session in list(self.known.values()) if not self._renewed(session)]
        for session in ended:
            self._expel(session)
        self.reviewed()

    def reviewed(self) -> None:
        """Let features check whether holders may keep what they hold."""
        for review in self.on_review:
            review()

    def _renewed(self, session: Session) -> bool:
        principal = self._identities.renewed(session.principal)
        if principal is None:
            return False
        self.renew(session, principal)
        return True

    def renew(self, session: Session, principal: Principal) -> None:
        """Continue a session with the current rights of its principal."""
        session.principal = principal
        session.rights = self._rules.rights(principal)
        if session.tenant not in self._identities.tenants_of(principal):
            session.tenant = self._identities.tenant_for(principal, None)
        self._accounting.update(session)
        for renewed in self.on_renewal:
            renewed(session)
        self._credential_expiry.watch(session)

    def _expel(self, session: Session, why: RcpError | None = None) -> None:
        """End a session with invalid credentials, and all that it holds."""
        error = why or TokenExpired("the session's credentials are no longer valid")
        connection = session.connection
        if connection is not None:
            for id_ in session.subscriptions:
                notice(
                    connection.outbox,
                    "subscription_ended",
                    id=id_,
                    reason=error.code,
                    error=error_body(error),
                    message=error.message,
                )
            connection.send(failure(error, "hello"))
            connection.expelled = True
            connection.outbox.mark()
        for ending in list(session.endings):
            ending(error)
        session.rights = Rights((), {})  # for requests already in transit
        self._credential_expiry.forget(session)
        if session.id in self.known or not self._elsewhere(session):
            self.drop(session)

    def _elsewhere(self, session: Session) -> bool:
        """Remove a shared session; return whether its principal has a newer one."""
        for key in [k for k, shared in self._stateless.items() if shared is session]:
            del self._stateless[key]
        return any(same(s.principal, session.principal) for s in self._stateless.values())

    def tally(self, connection: SessionConnection) -> None:
        """Add a closing connection's updates to its transport's sum."""
        name = connection.session.transport
        self.updates[name] = self.updates.get(name, 0) + connection.outbox.updates

    def disconnect(self, session: Session) -> None:
        """Handle a lost connection; the session waits if its client knows its id."""
        session.connection = None
        session.cut = self.clock.now()
        session.missed_backlog = self._outbound.open()
        running = self._commands.running
        for command in [running[id_] for id_ in session.commands if id_ in running]:
            entry = command.entry
            if entry is not None and not entry.resource.outlives:
                self._commands.cancel(command, "the session was disconnected")
        if not session.resumable or self._shutdown.begun:
            self.drop(session)
            return
        for subscription in session.subscriptions.values():
            subscription.detach()
        session.expiry = self._loop.call_later(
            self._settings.limits.session_ttl, self.drop, session
        )
        self._resume.note(session)

    def drop(self, session: Session) -> None:
        """End a session and release what it holds; its commands continue."""
        self.known.pop(session.id, None)
        for ended in self.on_end:
            ended(session)
        self._resume.forget(session)
        self._accounting.leave(session)
        self._credential_expiry.forget(session)
        if session.expiry is not None:
            session.expiry.cancel()
        for subscription in session.subscriptions.values():
            subscription.forget()
        session.subscriptions.clear()
        session.discard_missed()
