"""Everything under `/rcp/v1` that is not a resource: envelopes, commands, catalogue, health."""

from __future__ import annotations

import hashlib
from typing import Any

import msgspec
from msgspec import Raw

from rcp_http.answers import BOOT, Answers, matches
from rcp_http.command_pages import Wanted, fill
from rcp_http.config import HttpConfig
from rcp_http.context import Context, Follower
from rcp_http.negotiate import body_encoding
from rcp_http.request import HttpRequest, count, flag
from rcp_http.schema_page import written
from rcp_kernel.api import Session
from rcp_kernel.api.pages import Parts, room
from rcp_kernel.asgi import Receive, Send, respond
from rcp_kernel.client_api import ClientApi
from rcp_kernel.clock import iso, now
from rcp_kernel.errors import RcpError, UnknownPath, UnsupportedOperation
from rcp_kernel.values import Encoding
from rcp_kernel.wire import Reply, Request, decode_request, encode_reply, failure, peek_header

__all__ = ["Calls"]

_STREAMS = ("subscribe", "unsubscribe", "hello")


class Calls:
    """The handlers."""

    def __init__(
        self, client_api: ClientApi, config: HttpConfig, answers: Answers, context: Context
    ) -> None:
        self._client_api = client_api
        self._config = config
        self._answers = answers
        self._context = context

    async def _ask(
        self, asked: HttpRequest, session: Session, request: Request, send: Send
    ) -> None:
        follower = Follower(session)
        self._client_api.submit(session, request, follower)
        await self._answers.reply(send, asked, await follower.final())

    # -- envelopes -----------------------------------------------------------------------------

    async def messages(
        self, asked: HttpRequest, session: Session, receive: Receive, send: Send
    ) -> None:
        """POST /messages: any one envelope."""
        asked.allow()
        client_api = self._client_api
        limit = client_api.longest(session.principal)
        data = await asked.body(receive, limit, self._config.body_timeout)
        if len(data) > client_api.limits.unproved:
            client_api.check_pace(session)
        encoding = body_encoding(asked.found.get("content_type", b"")) or Encoding.JSON
        if "accept" not in asked.found or asked.found["accept"] == b"*/*":
            asked.encoding = encoding
        try:
            request = decode_request(data, encoding)
            if request.type in _STREAMS:
                raise UnsupportedOperation(
                    f"`{request.type}` is not available over HTTP",
                    remedy="Use the WebSocket at /rcp/v1/ws, or GET /rcp/v1/events.",
                )
        except RcpError as error:
            type_, id_ = peek_header(data, encoding)
            self._client_api.refused(type_, error.code)
            await self._answers.reply(send, asked, failure(error, type_, id_))
            return
        if request.type != "execute":
            await self._ask(asked, session, request, send)
            return
        await self._context.run(asked, session, request, send, self._patience(asked, request))

    def _patience(self, asked: HttpRequest, request: Request) -> float | None:
        """How long an execute may hold its answer back: a service is a short call, an action not."""
        if asked.at_once:
            return None
        if asked.wait is not None:
            return asked.wait
        if request.deadline is not None:
            return request.deadline + 1.0  # the gateway ends the command in time
        service = request.path is not None and "/service/" in request.path
        return self._client_api.limits.deadline if service else None

    # -- commands ------------------------------------------------------------------------------

    async def commands(self, asked: HttpRequest, session: Session, send: Send) -> None:
        """GET /commands: the newest first, without their histories."""
        asked.allow("status", "path", "limit", "cursor")
        client_api = self._client_api
        page, longest = Parts(asked.encoding), room(client_api.limits.message)
        work = fill(page, Wanted.read(asked), client_api.commands(session), longest)
        cursor = await client_api.turns.finish(session.principal.identity, work)
        await self._plain(asked, send, page, "/system/commands", cursor)

    async def command(self, asked: HttpRequest, session: Session, id_: str, send: Send) -> None:
        """GET /commands/<id>: the state, with feedback and history."""
        asked.allow()
        body = self._client_api.command(session, id_).plain()
        await self._plain(asked, send, body, "/system/commands")

    async def cancel(self, asked: HttpRequest, session: Session, id_: str, send: Send) -> None:
        """DELETE /commands/<id>: have it cancelled."""
        asked.allow()
        request = asked.request("cancel")
        request.command = id_
        await self._ask(asked, session, request, send)

    async def _plain(
        self, asked: HttpRequest, send: Send, body: Any, path: str | None, cursor: str | None = None
    ) -> None:
        request = asked.request("read")
        reply = Reply(
            type="read",
            id=request.id,
            path=path,
            body=body,
            truncated=cursor is not None,
            cursor=cursor,
            timestamp=iso(now()),
            custom=request.custom,
        )
        await self._answers.reply(send, asked, reply)

    # -- catalogue -----------------------------------------------------------------------------

    async def discovery(self, asked: HttpRequest, session: Session, send: Send) -> None:
        """GET /discovery: the catalogue."""
        asked.allow("path", "kind", "op", "q", "limit", "cursor", "schemas")
        etag = self._etag(asked, session)
        if matches(asked, etag):
            await self._answers.unchanged(send, etag)
            return
        query: dict[str, Any] = {}
        for name in ("kind", "op", "q", "cursor"):
            if (text := asked.one(name)) is not None:
                query[name] = text
        if "limit" in asked.query:
            query["limit"] = count("limit", asked.one("limit") or "")
        if (text := asked.one("schemas")) is not None:
            query["schemas"] = flag("schemas", text)
        request = asked.request("discover", asked.one("path"))
        request.body = Raw(msgspec.json.encode(query))
        follower = Follower(session)
        self._client_api.submit(session, request, follower)
        reply = await follower.final()
        if reply.error is not None:
            await self._answers.reply(send, asked, reply)
            return
        data = encode_reply(reply, asked.encoding)
        await self._answers.body(send, asked, 200, data, [], etag)

    def _etag(self, asked: HttpRequest, session: Session) -> bytes:
        """Make the validator of what a session sees of the tree, as it was asked for."""
        seen = (
            session.principal.grants,
            session.tenant,
            sorted(asked.query.items()),
            id(session.rights),
        )
        digest = hashlib.sha256(repr(seen).encode()).hexdigest()[:16].encode()
        return b'W/"%b.g%d.%b"' % (BOOT, self._client_api.generation(session), digest)

    async def status(self, asked: HttpRequest, session: Session, send: Send) -> None:
        """GET /status: the health report."""
        asked.allow()
        await self._ask(asked, session, asked.request("status"), send)

    async def schemas(self, asked: HttpRequest, session: Session, send: Send) -> None:
        """GET /schemas: every schema of what the caller may see, by id."""
        asked.allow()
        work = written(self._client_api.schemas(session), asked.encoding)
        page = await self._client_api.turns.finish(session.principal.identity, work)
        await self._plain(asked, send, page, None)

    async def schema(self, asked: HttpRequest, session: Session, id_: str, send: Send) -> None:
        """GET /schemas/<id>: one; bare for those who accept `application/schema+json`."""
        asked.allow()
        work = self._client_api.schemas(session)
        schemas = await self._client_api.turns.finish(session.principal.identity, work)
        found = schemas.get(id_.removeprefix("rcp:schema:"))
        if found is None:
            raise UnknownPath(f"unknown schema '{id_[:80]}'", remedy="List /rcp/v1/schemas.")
        if b"application/schema+json" in asked.found.get("accept", b""):
            await respond(send, 200, msgspec.json.encode(found), b"application/schema+json")
            return
        await self._plain(asked, send, found, None)
