"""Requests under way: what was asked, under which ids, and whether it may be asked again."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from typing import Any, Literal

from rcp_client.messages import Reply
from rcp_protocol.errors import RcpError
from rcp_protocol.wire import FINAL

__all__ = ["Call", "Calls", "Repeat"]

Repeat = Literal["always", "keyed", "never"]
"""What a cut does to a request that was sent: it is sent again; sent again if its idempotency key
is still known to the gateway; or ended, because to do it twice or late would be wrong."""


class Call:
    """One request until its final reply."""

    __slots__ = (
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
        "repeat",
        "sent",
        "session",
        "started",
    )

    def __init__(self, envelope: dict[str, Any], repeat: Repeat, fixed: str | None = None) -> None:
        self.loop = asyncio.get_running_loop()
        self.envelope = envelope
        self.repeat: Repeat = repeat
        self.fixed = fixed
        """The id it always goes out under, where the id is more than a number."""
        self.link: object = None
        """The connection it was last sent on."""
        self.ids: list[str] = []
        """Every id it was sent under; replies to any of them are its own."""
        self.command: str | None = None
        """The gateway's id of the command it started."""
        self.session: str | None = None
        """The session that tells of the command, once it is accepted."""
        self.sent: int | None = None
        """When it first went out, ns since the epoch."""
        self.started = time.monotonic()
        self.first: asyncio.Future[None] = self.loop.create_future()
        """Done with the first reply, or the end."""
        self.end: asyncio.Future[Reply | RcpError] = self.loop.create_future()
        self.listeners: list[Callable[[Reply], None]] = []
        self._heard = ""

    def take(self, reply: Reply) -> None:
        """Take a reply in; one that was heard before is dropped."""
        if self.end.done():
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

    def fail(self, error: RcpError) -> None:
        """End it without a reply."""
        if not self.end.done():
            self.end.set_result(error)
        if not self.first.done():
            self.first.set_result(None)


class Calls:
    """Every request under way, by each of its ids and by its command."""

    def __init__(self) -> None:
        self._by_id: dict[str, Call] = {}
        self._by_command: dict[str, Call] = {}
        self._open: dict[Call, None] = {}

    def __len__(self) -> int:
        return len(self._open)

    def every(self) -> list[Call]:
        """List them in the order in which they began."""
        return list(self._open)

    def enter(self, call: Call) -> None:
        """Take a call in."""
        self._open[call] = None

    def name(self, call: Call, id_: str) -> None:
        """Note an id that a call goes out under."""
        call.ids.append(id_)
        self._by_id[id_] = call

    def leave(self, call: Call) -> None:
        """Let a call go; later replies to it are of no interest."""
        self._open.pop(call, None)
        for id_ in call.ids:
            self._by_id.pop(id_, None)
        if call.command is not None:
            self._by_command.pop(call.command, None)

    def take(self, reply: Reply) -> bool:
        """Hand a reply to its call; tell whether there is one.

        The command's id decides first: after a return, replies may bear the id of an earlier try.
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
        """End them all."""
        for call in self.every():
            call.fail(error(call))
            self.leave(call)
