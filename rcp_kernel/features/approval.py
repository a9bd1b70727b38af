"""What a feature for approvals offers to plans and to adapters that can ask a person."""

from __future__ import annotations

from typing import Any, Literal, NamedTuple, Protocol

from rcp_kernel.errors import UnknownPath
from rcp_kernel.features.services import ServiceKey
from rcp_kernel.sessions.session import Session
from rcp_kernel.tree.entry import Entry
from rcp_kernel.wire import Request

__all__ = ["APPROVALS", "ID", "About", "ApprovalService", "Decision", "NoApprovals"]

Decision = Literal["approve", "reject"]
ID = "a-"
"""What the ids of approvals begin with; what lets the steps of a plan pass begins otherwise."""


class About(NamedTuple):
    """What a command that wants approval is about."""

    paths: tuple[str, ...]
    """Those for which it wants it."""
    seen: tuple[str, ...]
    """All that whoever decides has to see."""
    steps: tuple[str, ...] = ()
    """Of a plan: those that want it."""


class ApprovalService(Protocol):
    """Whether a person has approved a command, and what became of the question."""

    def wanted(self, session: Session, entry: Entry, value: Any) -> bool:
        """Tell whether a command wants approval; bringing an actuator to rest never does."""
        ...

    def demand(
        self, session: Session, request: Request, entry: Entry, value: Any, about: About
    ) -> None:
        """Use an approval of a command up, or ask for one.

        :raises ApprovalRequired: with the id to ask about and to repeat the command with.
        :raises Forbidden: it was rejected, used, or is not for this.
        """
        ...

    def open(self, paths: tuple[str, ...]) -> str:
        """Return what lets the steps of an approved plan pass, until `close`."""
        ...

    def close(self, token: str | None) -> None:
        """Have nothing pass by a token any more."""
        ...

    def answer(self, session: Session, id_: str, decision: Decision, reason: str | None) -> None:
        """Decide as the person whom the client of a session has asked.

        Only for an answer that a person gave at the client, never for one of a model.

        :raises UnknownPath: there is no such approval for this principal.
        :raises Forbidden: the roles do not let it decide (`may_approve`; `approve_own` for what it
            asked for itself), or there is nothing to decide any more.
        :raises RateLimited: it is one request too many now.
        """
        ...


APPROVALS: ServiceKey[ApprovalService] = ServiceKey("approvals")


class NoApprovals:
    """The service of a gateway without approvals: nothing wants one."""

    def wanted(self, session: Session, entry: Entry, value: Any) -> bool:
        """Nothing does."""
        return False

    def demand(
        self, session: Session, request: Request, entry: Entry, value: Any, about: About
    ) -> None:
        """Let everything pass."""

    def open(self, paths: tuple[str, ...]) -> str:
        """Return what is never looked at."""
        return ""

    def close(self, token: str | None) -> None:
        """Do nothing."""

    def answer(self, session: Session, id_: str, decision: Decision, reason: str | None) -> None:
        """Refuse: there is nothing to decide."""
        raise UnknownPath(f"there is no approval '{id_[:64]}'", remedy="Send the command again.")
