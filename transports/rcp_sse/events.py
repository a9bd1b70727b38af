"""GET /events and /status/events: a subscription as a stream that clients can resume."""

from __future__ import annotations

from collections.abc import Callable

import msgspec
from msgspec import Raw

from rcp_gateway.api import Connection, Hello, Principal, Sample, Wrap
from rcp_gateway.client_api import ClientApi
from rcp_kernel.clock import iso, now
from rcp_kernel.errors import Gap, RcpError
from rcp_kernel.values import Encoding
from rcp_kernel.wire import Reply, Request, encode_frame
from rcp_sse.config import SseConfig
from rcp_sse.journal import Journal, Journals, parse_event_id
from rcp_sse.options import MOST, Query, subscription
from rcp_sse.stream import Stream
from rcp_web.asgi import Receive, Scope, Send, bearer, header, peer_of
from rcp_web.query import read_query

__all__ = ["Events", "event"]

_NOTICE = b'{"type":"notice"'


def event(name: bytes, data: bytes, id_: bytes = b"") -> bytes:
    """Encode one event; encoded JSON has no line breaks, so `data` is one line."""
    return b"%bevent: %b\ndata: %b\n\n" % (b"id: %b\n" % id_ if id_ else b"", name, data)


class Events:
    """The handler."""

    def __init__(self, config: SseConfig, client_api: ClientApi) -> None:
        self._config = config
        self._client_api = client_api
        self._journals = Journals(config.journal)

    async def serve(
        self, scope: Scope, receive: Receive, send: Send, path: str | None = None
    ) -> None:
        """Stream until the client leaves or the subscription ends.

        :raises RcpError: refused; nothing was sent.
        """
        query = read_query(scope["query_string"], MOST)
        stream = Stream(scope, receive, send, self._config.comment)
        token = bearer(header(scope, b"authorization"))
        principal = await self._client_api.identify(token, peer_of(scope))
        # Connects and disconnects take turns: each may involve the feeds of a whole tree.
        turns, owner = self._client_api.turns, principal.identity
        await turns.wait(owner)
        with turns.spending():
            connection, lost = self._connect(scope, query, stream, principal)
        try:
            if not connection.session.subscriptions:
                await self._subscribe(connection, query, path)
            await self._run(connection, stream, lost)
            await turns.wait(owner)
        finally:
            with turns.spending():
                self._leave(connection)

    def _connect(
        self, scope: Scope, query: Query, stream: Stream, principal: Principal
    ) -> tuple[Connection, bool]:
        """Open a connection, resuming the client's last session if it still exists."""
        client_api = self._client_api
        tenant = query.get("tenant", [None])[0]
        named = header(scope, b"x-rcp-tenant")
        if tenant is None and named is not None:
            tenant = named.decode("latin-1")
        peer = peer_of(scope)
        connection = client_api.connect(
            principal, Encoding.JSON, stream.wake, tenant, peer, one_way=True, wraps=True
        )
        sent = header(scope, b"last-event-id")
        text = sent.decode("latin-1") if sent else query.get("last_event_id", [None])[0]
        last = parse_event_id(text)
        lost = False
        try:
            if last is None:
                client_api.hello(connection, Hello())
            else:
                lost = not self._return(connection, *last)
        except RcpError:
            connection.close()
            raise
        return connection, lost

    def _return(self, connection: Connection, session: str, number: int) -> bool:
        journal = self._journals.find(session)
        have = None if journal is None else journal.until(number)
        try:
            self._client_api.hello(connection, Hello(session=session, resume_from=have))
        except Gap:
            self._client_api.hello(connection, Hello())
            return False
        return have is not None

    async def _subscribe(self, connection: Connection, query: Query, path: str | None) -> None:
        first, body = subscription(query, path)
        id_ = query.get("id", [None])[0]
        request = Request(type="subscribe", path=first, id=id_, body=Raw(msgspec.json.encode(body)))
        reply = await self._client_api.request(connection.session, request)
        if reply.error is not None:
            raise Refusal(reply)

    async def _run(self, connection: Connection, stream: Stream, lost: bool) -> None:  # noqa: FBT001
        session = connection.session
        journal = self._journals.of(session.id)
        outbox = connection.outbox

        def told() -> None:
            stream.last = connection.expelled or not session.subscriptions

        wrap = _wrapper(journal, session.id, told)
        first = [_gap()] if lost else []

        def collect() -> list[bytes]:
            out = outbox.collect(wrap=wrap)
            if first:
                out.insert(0, first.pop())
            if not out:
                told()
            else:
                outbox.again()
            return out

        await stream.run(collect)

    def _leave(self, connection: Connection) -> None:
        session = connection.session
        connection.close(resumable=bool(session.subscriptions))  # after the end nobody resumes
        after = self._client_api.limits.session_ttl if session.resumable else 0.0
        self._journals.forget(session.id, after)

    def close(self) -> None:
        """Discard everything."""
        self._journals.close()


class Refusal(Exception):
    """A subscription that the gateway refused, with its reply."""

    def __init__(self, reply: Reply) -> None:
        super().__init__(reply.message)
        self.reply = reply


def _wrapper(journal: Journal, session: str, told: Callable[[], None]) -> Wrap:
    note = journal.note
    update = b"id: " + session.encode() + b":%d\nevent: update\ndata: %b\n\n"

    def wrap(data: bytes, sample: Sample | None) -> bytes:
        if sample is not None:
            return update % (note(sample.entry.path, sample.seq), data)
        told()  # a subscription that ends reports it
        return event(b"notice" if data.startswith(_NOTICE) else b"reply", data)

    return wrap


def _gap() -> bytes:
    facts = {
        "type": "notice",
        "code": "gap",
        "message": "the events after the last one received are no longer available; the stream "
        "continues live",
        "timestamp": iso(now()),
    }
    return event(b"notice", encode_frame(facts, b"", Encoding.JSON))
