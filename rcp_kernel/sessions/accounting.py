"""Accounting: features that count sessions and their activity, and may limit them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Protocol

import structlog

from rcp_kernel.sessions.account import SessionAccount, joint
from rcp_kernel.sessions.command import Command
from rcp_kernel.sessions.session import Session
from rcp_kernel.wire import FINAL

__all__ = ["Accounting", "SessionAccounting", "count_command"]

log = structlog.get_logger("rcp.accounting")


class Accounting(Protocol):
    """Counts sessions, and may refuse one.

    The account returned for a session (None: nothing is counted) applies until another is returned.
    Only `enter` and `check_tenant` may refuse; exceptions of the other methods are logged and change
    nothing, so that no feature can prevent a client from connecting to stop a robot.
    """

    def attach(self, session: Session) -> SessionAccount | None:
        """Return the account of a session that is not counted itself.

        These are the sessions of requests without a connection, and ended ones whose command still
        runs.
        """
        ...

    def enter(self, session: Session, drop: Callable[[Session], None]) -> SessionAccount | None:
        """Count a new session and return its account; `drop` ends one that has to make room.

        Only sessions that wait for their client to return (`Session.cut`) should make room.

        :raises RcpError: as many as allowed are connected.
        """
        ...

    def move(self, session: Session) -> SessionAccount | None:
        """Count a session whose principal or tenant may have changed; return its account.

        Also for a session restored from an earlier run of the gateway.
        """
        ...

    def check_tenant(self, session: Session, tenant: str | None) -> None:
        """Refuse that a session acts for another tenant.

        :raises RcpError: that tenant has as many sessions as it may.
        """
        ...

    def leave(self, session: Session) -> None:
        """Stop counting a session, which may not have been counted."""
        ...

    def forget_commands(self) -> None:
        """Forget the running commands: the configuration may have changed, and each is counted again."""
        ...


class SessionAccounting:
    """Passes sessions to all features that count them."""

    def __init__(
        self,
        sessions: Mapping[str, Session],
        running: Mapping[str, Command],
    ) -> None:
        self._parts: tuple[Accounting, ...] = ()
        self._sessions = sessions
        """All that have a connection or wait for one, by id."""
        self._running = running
        """Commands, by id."""

    def set_features(self, parts: Iterable[Accounting]) -> None:
        """Set the features that count sessions, before there are any."""
        self._parts = tuple(parts)

    def enter(self, session: Session, drop: Callable[[Session], None]) -> None:
        """Count a new session; `drop` ends one that has to make room.

        :raises RcpError: as many as allowed are connected.
        """
        try:
            accounts = [part.enter(session, drop) for part in self._parts]
        except Exception:
            self.leave(session)
            raise
        session.account = joint(accounts)

    def update(self, session: Session) -> None:
        """Count a session under its current principal and tenant; one that has ended is not counted."""
        held = session.id in self._sessions
        accounts: list[SessionAccount | None] = []
        for part in self._parts:
            try:
                accounts.append(part.move(session) if held else part.attach(session))
            except Exception:
                log.exception("accounting_failed", feature=type(part).__module__)
        session.account = joint(accounts)

    def change_tenant(self, session: Session, tenant: str | None) -> None:
        """Change the tenant of a session.

        :raises RcpError: that tenant has as many sessions as allowed; nothing changed.
        """
        if session.tenant != tenant:
            for part in self._parts:
                part.check_tenant(session, tenant)
            session.tenant = tenant
            self.update(session)

    def leave(self, session: Session) -> None:
        """Stop counting a session."""
        for part in self._parts:
            try:
                part.leave(session)
            except Exception:
                log.exception("accounting_failed", feature=type(part).__module__)

    def recount(self) -> None:
        """Count the running commands again: the configuration may have changed."""
        for part in self._parts:
            try:
                part.forget_commands()
            except Exception:
                log.exception("accounting_failed", feature=type(part).__module__)
        for command in self._running.values():
            if command.requester is not None:
                self.update(command.requester)
                if command.requester.account is not None:
                    count_command(command.requester.account, command)


def count_command(account: SessionAccount, command: Command) -> None:
    """Count a command until it ends; a running one continues, even if the feature raises."""
    try:
        end = account.add_command(command.id, command.path)
    except Exception:
        log.exception("accounting_failed", command=command.id)
        return
    command.followers.append(lambda _, step: end() if step.status in FINAL else None)
