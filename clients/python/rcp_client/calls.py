"""Requests in flight: their envelopes and ids, and whether they may be sent again."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from typing import Any

from rcp_client.errors import unknown_outcome
from rcp_client.messages import Reply
from rcp_client.requests import Repeat, keyed, repeatable
from rcp_protocol.errors import RcpError
from rcp_protocol.wire import FINAL

__all__ = ["Call", "Calls"]


class Call:
    """One request, until its final reply."""

    __slots__ = (
        "_asked",
        "_heard",
        "command",
        "end",
        "envelope",
        "first",
        "fixed",
        "ids",
        "link",
        "listeners",
        "loop",
        "on_refusal",
        "repeat",
        "sent",
        "session",
        "started",
    )

    def __init__(self, envelope: dict[str, Any], repeat: Repeat, fixed: str | None = None) -> None:
        self.loop = asyncio.get_running_loop()
        self._asked = envelope
        """As the caller gave it: a key that was added here is a new one when the caller repeats it."""
        self.envelope = keyed(envelope) if repeat == "keyed" else envelope
        self.repeat: Repeat = repeat
        self.fixed = fixed
        """A fixed id, for requests whose id has a meaning."""
        self.link: object = None
        """The connection it was last sent on."""
        self.ids: list[str] = []
        """All ids under which it was sent; replies to any of them belong to it."""
        self.command: str | None = None
        """The gateway's id of the command it started."""
        self.session: str | None = None
        """The session that reports on the command, once it is accepted."""
        self.sent: int | None = None
        """When it was first sent, ns since the epoch."""
        self.started = time.monotonic()
        self.first: asyncio.Future[None] = self.loop.create_future()
        """Done with the first reply, or with an error."""
        self.end: asyncio.Future[Reply | RcpError] = self.loop.create_future()
        self.listeners: list[Callable[[Reply], None]] = []
        self.on_refusal: Callable[[Reply], None] | None = None
        """Takes a refusal instead: of a repeat by a gateway that may not know of the first time."""
        self._heard = ""

    def take(self, reply: Reply) -> None:
        """Handle a reply; duplicates are dropped."""
        if self.end.done():
            return
        if reply.status == "rejected" and self.on_refusal is not None:
            self.on_refusal(reply)
            return
        self.command = self.command or reply.command
        if reply.status not in FINAL:
            if reply.timestamp is not None and reply.timestamp <= self._heard:
                return
            self._heard = reply.timestamp or self._heard
        for listener in list(self.listeners):
            listener(reply)
        if reply.status in FINAL:
            self.end.set_result(reply)
        if not self.first.done():
            self.first.set_result(None)

    def forget_command(self) -> None:
        """Forget the command's id, and when its last feedback was: another gateway's clock."""
        self.command, self._heard = None, ""

    def unanswered(self, error: RcpError, *, keys: bool = True) -> RcpError:
        """Note in an error without a reply whether the caller may repeat the request.

        `keys` tells whether the gateway still knows the idempotency keys.
        """
        if self.sent is None or repeatable(self._asked, keys=keys):
            return error
        return unknown_outcome(error)

    def fail(self, error: RcpError) -> None:
        """End the call without a reply."""
        if not self.end.done():
            self.end.set_result(error)
        if not self.first.done():
            self.first.set_result(None)


class Calls:
    """All requests in flight, by each of their ids and by command."""

    def __init__(self) -> None:
        self._by_id: dict[str, Call] = {}
        self._by_command: dict[str, Call] = {}
        self._open: dict[Call, None] = {}

    def __len__(self) -> int:
        return len(self._open)

    def __contains__(self, call: Call) -> bool:
        return call in self._open

    def every(self) -> list[Call]:
        """List the calls in the order in which they began."""
        return list(self._open)

    def enter(self, call: Call) -> None:
        """Add a call."""
        self._open[call] = None

    def enter_again(self, call: Call) -> None:
        """Add a call that has left, but whose replies still matter."""
        self.enter(call)
        self._by_id.update(dict.fromkeys(call.ids, call))

    def name(self, call: Call, id_: str) -> None:
        """Register an id under which a call is sent."""
        call.ids.append(id_)
        self._by_id[id_] = call

    def forget_command(self, call: Call) -> None:
        """Forget a command's id, which is that of another gateway."""
        if call.command is not None:
            self._by_command.pop(call.command, None)
        call.forget_command()

    def leave(self, call: Call) -> None:
        """Remove a call; later replies to it are ignored."""
        self._open.pop(call, None)
        for id_ in call.ids:
            self._by_id.pop(id_, None)
        if call.command is not None:
            self._by_command.pop(call.command, None)

    def take(self, reply: Reply) -> bool:
        """Pass a reply to its call; return whether there is one.

        The command's id takes precedence: after a reconnection, replies may carry the id of an
        earlier attempt.
        """
        call = self._by_command.get(reply.command) if reply.command else None
        call = call or (self._by_id.get(reply.id) if reply.id else None)
        if call is None:
            return False
        if reply.command and reply.type == "execute":
            self._by_command.setdefault(reply.command, call)
        call.take(reply)
        if call.end.done():
            self.leave(call)
        return True

    def fail(self, error: Callable[[Call], RcpError]) -> None:
        """End all calls with an error."""
        for call in self.every():
            call.fail(error(call))
            self.leave(call)
