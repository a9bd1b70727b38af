"""`/context/<path>`: read, write and execute resources."""

from __future__ import annotations

import asyncio
from time import perf_counter

import msgspec
from msgspec import Raw

from rcp_gateway.api import Query, Session
from rcp_gateway.client_api import ClientApi
from rcp_http.answers import Answers, methods_of
from rcp_http.config import HttpConfig
from rcp_http.downloads import HISTORY, history_options, recordings, send_download
from rcp_http.octets import bytes_of, send_octets
from rcp_http.request import HttpRequest, count, flag
from rcp_kernel.clock import iso, now
from rcp_kernel.errors import BadRequest, RcpError, UnknownPath
from rcp_kernel.values import Encoding
from rcp_kernel.wire import Reply, Request
from rcp_web.asgi import Receive, Send, respond

__all__ = ["Context", "Follower"]

_JSON = Encoding.JSON
_HISTORIC = frozenset(("from", "to", "every"))


class Follower:
    """The replies to one request: the latest, and futures for the others."""

    __slots__ = ("_final", "_first", "_session", "latest")

    def __init__(self, session: Session) -> None:
        self._session = session
        self.latest: Reply | None = None
        self._first: asyncio.Future[Reply] | None = None
        self._final: asyncio.Future[Reply] | None = None

    def __call__(self, reply: Reply) -> None:
        """Handle the next reply."""
        self.latest = reply
        if self._first is None and self._final is None:
            return
        for waiter in (self._first, self._final if reply.final else None):
            if waiter is not None and not waiter.done():
                waiter.set_result(reply)

    async def first(self) -> Reply:
        """Return a reply as soon as there is one.

        :raises TokenExpired: the caller's credentials expired while it waited.
        """
        if self.latest is None:
            self._first = asyncio.get_running_loop().create_future()
            await self._wait(self._first, None)
            return self._first.result()
        return self.latest

    async def final(self, patience: float | None = None) -> Reply:
        """Return the final reply, or the latest after `patience` seconds.

        :raises TokenExpired: see `first`.
        """
        if self.latest is None or not self.latest.final:
            self._final = asyncio.get_running_loop().create_future()
            await self._wait(self._final, patience)
            if self._final.done():
                return self._final.result()
        return await self.first()

    async def _wait(self, waiter: asyncio.Future[Reply], patience: float | None) -> None:
        def lost(error: RcpError) -> None:
            if not waiter.done():
                waiter.set_exception(error)

        self._session.endings.add(lost)
        try:
            await asyncio.wait((waiter,), timeout=patience)
        finally:
            self._session.endings.discard(lost)


class Context:
    """The handlers of `/context/<path>`."""

    def __init__(self, client_api: ClientApi, config: HttpConfig, answers: Answers) -> None:
        self._client_api = client_api
        self._config = config
        self._answers = answers
        self._turns = client_api.turns

    async def read(
        self, http: HttpRequest, session: Session, path: str, receive: Receive, send: Send
    ) -> None:
        """GET: the value."""
        if not http.query.keys().isdisjoint(_HISTORIC):
            await self._history(http, session, path, receive, send)
            return
        if http.query:
            http.allow("fields", "fresh", "frame", "q", "limit", "cursor")
        request = http.request("read", path)
        if http.query:
            self._options(http, request)
        elif http.encoding is _JSON and not http.octets and "range" not in http.headers:
            began = perf_counter()
            # Encoding a long value takes milliseconds.
            prompt = None if self._turns.over else self._client_api.read_at_once(session, request)
            if prompt is not None:
                await self._answers.prompt(send, http, path, prompt, began)
                return
        follower = Follower(session)
        self._client_api.submit(session, request, follower)
        reply = follower.latest
        if reply is None or not reply.final:
            reply = await follower.final()
        if self._turns.over:  # as above
            await self._turns.wait(session.principal.identity)
        if (http.octets or "range" in http.headers) and reply.error is None:
            data = bytes_of(reply, native=http.octets)
            if data is not None:
                await send_octets(send, http, reply, data)
                return
            if http.octets and b"json" not in http.headers["accept"]:
                raise BadRequest(
                    f"the value of {reply.path} is not bytes",
                    path=reply.path,
                    remedy="Accept application/json, or select a field of bytes with `fields`.",
                )
        await self._answers.reply(send, http, reply)

    async def _history(
        self, http: HttpRequest, session: Session, path: str, receive: Receive, send: Send
    ) -> None:
        """Answer with what was recorded."""
        http.allow(*HISTORY)
        self._client_api.charge(session)
        found, wanted = recordings(self._client_api), history_options(http, path)
        format_ = http.one("format") or "json"
        if format_ != "json":
            table = await found.table(session, wanted, format_)
            await send_download(receive, send, http, session, table)
            return
        page = await found.page(session, wanted, http.encoding)
        request = http.request("read", path)
        reply = Reply(
            type="read",
            id=request.id,
            path=page.path,
            body=page.body,
            truncated=page.cursor is not None,
            cursor=page.cursor,
            timestamp=iso(now()),
            custom=request.custom,
        )
        await self._answers.reply(send, http, reply)

    def _options(self, http: HttpRequest, request: Request) -> None:
        options: dict[str, object] = {}
        if "fields" in http.query:
            names = ",".join(http.query["fields"]).split(",")
            options["fields"] = [name for name in names if name]
        if (fresh := http.one("fresh")) is not None:
            options["fresh"] = flag("fresh", fresh)
        if (limit := http.one("limit")) is not None:
            options["limit"] = count("limit", limit)
        for name in ("frame", "q", "cursor"):
            if (text := http.one(name)) is not None:
                options[name] = text
        if options:
            request.body = Raw(msgspec.json.encode(options))

    async def write(
        self, http: HttpRequest, session: Session, path: str, receive: Receive, send: Send
    ) -> None:
        """PUT: the body is the value."""
        http.allow()
        request = http.request("write", path)
        await self._take_body(http, session, request, receive)
        # The path is checked first, so that the error is the same with a body and without.
        if not request.body and "PUT" in await self.methods(session, path):
            raise BadRequest("the request has no body", remedy="Send the value as the body.")
        follower = Follower(session)
        self._client_api.submit(session, request, follower)
        await self._answers.reply(send, http, await follower.final())

    async def execute(
        self, http: HttpRequest, session: Session, path: str, receive: Receive, send: Send
    ) -> None:
        """POST: the body is the input; responds at once unless the client asks to wait."""
        http.allow()
        request = http.request("execute", path)
        await self._take_body(http, session, request, receive)
        wait = http.wait
        await self.run(http, session, request, send, wait)

    async def run(
        self, http: HttpRequest, session: Session, request: Request, send: Send, wait: float | None
    ) -> None:
        """Submit an execute and respond with its first reply, or its last within `wait` seconds."""
        follower = Follower(session)
        self._client_api.submit(session, request, follower)
        reply = await follower.first()
        headers: list[tuple[bytes, bytes]] = []
        if wait and not reply.final:
            limit = min(wait, self._config.max_wait)
            headers.append((b"preference-applied", b"wait=%d" % limit))
            reply = await follower.final(limit)
        await self._answers.reply(send, http, reply, headers)

    async def _take_body(
        self, http: HttpRequest, session: Session, request: Request, receive: Receive
    ) -> None:
        http.check_unconditional()
        client_api = self._client_api
        limit = client_api.longest(session.principal)
        owner = session.principal.identity
        data = await http.body(receive, limit, self._config.body_timeout, self._turns, owner)
        if len(data) > client_api.limits.unproved:
            client_api.check_pace(session)
        with self._turns.spending():
            http.put_body(request, data)

    async def options(self, http: HttpRequest, session: Session, path: str, send: Send) -> None:
        """OPTIONS: the methods of the resource."""
        methods = await self.methods(session, path)
        await respond(send, 204, b"", headers=[(b"allow", ", ".join(methods).encode())])

    async def methods(self, session: Session, path: str) -> list[str]:
        """Return the methods that the caller may use on a resource.

        :raises UnknownPath: it does not exist.
        :raises RcpError: the path is invalid, or a quota is exceeded.
        """
        client_api = self._client_api
        client_api.charge(session)
        work = client_api.discover(session, path, Query(limit=1, schemas=False))
        page = await client_api.turns.finish(session.principal.identity, work)
        if not page["resources"]:
            raise UnknownPath(f"no resource {path}", path=path)
        return methods_of(page["resources"][0]["operations"])
