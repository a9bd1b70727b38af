"""`batch`: several envelopes in one, handled side by side, each with its one final reply."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any

import msgspec

from rcp_kernel._plain import is_map
from rcp_kernel.clients.session import Answer, Session
from rcp_kernel.clock import iso, now
from rcp_kernel.errors import BadRequest, RcpError
from rcp_kernel.operations.pages import shared_room
from rcp_kernel.operations.pending import crash
from rcp_kernel.values import Encoding, value_type
from rcp_kernel.wire import NO_BODY, Reply, Request, decode_request, failure

if TYPE_CHECKING:
    from rcp_kernel.gateway import Gateway

__all__ = ["Batching", "plain_request"]

_BATCH = value_type(list[Any])


class Batching:
    """The handler of `batch`."""

    def __init__(self, gateway: Gateway) -> None:
        self._gateway = gateway

    def batch(self, session: Session, request: Request, answer: Answer) -> Reply | None:
        """Handle every envelope of a list at once; the reply lists theirs in the same order."""
        gateway = self._gateway
        parts = request.decode_body(_BATCH, "batch")
        if len(parts) > gateway.limits.batch:
            raise BadRequest(f"a batch holds at most {gateway.limits.batch} envelopes")
        work = self._do_batch(session, parts)
        timeout = request.deadline or gateway.limits.deadline

        def done(replies: list[Reply]) -> Reply:
            body = [_as_plain(reply) for reply in replies]
            return Reply(type="batch", id=request.id, body=body, timestamp=iso(now()))

        gateway.later(session, request, answer, work, done, timeout, None)
        return None

    async def _do_batch(self, session: Session, parts: list[Any]) -> list[Reply]:
        # Each part begins in a task of its own, which takes over how much room there is.
        with shared_room(len(parts)):
            return await asyncio.gather(*(self._do_part(session, part) for part in parts))

    async def _do_part(self, session: Session, part: Any) -> Reply:
        final: asyncio.Future[Reply] = self._gateway.loop.create_future()

        def answer(reply: Reply) -> None:
            if reply.final and not final.done():
                final.set_result(reply)

        type_ = part.get("type", "error") if is_map(part) else "error"
        id_ = part.get("id") if is_map(part) else None
        try:
            request = plain_request(part)
            if request.type in ("batch", "hello"):
                raise BadRequest(f"`{request.type}` cannot stand in a batch")
        except RcpError as error:
            return failure(error, str(type_), id_ if isinstance(id_, str) else None)
        self._gateway.handle(session, request, answer)
        return await final


def plain_request(part: Any) -> Request:
    """Read a request envelope that is plain data already: a part of a batch, an adapter's call.

    :raises BadRequest: as `wire.decode_request` does.
    """
    try:
        data = msgspec.msgpack.encode(part)
    except (TypeError, OverflowError, RecursionError) as error:
        raise BadRequest(f"not an envelope: {error}") from None
    return decode_request(data, Encoding.MSGPACK)


def _as_plain(reply: Reply) -> dict[str, Any]:
    """Write a reply as an item of the batch's body; a value that is none fails alone."""
    try:
        return _written(reply)
    except Exception as error:
        told = crash(error, path=reply.path)
        failed = failure(told, reply.type, reply.id, reply.path, command=reply.command)
        failed.custom = reply.custom
        return _written(failed)


def _written(reply: Reply) -> dict[str, Any]:
    out = {
        name: getattr(reply, name)
        for name in reply.__struct_fields__
        if name not in ("custom", "body") and getattr(reply, name) not in (None, False)
    }
    if reply.body is not NO_BODY:
        body = reply.body
        out["body"] = body.value if hasattr(body, "value") else body
    return out | (reply.custom or {})
