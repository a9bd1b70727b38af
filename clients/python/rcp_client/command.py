"""A running command, as its caller sees it."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import AsyncGenerator, Callable
from typing import Any

import msgspec

from rcp_client.calls import Call
from rcp_client.channel import Channel
from rcp_client.errors import error_of, safely
from rcp_client.messages import Reply
from rcp_protocol.timeouts import timeout
from rcp_protocol.values import ValueType, value_type
from rcp_protocol.wire import FINAL

__all__ = ["CommandHandle", "Feedback"]

_KEPT = 1000  # unread feedback messages


class Feedback(msgspec.Struct, kw_only=True, omit_defaults=True):
    """A progress message of a running command."""

    status: str
    """`accepted`, `pending` or `in_progress`."""
    body: Any = None
    progress: float | None = None
    """Completed fraction, 0 to 1."""
    message: str | None = None
    timestamp: str | None = None
    command: str | None = None
    """The gateway's id of the command."""


class CommandHandle:
    """A command that the gateway has accepted; iterate over it for its feedback.

    The command continues when the handle is dropped, and when the connection is lost.
    """

    def __init__(
        self,
        channel: Channel,
        call: Call,
        *,
        limit: float | None,
        type_: Any = None,
        on_feedback: Callable[[Feedback], None] | None = None,
    ) -> None:
        self.path: str = call.envelope["path"]
        self.status = "sent"
        self.progress: float | None = None
        self._channel = channel
        self._call = call
        self._limit = limit
        self._type: ValueType | None = None if type_ is None else value_type(type_)
        self._on_feedback = on_feedback
        self._unread: deque[Feedback] = deque(maxlen=_KEPT)
        self._wake = asyncio.Event()
        call.listeners.append(self._heard)
        call.end.add_done_callback(lambda _: self._wake.set())

    @property
    def id(self) -> str | None:
        """The gateway's id of the command, once it has accepted it."""
        return self._call.command

    @property
    def done(self) -> bool:
        """Whether the final reply has arrived."""
        return self._call.end.done()

    def _heard(self, reply: Reply) -> None:
        self.status = reply.status
        self.path = reply.path or self.path
        if reply.progress is not None:
            self.progress = reply.progress
        if reply.status in FINAL:
            return
        feedback = Feedback(
            status=reply.status,
            body=reply.body,
            progress=reply.progress,
            message=reply.message,
            timestamp=reply.timestamp,
            command=reply.command,
        )
        self._unread.append(feedback)
        self._wake.set()
        safely(self._on_feedback, feedback)

    async def accepted(self, limit: float) -> None:
        """Wait at most `limit` seconds for the first reply.

        :raises RcpError: the command was refused, or no reply came.
        """
        call = self._call
        try:
            async with timeout(limit):
                await asyncio.shield(call.first)
        except TimeoutError:
            self._channel.calls.leave(call)
            raise self._channel.late(call, limit) from None
        if call.end.done():
            outcome = call.end.result()
            error = error_of(outcome) if isinstance(outcome, Reply) else outcome
            if error is not None and (error is outcome or error.status == "rejected"):
                raise error

    async def reply(self) -> Reply:
        """Wait for the final reply and return it.

        :raises RcpError: the command failed, was refused or cancelled, or the client gave up.
        """
        return await self._channel.finish(self._call, self._limit)

    async def result(self) -> Any:
        """Wait for the end and return the result.

        :raises RcpError: as for `reply`.
        """
        reply = await self.reply()
        return reply.body if self._type is None else self._type.convert(reply.body)

    async def __aiter__(self) -> AsyncGenerator[Feedback]:
        """Iterate over the feedback until the command ends; then see `result`."""
        while True:
            while self._unread:
                yield self._unread.popleft()
            if self.done:
                return
            self._wake.clear()
            await self._wake.wait()

    async def cancel(self) -> Reply:
        """Request cancellation; the robot is told to stop. `result` gives the outcome."""
        if self.id is None:
            await self.accepted(self._channel.settings.deadline)
        return await self._channel.ask({"type": "cancel", "command": self.id})

    def cancel_soon(self) -> None:
        """Cancel the command without waiting, on the next connection if there is none.

        What the gateway has not heard of is not sent any more.
        """
        call = self._call
        if self.done:
            return
        if self.id is not None:
            self._channel.later({"type": "cancel", "command": self.id})
        elif call.sent is None:
            self._channel.calls.leave(call)
        else:
            call.repeat = "never"
            call.listeners.append(self._cancel_now)
            self._channel.calls.enter_again(call)  # `finish` has removed it

    def _cancel_now(self, reply: Reply) -> None:
        if reply.status not in FINAL and self._cancel_now in self._call.listeners:
            self._call.listeners.remove(self._cancel_now)
            if reply.command is not None:
                self._channel.later({"type": "cancel", "command": reply.command})
