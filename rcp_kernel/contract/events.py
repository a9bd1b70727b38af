"""Events of the gateway, for features that record them or react to them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any, Literal, Protocol

import msgspec

from rcp_kernel.contract.identity import Principal
from rcp_kernel.wire import Request

__all__ = ["ActingSession", "Event", "EventBus", "EventHandler", "EventKind", "EventListener"]


EventKind = Literal[
    "configuration",
    "deadman",
    "denial",
    "estop",
    "login",
    "read",
    "recovery",
    "reload",
    "start",
    "stop",
    "unrecorded",
    "write",
]
"""What the gateway itself reports; features report kinds of their own by `FeatureHost.note`."""


class ActingSession(Protocol):
    """The session in which something was done."""

    @property
    def id(self) -> str:
        """Its id, which is a secret of its client."""
        ...

    @property
    def tenant(self) -> str | None:
        """The tenant in which it acts."""
        ...

    @property
    def transport(self) -> str | None:
        """The transport of its client."""
        ...


class Event(msgspec.Struct, frozen=True, kw_only=True, gc=False):
    """Something that happened: a write, a refusal, a login, an e-stop, a reload."""

    what: str
    """An `EventKind`, or the kind that a feature reports."""
    principal: Principal | None
    """Who did it; None for the gateway itself, and for unauthenticated clients."""
    session: ActingSession | None = None
    request: Request | None = None
    """The envelope that caused it."""
    hide: bool = False
    """Whether the value of the request belongs to other paths, so that only its hash may be
    shown."""
    tenant: str | None = None
    path: str | None = None
    touches: Iterable[str] | None = None
    """All paths that it is about, where these are several."""
    outcome: str = "ok"
    """`ok`, an error code, or the state reached."""
    facts: Mapping[str, Any] = {}
    """Further facts; some may be None."""


EventHandler = Callable[[Event], bool | None]
"""Receives an event, without blocking; returns whether replies about it should wait (`Durability`)."""


class EventListener(Protocol):
    """A feature that receives all events."""

    on_event: EventHandler
    failing: bool
    """Whether it did not even accept the event that reports a gap."""

    def missed_event(self, event: Event, error: Exception, /) -> None:
        """Handle an event at which the feature failed."""
        ...


class EventBus:
    """Passes each event to all listeners; costs nothing without any."""

    def __init__(self) -> None:
        self.listeners: list[EventListener] = []

    def note(
        self,
        what: EventKind,
        *,
        principal: Principal | None,
        session: ActingSession | None = None,
        request: Request | None = None,
        hide: bool = False,
        tenant: str | None = None,
        path: str | None = None,
        touches: Iterable[str] | None = None,
        outcome: str = "ok",
        **facts: Any,
    ) -> bool:
        """Report that something happened; return whether replies about it should wait."""
        if not self.listeners:
            return False
        return self.tell(
            Event(
                what=what,
                principal=principal,
                session=session,
                request=request,
                hide=hide,
                tenant=tenant,
                path=path,
                touches=touches,
                outcome=outcome,
                facts=facts,
            )
        )

    def tell(self, event: Event) -> bool:
        """Report an event; return whether replies about it should wait."""
        wait = False
        for listener in self.listeners:  # every listener gets the event
            try:
                if listener.on_event(event):
                    wait = True
                listener.failing = False
            except Exception as error:  # a feature must not prevent commands or stops
                listener.missed_event(event, error)
        return wait
