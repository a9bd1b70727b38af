"""`batch`: several envelopes in one, handled side by side, each with its one final reply."""

from __future__ import annotations

import asyncio
from collections.abc import Generator, Hashable
from copy import copy
from functools import lru_cache, partial
from itertools import takewhile

import msgspec
from msgspec import Raw

from rcp_kernel.clock import iso, now
from rcp_kernel.config.settings import Settings
from rcp_kernel.contract.internal_errors import to_internal_error
from rcp_kernel.contract.paths import ESTOP
from rcp_kernel.errors import BadRequest, InvalidValue, PayloadTooLarge, RcpError
from rcp_kernel.safety.estop import EstopRequest
from rcp_kernel.sessions.session import Answer, Handler, Session
from rcp_kernel.values import Encoding, value_type
from rcp_kernel.wire import (
    NO_BODY,
    Reply,
    Request,
    decode_request,
    encode_body,
    failure,
    fields_of,
    peek_header,
)
from rcp_requests.inflight import InFlight
from rcp_requests.object_list import EncodedBody, ObjectList, expected
from rcp_requests.pages import MOST_BATCH, shared_room
from rcp_scheduling.turns import Turns

__all__ = ["BatchHandler"]

_LOOKS = frozenset(("read", "discover", "status"))
"""Requests that change nothing and can be repeated individually."""
_ESTOP_INPUT = value_type(EstopRequest | None)


class BatchHandler:
    """The handler of `batch`."""

    def __init__(
        self,
        handle: Handler,
        inflight: InFlight,
        turns: Turns,
        settings: Settings,
        loop: asyncio.AbstractEventLoop,
    ) -> None:
        self._handle = handle
        self._inflight = inflight
        self._turns = turns
        self._settings = settings
        self._loop = loop

    def batch(self, session: Session, request: Request, answer: Answer) -> Reply | None:
        """Handle every envelope of a list; the reply lists theirs in the same order."""
        parts = _parts(request, self._settings.limits.batch)
        whole: asyncio.Future[None] = self._loop.create_future()
        room = min(MOST_BATCH, self._settings.limits.message)
        batch = _Batch(
            self._handle, session, parts, request.encoding, expected(session, request), room, whole
        )
        timeout = request.deadline or self._settings.limits.deadline

        def done(replies: ObjectList) -> Reply:
            return Reply(type="batch", id=request.id, body=replies, timestamp=iso(now()))

        owner = session.principal.identity
        self._inflight.answer_later(
            session, request, answer, batch.run(self._turns, owner), done, timeout, None
        )
        return None


class _Batch:
    """One batch: its parts and their replies."""

    def __init__(
        self,
        handle: Handler,
        session: Session,
        parts: list[bytes],
        encoding: Encoding,
        answer: Encoding,
        room: int,
        whole: asyncio.Future[None],
    ) -> None:
        self._handle = handle
        self._session = session
        self._parts = parts
        self._encoding = encoding
        self._answer = answer
        self._most = self._room = room
        self._replies: dict[int, Reply] = {}
        self._whole = whole

    async def run(self, turns: Turns, owner: Hashable) -> ObjectList:
        """Handle all parts; return their replies."""
        if self._parts:
            turns.run(owner, self._begin())
            await self._whole
        replies = ObjectList(self._answer)
        for number in range(len(self._parts)):
            await turns.wait(owner)
            with turns.spending():
                reply = self._replies.pop(number)
                replies.add(fields_of(reply), reply.body)
        return replies

    def _begin(self) -> Generator[None]:
        """Handle the parts in order, but an e-stop first."""
        requests: list[tuple[int, Request]] = []
        for number, data in enumerate(self._parts):
            request = self._read(number, data)
            if request is not None:
                requests.append((number, request))
            yield
        for number, request in sorted(requests, key=lambda one: not _is_stop(one[1])):
            if self._whole.done():  # its deadline has passed
                return
            # Whatever of it is handled later takes this along.
            with shared_room(len(self._parts)):
                answer = partial(self._settle, number)
                self._handle(self._session, request, answer)
            yield

    def _read(self, number: int, data: bytes) -> Request | None:
        try:
            request = decode_request(data, self._encoding)
            if request.type in ("batch", "hello"):
                raise BadRequest(f"`{request.type}` is not allowed in a batch")
        except RcpError as error:
            self._settle(number, failure(error, *peek_header(data, self._encoding)))
            return None
        return request

    def _settle(self, number: int, reply: Reply) -> None:
        """Keep a final reply, written as far as there is room for it."""
        if not reply.final or number in self._replies:
            return
        reply = copy(reply)  # others may have it too
        try:
            data = encode_body(reply.body, self._answer)
        except Exception as error:
            internal = to_internal_error(error, path=reply.path)
            failed = failure(internal, reply.type, reply.id, reply.path, command=reply.command)
            failed.custom = reply.custom
            reply, data = failed, b""
        # The first one is included, however long it is.
        if len(data) > self._room and self._room < self._most:
            reply = _without_body(reply, len(data), self._most)
        else:
            self._room -= len(data)
            if data:
                reply.body = EncodedBody(reply.body, self._answer, data)
        self._replies[number] = reply
        if len(self._replies) == len(self._parts) and not self._whole.done():
            self._whole.set_result(None)


def _is_stop(request: Request) -> bool:
    """Tell an e-stop from its reset, which keeps its place."""
    if request.type != "execute" or request.path != ESTOP:
        return False
    try:
        stop = request.decode_body(_ESTOP_INPUT, "input")
    except RcpError:  # it will be refused
        return False
    return stop is None or not stop.reset


def _without_body(reply: Reply, size: int, limit: int) -> Reply:
    """Return the reply of a part whose body does not fit."""
    if reply.type not in _LOOKS:  # it has happened
        reply.body, reply.truncated = NO_BODY, True
        return reply
    error = PayloadTooLarge(
        f"the reply has {size} bytes and does not fit into the reply of this batch",
        path=reply.path,
        remedy="Send this request on its own, not in a batch.",
        details={"limit": limit},
    )
    refusal = failure(error, reply.type, reply.id, reply.path)
    refusal.custom = reply.custom
    return refusal


def _parts(request: Request, limit: int) -> list[bytes]:
    """Split a batch into its envelopes; reading stops at the limit.

    :raises InvalidValue: it is not a list.
    :raises BadRequest: it has too many parts.
    """
    module = msgspec.json if request.encoding is Encoding.JSON else msgspec.msgpack
    try:
        found = module.decode(request.body or b"null", type=_places(limit))
    except (msgspec.DecodeError, RecursionError) as error:
        if "at most length" in str(error):
            raise BadRequest(f"a batch has at most {limit} envelopes") from None
        raise InvalidValue(f"batch: {error}", details={"pointer": ""}) from None
    parts = (bytes(part) for part in msgspec.structs.astuple(found))
    return list(takewhile(bool, parts))


@lru_cache(maxsize=4)
def _places(limit: int) -> type[msgspec.Struct]:
    """Create the type of a list with limited length, whose items stay encoded."""
    fields = [(f"part_{number}", Raw, NO_BODY) for number in range(limit)]
    return msgspec.defstruct("Batch", fields, array_like=True, forbid_unknown_fields=True)
