"""Requests of one client to the gateway, and the tasks that wait for their replies."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any

import msgspec
import structlog

from rcp_gateway.api import LONG_MESSAGE, Connection, check_structure
from rcp_gateway.client_api import ClientApi
from rcp_kernel.errors import BadRequest, InvalidValue, PayloadTooLarge, RcpError
from rcp_kernel.model import NativeType
from rcp_kernel.values import Encoding
from rcp_kernel.wire import NO_BODY, Reply, Request

__all__ = ["UNREAD", "Requests", "body_of"]

UNREAD = "the client has too much unread data"
_TASKS = 1024
log = structlog.get_logger("rcp.foxglove")


class Requests:
    """The requests of one client; its tasks end with it."""

    def __init__(self, client_api: ClientApi, connection: Connection) -> None:
        self.client_api = client_api
        self._connection = connection
        self._tasks: set[asyncio.Task[None]] = set()
        self.on_room: Callable[[], None] = lambda: None
        """Called when `crowded` is over."""

    @property
    def crowded(self) -> bool:
        """Whether no more tasks should begin for now."""
        return len(self._tasks) >= _TASKS

    def begin(self, work: Coroutine[Any, Any, None]) -> None:
        """Do work beside the client's further messages."""
        task = self.client_api.loop.create_task(_contained(work))
        self._tasks.add(task)
        task.add_done_callback(self._done)

    def _done(self, task: asyncio.Task[None]) -> None:
        crowded = self.crowded
        self._tasks.discard(task)
        if crowded:
            self.on_room()

    def reply(self, data: bytes) -> bool:
        """Queue what the client has asked for; return False if too much is unread."""
        outbox = self._connection.outbox
        if outbox.backlog.refuses(len(data)):
            return False
        outbox.put(data)
        return True

    async def request(self, request: Request) -> Reply:
        """Send a request; a refusal is the reply's error."""
        return await self.client_api.request(self._connection.session, request)

    async def check(self, data: bytes) -> None:
        """Check in steps how many values a long JSON text has.

        :raises RcpError: too many, or it is nested too deep.
        """
        if len(data) > LONG_MESSAGE:
            most = self.client_api.limits.values
            owner = self._connection.session.principal.identity
            steps = check_structure(data, Encoding.JSON, most)
            await self.client_api.turns.finish(owner, steps)

    def close(self) -> None:
        """End all tasks; what a robot was asked to do goes on as for any lost client."""
        for task in list(self._tasks):
            task.cancel()


async def body_of(
    requests: Requests, encoding: str, payload: bytes, native: NativeType | None
) -> tuple[msgspec.Raw, Encoding]:
    """Return a payload as the body of a request, with its encoding.

    :raises RcpError: it is not in that encoding, or its encoding is not known here.
    """
    if encoding == "json":
        payload = payload.strip()
        await requests.check(payload)
        return (msgspec.Raw(payload) if payload else NO_BODY), Encoding.JSON
    if native is None or native.decode is None or encoding != native.encoding:
        known = "" if native is None or native.decode is None else f" or {native.encoding}"
        raise BadRequest(f"the encoding {encoding[:40]!r} is not known", remedy=f"Use json{known}.")
    most = requests.client_api.limits.values  # each has a byte at least, and it is one step
    if len(payload) > most:
        raise PayloadTooLarge(
            f"a command of {len(payload)} bytes in {encoding} is too long: the limit is {most}",
            remedy="Send it as json, or raise `limits.values` of the gateway.",
        )
    try:
        value = native.decode(payload)
    except Exception as error:
        raise InvalidValue(
            f"the bytes are not a {native.name}: {str(error)[:200]}",
            remedy=f"Encode the message as {native.encoding} of {native.name}.",
        ) from error
    return msgspec.Raw(msgspec.msgpack.encode(value)), Encoding.MSGPACK


async def _contained(work: Coroutine[Any, Any, None]) -> None:
    try:
        await work
    except RcpError as error:
        log.info("refused", code=error.code, reason=error.message)
    except Exception:
        log.exception("task_failed")
