"""A lease, and the error for sessions that it locks out."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from rcp_kernel.clock import iso
from rcp_kernel.errors import LeaseHeld
from rcp_kernel.features import Scope
from rcp_kernel.sessions.session import Session

__all__ = ["GatewayLease", "Lease", "Program", "refusal"]


class Program(NamedTuple):
    """Which of a principal's programs asks, at a gateway between it and the robot's own."""

    name: str | None
    former: str | None = None
    """Its name where it was before."""

    @classmethod
    def of(cls, session: Session) -> Program:
        """Name the program whose session it is, without telling the id of the session."""
        former = session.former
        return cls(_digest(session.holder), None if former is None else _digest(former))

    def of_person(self, session: Session) -> Program:
        """Return the same among those of all persons who come by hubs, at the robot's gateway."""
        person = f"{session.principal.proof}:{session.principal.name}"
        return Program(*(None if one is None else _digest(f"{person} {one}") for one in self))


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:32]


class GatewayLease(NamedTuple):
    """The same lease at the gateway of one of its robots."""

    id: str
    """The one that the robot's gateway has given it."""
    reported: int
    """When that gateway last granted it, ns by its clock."""


@dataclass(slots=True, eq=False)
class Lease:
    """The current state of a lease."""

    id: str
    scope: Scope
    key: str
    """The holder: `Session.holder`."""
    holder: str
    """The principal's name."""
    session: str | None
    """The beginning of the session's id; None for a holder without connections."""
    priority: int
    since: int
    expires: int
    reason: str | None = None
    program: str | None = None
    """The program of a person who came by a hub, which may go on with it at another hub."""
    gateways: dict[str, GatewayLease] = field(default_factory=dict[str, GatewayLease])
    """By the name of each robot (`RobotUnit.name`) that has a gateway of its own."""

    def of_robots(self) -> Iterable[tuple[str, GatewayLease]]:
        """Go through the robots' gateways that hold it."""
        return self.gateways.items()

    def left(self, moment: int) -> float:
        """Return the seconds until it expires."""
        return max(0.0, (self.expires - moment) / 1e9)

    def facts(self) -> dict[str, Any]:
        """Return the details of the error for a refused session."""
        return {
            "scope": self.scope.text,
            "holder": self.holder,
            "since": iso(self.since),
            "expires": iso(self.expires),
            "priority": self.priority,
        }

    def kept(self) -> dict[str, Any]:
        """Return its row in the store."""
        fields = (f for f in self.__slots__ if f not in ("id", "scope"))
        return {"scope": self.scope.text, **{name: getattr(self, name) for name in fields}}


def refusal(lease: Lease, path: str, moment: int, *, of: str | None = None) -> LeaseHeld:
    """Build the error for a session that a lease locks out; `of` replaces a hidden scope."""
    scope = of or lease.scope.text
    return LeaseHeld(
        f"{lease.holder} holds the lease on {scope} until {iso(lease.expires)}",
        path=path,
        retry_after=round(lease.left(moment), 3),
        details=lease.facts() | {"scope": scope},
    )
