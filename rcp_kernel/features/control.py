"""The control service, by which plans check who has control before they start."""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

from rcp_kernel.features.services import ServiceKey
from rcp_kernel.sessions.session import Session
from rcp_kernel.tree.entry import Entry
from rcp_kernel.tree.scope import Scope

__all__ = ["CONTROL", "HOLDERS", "ControlService", "Holder", "HolderService", "NoControl"]


class ControlService(Protocol):
    """Who may currently command what."""

    def check(self, session: Session, entry: Entry) -> None:
        """Refuse what the feature's guard would refuse now.

        :raises RcpError: another client has control, or the session must acquire it first.
        """
        ...

    def gains(self, session: Session, entry: Entry, value: Any) -> Scope | None:
        """Return the scope of which an execute would acquire control, if it is such a request.

        :raises RcpError: the request is invalid.
        """
        ...


CONTROL: ServiceKey[ControlService] = ServiceKey("control")


class NoControl:
    """The service of a gateway where access rules alone decide."""

    def check(self, session: Session, entry: Entry) -> None:
        """Do nothing."""

    def gains(self, session: Session, entry: Entry, value: Any) -> Scope | None:
        """Return None."""
        return None


class Holder(NamedTuple):
    """Who has exclusive control of something."""

    principal: str
    """Its name."""
    scope: Scope
    expires: int
    """When the control ends unless it is renewed, ns since the UNIX epoch."""


class HolderService(Protocol):
    """Who has exclusive control of what."""

    def holder(self, entry: Entry) -> Holder | None:
        """Return who has exclusive control of a resource; None if nobody has."""
        ...


HOLDERS: ServiceKey[HolderService] = ServiceKey("holders")
