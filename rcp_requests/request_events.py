"""Events of requests: refusals, writes, failed authentication, reads of actions."""

from __future__ import annotations

import secrets
from collections.abc import Sequence
from typing import Any

from rcp_kernel.contract.events import Event, EventBus
from rcp_kernel.contract.identity import Principal
from rcp_kernel.contract.peer import Peer
from rcp_kernel.errors import RcpError
from rcp_kernel.features import Call
from rcp_kernel.model import tenant_of
from rcp_kernel.sessions.session import Answer, Session
from rcp_kernel.tree.entry import Entry
from rcp_kernel.wire import Reply, Request
from rcp_requests.replies import ReplyGate

__all__ = ["RequestEvents"]


class RequestEvents:
    """Reports the events of requests, and delays replies where a feature records them."""

    def __init__(self, events: EventBus, gate: ReplyGate) -> None:
        self._events = events
        self._gate = gate

    def refused(
        self, session: Session, request: Request, reply: Reply, answer: Answer, *, hide: bool
    ) -> Answer:
        """Report a refusal; return the receiver of its reply.

        `hide`: the value belongs to other paths than the request's.
        """
        error = reply.error or {}
        faults: list[dict[str, Any]] = [{**error, "path": reply.path}]
        if request.type == "write" and request.path is None:  # its value has those of all paths
            details: dict[str, Any] = error.get("details") or {}
            hide, faults = True, details.get("faults", faults)
        wait = False
        for fault in faults:
            wait |= self._events.note(
                "denial",
                principal=session.principal,
                session=session,
                request=request,
                hide=hide,
                path=fault.get("path"),
                outcome=fault.get("code", "internal"),
                message=fault.get("message", reply.message),
            )
        return self._gate.when_stored(answer, request) if wait else answer

    def hello_refused(self, session: Session, reply: Reply, answer: Answer) -> Answer:
        """Report a refused `hello`, without its contents; return the receiver of its reply."""
        error = reply.error or {}
        event = Event(
            what="denial",
            principal=session.principal,
            session=session,
            outcome=error.get("code", "internal"),
            facts={"message": reply.message, "request": "hello"},
        )
        wait = self._events.tell(event)
        return self._gate.follower(answer) if wait else answer

    def stranger(
        self, transport: str, peer: Peer, error: RcpError, principal: Principal | None = None
    ) -> None:
        """Report a client without valid credentials, or without a role in the requested tenant."""
        self._events.note(
            "denial",
            principal=principal,
            transport=transport,
            address=peer.address,
            outcome=error.code,
            message=error.message,
        )

    def written(self, session: Session, request: Request, entry: Entry, answer: Answer) -> Answer:
        """Return a receiver that reports the outcome of a write, then passes the reply on."""
        gate = self._gate

        def done(reply: Reply) -> None:
            lost = gate.lost
            self._events.tell(
                Event(
                    what="write",
                    principal=session.principal,
                    session=session,
                    request=request,
                    tenant=entry.tenant,
                    path=entry.path,
                    outcome="ok" if reply.error is None else reply.error["code"],
                    facts={"message": reply.message, "latched": _latched(entry)},
                )
            )
            answer(reply if gate.lost == lost else gate.confirmed(reply, lost))

        return done

    def written_together(self, session: Session, calls: Sequence[Call], answer: Answer) -> Answer:
        """Return a receiver that reports the outcome of each write of several, as `written` does.

        They share a `together`, because a client need not give an id.
        """
        gate, together = self._gate, secrets.token_hex(8)

        def done(reply: Reply) -> None:
            lost = gate.lost
            for call in calls:
                self._events.tell(
                    Event(
                        what="write",
                        principal=session.principal,
                        session=session,
                        request=call.request,
                        tenant=call.entry.tenant,
                        path=call.entry.path,
                        outcome="ok" if reply.error is None else reply.error["code"],
                        facts={
                            "message": reply.message,
                            "together": together,
                            "latched": _latched(call.entry),
                        },
                    )
                )
            answer(gate.confirmed(reply, lost))

        return done

    def looked(
        self, session: Session, request: Request, path: str, value: Any, touches: list[str]
    ) -> None:
        """Report a read of a session; without the value, for resources that differ per reader."""
        own = "*" in path or path.startswith("/system/")
        self._events.note(
            "read",
            principal=session.principal,
            session=session,
            request=request,
            tenant=tenant_of(path),
            path=path,
            touches=touches,
            value=None if own else value,
        )


def _latched(entry: Entry) -> bool | None:
    """Return True for a path of a robot that is stopped, else None: most are not."""
    return True if entry.unit.latch is not None else None
