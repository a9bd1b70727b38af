"""`hello`: opens a new session or resumes an earlier one."""

from __future__ import annotations

import secrets
from collections.abc import Callable
from typing import Any

from rcp_kernel.access.acl import Rules
from rcp_kernel.access.identities import Identities
from rcp_kernel.config.settings import Settings
from rcp_kernel.contract.identity import Principal, fingerprint, same
from rcp_kernel.errors import Gap, Unauthenticated
from rcp_kernel.sessions.accounting import SessionAccounting
from rcp_kernel.sessions.command import CommandTable
from rcp_kernel.sessions.hello import Hello
from rcp_kernel.sessions.notices import notice
from rcp_kernel.sessions.resume import SessionResume, StoredSession, Subscribe
from rcp_kernel.sessions.session import Answer, Session, SessionConnection
from rcp_kernel.sessions.sessions import Sessions
from rcp_kernel.wire import VERSION, failure
from rcp_streams.subscription import subscriptions_of

__all__ = ["Handshake"]

_RECENT = 30.0  # s: final replies sent this shortly before a disconnection are sent again
_UNHEARD = 4  # heartbeats until a dead peer is detected: messages sent meanwhile are lost


class Handshake:
    """The handler of `hello`."""

    def __init__(
        self,
        sessions: Sessions,
        *,
        settings: Settings,
        rules: Rules,
        identities: Identities,
        accounting: SessionAccounting,
        commands: CommandTable,
        resume: SessionResume,
        subscribe: Subscribe,
        follower: Callable[[Answer], Answer],
    ) -> None:
        self._sessions = sessions
        self._settings = settings
        self._rules = rules
        self._identities = identities
        self._accounting = accounting
        self._commands = commands
        self._stored = resume
        self._subscribe = subscribe
        """Starts a subscription of an earlier run again."""
        self._follower = follower
        """Delays replies about a command until its steps are recorded."""

    def offered(self, hello: Hello) -> str | None:
        """Return the token in `hello` that authenticates the client, if there is one.

        A resume token in its place identifies a session, and authenticates nobody.
        """
        returning = self._returning(hello)
        if hello.token is None or (returning and _proves(hello.token, returning)):
            return None
        return hello.token

    def greet(
        self, connection: SessionConnection, hello: Hello, principal: Principal | None = None
    ) -> dict[str, Any]:
        """Perform `hello`, whose token proved `principal`: resume or keep the session, agree on limits.

        :raises Unauthenticated: the session is another principal's, or invalid resume token.
        :raises Gap: the session no longer exists.
        """
        session = connection.session
        returning = self._returning(hello)
        if principal is not None and principal != session.principal:
            if same(principal, session.principal):
                self._sessions.renew(session, principal)
                self._sessions.logged_in(session, connection.peer)
                self._sessions.reviewed()
            else:
                opened = self._sessions.open(
                    principal, session.transport, hello.tenant, connection.peer
                )
                self._replace(connection, opened)
        session = connection.session
        if hello.tenant is not None:
            tenant = self._identities.tenant_for(session.principal, hello.tenant)
            self._accounting.change_tenant(session, tenant)
        if hello.session is not None and returning is not connection.session:
            self._resume(connection, hello, returning)
        facts = connection.on_hello(hello) if connection.on_hello is not None else {}
        session = connection.session
        session.resumable = True
        self._stored.note(session)
        limits = self._settings.limits
        agreed = {
            "message": connection.limit,
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
            "tenants": self._identities.tenants_of(session.principal),
            "heartbeat": limits.heartbeat,
            "limits": agreed,
            **facts,
        }

    def _replace(self, connection: SessionConnection, session: Session) -> None:
        old = connection.session
        old.connection, old.successor = None, connection
        self._sessions.drop(old)
        connection.session = session
        session.connection = connection
        session.one_way = connection.one_way
        session.encoding = connection.encoding

    def _returning(self, hello: Hello) -> Session | StoredSession | None:
        """Find the session that `hello` names, by its id or by its resume token."""
        named = hello.session
        if named is None:
            return None
        found = self._sessions.known.get(named)
        if found is None:
            found = next((s for s in self._sessions.known.values() if _proves(named, s)), None)
        return found or self._stored.find(named)

    def _resume(
        self, connection: SessionConnection, hello: Hello, session: Session | StoredSession | None
    ) -> None:
        if session is None:
            connection.session.former = hello.session
            raise _gone()
        offered = (hello.resume_token, hello.token, hello.session)
        proof = next((t for t in offered if t is not None and _proves(t, session)), None)
        present = connection.session.principal
        if not same(session.principal, present):
            raise Unauthenticated(
                "the session belongs to another principal",
                remedy="Send the credentials with which the session began; a resume token "
                "alone does not authenticate.",
            )
        if proof is None and hello.resume_token is not None:
            raise Unauthenticated(
                "invalid resume token",
                remedy="Send the `resume_token` from the reply to the first `hello`.",
            )
        if isinstance(session, StoredSession):
            self._revive(connection, hello, session, proof)
            return
        if session.connection is not None:
            self._takeover(session)
        have = hello.resume_from
        if isinstance(have, int):
            have = _for_all(session, have)
        if present != session.principal:
            self._sessions.renew(session, present)
        self._replace(connection, session)
        self._attach(session, connection, have)

    def _revive(
        self, connection: SessionConnection, hello: Hello, kept: StoredSession, proof: str | None
    ) -> None:
        """Restore a session of an earlier run from its stored form."""
        self._stored.take(kept)
        principal = connection.session.principal
        tenant = kept.tenant if kept.tenant in self._identities.tenants_of(principal) else None
        tenant = self._identities.tenant_for(principal, tenant)
        session = Session(
            principal,
            self._rules.rights(principal),
            tenant,
            kept.transport,
            clock=self._sessions.clock,
        )
        if hello.session is not None and not _proves(hello.session, kept):
            session.id = hello.session
        session.secret = proof or session.secret
        session.created, session.cut = kept.created, kept.cut or self._stored.ended
        name = fingerprint(session.id)
        session.commands = {c.id: c for c in self._commands.every() if c.session == name}
        self._sessions.known[session.id] = session
        self._sessions.watch(session)
        self._replace(connection, session)
        self._accounting.update(session)
        self._attach(session, connection, None)
        self._stored.restore(session, kept, self._subscribe)

    def _takeover(self, session: Session) -> None:
        """Close the old connection: its client has reconnected before the loss was noticed."""
        old = session.connection
        assert old is not None
        old.expelled = True
        old.outbox.flush()
        old.closed = True
        self._sessions.tally(old)
        old.outbox.close()
        self._sessions.disconnect(session)

    def _attach(
        self, session: Session, connection: SessionConnection, have: dict[str, int] | None
    ) -> None:
        if session.expiry is not None:
            session.expiry.cancel()
            session.expiry = None
        cut, session.cut = session.cut or self._sessions.clock.now(), None
        reported = {reply.command for reply, _ in session.missed if reply.final}
        follower = self._follower(session.deliver)
        recent = cut - int(1e9 * max(_RECENT, _UNHEARD * self._settings.limits.heartbeat))
        for command in session.commands.values():
            ended = command.finished
            if command.id not in reported and (ended is None or ended > recent):
                follower(command.reply())
        if session.overflowed:
            lost = session.overflowed
            gap = Gap(f"{lost} replies were lost while the client was disconnected")
            connection.send(failure(gap, "hello"))
            session.overflowed = 0
        while session.missed:
            connection.send(session.missed.popleft()[0])
        session.discard_missed()
        while session.missed_notices:
            code, facts = session.missed_notices.popleft()
            notice(connection.outbox, code, **facts)
        for subscription in session.subscriptions.values():
            subscription.attach(connection.outbox, have)


def _proves(text: str, session: Session | StoredSession) -> bool:
    """Return whether a text is the resume token of a session."""
    if isinstance(session, StoredSession):
        text = fingerprint(text)
    return secrets.compare_digest(session.secret.encode(), text.encode())


def _gone() -> Gap:
    return Gap(
        "the session has expired or never existed",
        remedy="Send `hello` without `session`, then subscribe again.",
    )


def _for_all(session: Session, seq: int) -> dict[str, int]:
    paths = [path for sub in subscriptions_of(session).values() for path in sub.feeds]
    return dict.fromkeys(paths, seq)
