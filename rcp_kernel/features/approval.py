"""The approval service for plans, and for adapters that can ask a person."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, NamedTuple, Protocol

from rcp_kernel.errors import UnknownPath
from rcp_kernel.features.services import ServiceKey
from rcp_kernel.sessions.session import Session
from rcp_kernel.tree.entry import Entry
from rcp_kernel.wire import Request

__all__ = ["APPROVALS", "ID", "About", "ApprovalService", "Decision", "NoApprovals"]

Decision = Literal["approve", "reject"]
ID = "a-"
"""Prefix of approval ids; the tokens of plans have another."""


class About(NamedTuple):
    """The subject of a command that requires approval."""

    paths: tuple[str, ...]
    """Paths that require it."""
    seen: tuple[str, ...]
    """Paths that the person who decides must be allowed to see."""
    steps: tuple[str, ...] = ()
    """For a plan: the steps that require it."""


class ApprovalService(Protocol):
    """Whether a command requires approval, and decisions on approvals."""

    def wanted(self, session: Session, entry: Entry, value: Any) -> bool:
        """Return whether a command requires approval; bringing an actuator to rest never does."""
        ...

    def demand(
        self, session: Session, request: Request, entry: Entry, value: Any, about: About
    ) -> None:
        """Use an approval for a command, or request one.

        :raises ApprovalRequired: with the id to decide on, and to repeat the command with.
        :raises Forbidden: it was rejected or used, or is for another command.
        """
        ...

    def open(self, paths: tuple[str, ...]) -> str:
        """Return a token that admits the steps of an approved plan, until `close`."""
        ...

    def close(self, token: str | None) -> None:
        """Revoke a token."""
        ...

    def answer(self, session: Session, id_: str, decision: Decision, reason: str | None) -> None:
        """Decide as the person at the session's client.

        Only for an answer given by a person at the client, never by a model.

        :raises UnknownPath: this principal has no such approval.
        :raises Forbidden: its roles do not allow it (`may_approve`; `approve_own` for its own
            requests), or the approval is no longer pending.
        :raises RateLimited: too many requests.
        """
        ...

    def follow(self, id_: str, decided: Callable[[], None]) -> Callable[[], None]:
        """Call `decided` when an approval is decided; return a function to stop."""
        ...


APPROVALS: ServiceKey[ApprovalService] = ServiceKey("approvals")


class NoApprovals:
    """The service of a gateway without approvals: no command requires one."""

    def wanted(self, session: Session, entry: Entry, value: Any) -> bool:
        """Return False."""
        return False

    def demand(
        self, session: Session, request: Request, entry: Entry, value: Any, about: About
    ) -> None:
        """Do nothing."""

    def open(self, paths: tuple[str, ...]) -> str:
        """Return a token that is never checked."""
        return ""

    def close(self, token: str | None) -> None:
        """Do nothing."""

    def answer(self, session: Session, id_: str, decision: Decision, reason: str | None) -> None:
        """Refuse: there are no approvals."""
        raise UnknownPath(f"there is no approval '{id_[:64]}'", remedy="Send the command again.")

    def follow(self, id_: str, decided: Callable[[], None]) -> Callable[[], None]:
        """Never call."""
        return lambda: None
