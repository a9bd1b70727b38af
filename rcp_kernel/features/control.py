"""What a feature that decides who has control offers to plans, which are checked before they begin."""

from __future__ import annotations

from typing import Any, Protocol

from rcp_kernel.features.services import ServiceKey
from rcp_kernel.sessions.session import Session
from rcp_kernel.tree.entry import Entry
from rcp_kernel.tree.scope import Scope

__all__ = ["CONTROL", "ControlService", "NoControl"]


class ControlService(Protocol):
    """Who may command what at present."""

    def check(self, session: Session, entry: Entry) -> None:
        """Refuse what the feature's guard would refuse now.

        :raises RcpError: somebody else has control, or the session has to get it first.
        """
        ...

    def gains(self, session: Session, entry: Entry, value: Any) -> Scope | None:
        """Return what an execute would give its session control of, if it is such a request.

        :raises RcpError: it is not a valid one.
        """
        ...


CONTROL: ServiceKey[ControlService] = ServiceKey("control")


class NoControl:
    """The service of a gateway where everybody commands what the access rules allow."""

    def check(self, session: Session, entry: Entry) -> None:
        """Let everything pass."""

    def gains(self, session: Session, entry: Entry, value: Any) -> Scope | None:
        """Nothing is given."""
        return None
