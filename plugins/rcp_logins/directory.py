"""`/system/logins`: who is logged in, and the end of logins and sessions."""

from __future__ import annotations

from collections.abc import Generator
from typing import Any

from msgspec import to_builtins

from rcp_kernel.clock import iso
from rcp_kernel.contract.identity import Principal, same_rights
from rcp_kernel.errors import UnknownPath
from rcp_kernel.features import FeatureHost
from rcp_kernel.features.choice import chosen
from rcp_kernel.model import Operation
from rcp_kernel.sessions.session import Session
from rcp_logins.authenticator import PATH, LoginAuthenticator
from rcp_logins.login import Login
from rcp_logins.messages import Ended, Ending, ListedLogin

__all__ = ["PATH", "LoginDirectory"]

_SESSIONS = "/system/sessions"
"""Whoever may execute this sees the sessions of others, and may end them."""


class LoginDirectory:
    """Lists and ends: everybody's own, and those of people in tenants where the role allows it."""

    def __init__(self, logins: LoginAuthenticator, host: FeatureHost) -> None:
        self._logins = logins
        self._host = host

    def view(self, session: Session) -> Generator[Any]:
        """List the logins that a reader may end."""
        for login in self._logins.every:
            if _may_end(session, self._logins.owner(login)):
                yield to_builtins(self._listed(login))

    def _listed(self, login: Login) -> ListedLogin:
        return ListedLogin(
            login=login.id,
            principal=login.name,
            proof=login.proof,
            address=login.address,
            remembered=login.remembered,
            begun=iso(login.begun),
            used=iso(login.used),
            expires=iso(self._logins.until(login)),
            sessions=len(self._sessions(login)),
        )

    def _sessions(self, login: Login) -> list[Session]:
        return [
            one
            for one in self._host.sessions.everyone()
            if one.principal.login == login.id and one.connection is not None
        ]

    def end(self, session: Session, ending: Ending, *, dry_run: bool) -> Ended:
        """End a login or a session.

        :raises UnknownPath: there is none that this session may end.
        """
        if chosen(ending, PATH) == "login":
            return self._end_login(session, ending.login or "", dry_run=dry_run)
        return self._end_session(session, ending.session or "", dry_run=dry_run)

    def _end_login(self, session: Session, id_: str, *, dry_run: bool) -> Ended:
        login = self._logins.get(id_)
        if login is None or not _may_end(session, self._logins.owner(login)):
            raise UnknownPath(
                f"there is no login '{id_}' that you may end", path=PATH, remedy=f"Read {PATH}."
            )
        ended = Ended(principal=login.name, sessions=len(self._sessions(login)))
        if not dry_run:
            self._note(session, login.principal, login=login.id)
            self._logins.close(login, "ended")
        return ended

    def _end_session(self, session: Session, id_: str, *, dry_run: bool) -> Ended:
        found = [
            one
            for one in self._host.sessions.everyone()
            if one.plain()["session"] == id_ and _may_end(session, one.principal)
        ]
        if len(found) != 1:
            raise UnknownPath(
                f"there is no session '{id_}' that you may end",
                path=PATH,
                remedy=f"Read {_SESSIONS}.",
            )
        (other,) = found
        if not dry_run:
            self._note(session, other.principal, ended_session=id_)
            self._host.sessions.end(other, f"the session was ended by {session.principal.name}")
        return Ended(principal=other.principal.name, sessions=1)

    def _note(self, session: Session, whose: Principal, **facts: str) -> None:
        self._host.note(
            "session_end",
            principal=session.principal,
            session=session,
            path=PATH,
            of=whose.name,
            **facts,
        )


def _may_end(session: Session, other: Principal) -> bool:
    """Tell whether somebody may end what another has: own, or in every tenant in which that acts."""
    if same_rights(session.principal, other) and not other.anonymous:
        return True
    places = session.rights.places(_SESSIONS, Operation.EXECUTE)
    return "*" in places or (bool(other.tenants) and set(other.tenants) <= set(places))
