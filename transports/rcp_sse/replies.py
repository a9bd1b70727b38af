"""GET /commands/<id>/events: past and future replies of a command, until its final status."""

from __future__ import annotations

from collections import deque

from rcp_gateway.client_api import ClientApi
from rcp_kernel.errors import RcpError
from rcp_kernel.values import Encoding
from rcp_kernel.wire import Reply, encode_reply, failure
from rcp_sse.config import SseConfig
from rcp_sse.events import event
from rcp_sse.journal import parse_event_id
from rcp_sse.options import MOST
from rcp_sse.stream import Stream
from rcp_web.asgi import Receive, Scope, Send, header, session_of
from rcp_web.query import read_query

__all__ = ["Replies"]


class Replies:
    """The handler."""

    def __init__(self, config: SseConfig, client_api: ClientApi) -> None:
        self._config = config
        self._client_api = client_api

    async def serve(self, scope: Scope, receive: Receive, send: Send, id_: str) -> None:
        """Stream the replies, without those that the client has (`Last-Event-ID`).

        :raises UnknownPath: there is no such command, or the caller may not see it.
        """
        query = read_query(scope["query_string"], MOST)
        session = await session_of(self._client_api, scope, query.get("tenant", [None])[0])
        command = self._client_api.command(session, id_)
        sent = header(scope, b"last-event-id")
        last = parse_event_id(sent.decode("latin-1") if sent else None)
        skip = last[1] if last is not None and last[0] == id_ else 0
        stream = Stream(scope, receive, send, self._config.comment)
        # A pruned history has fewer records than were sent: then continue after the last one.
        records = command.history[skip:] or command.history[-1:]
        waiting: deque[Reply] = deque(command.reply(record) for record in records)
        told = skip

        def follow(reply: Reply) -> None:
            if waiting and not reply.final and waiting[-1].status == "in_progress":
                waiting.pop()  # for a slow client, newer feedback replaces older
            waiting.append(reply)
            stream.wake()

        def collect() -> list[bytes]:
            nonlocal told
            out: list[bytes] = []
            while waiting:
                reply = waiting.popleft()
                told += 1
                stream.last = reply.final
                data = encode_reply(reply, Encoding.JSON)
                out.append(event(b"reply", data, f"{id_}:{told}".encode()))
            return out

        def lost(error: RcpError) -> None:
            waiting.append(failure(error, "execute", None, command.path, command=command.id))
            stream.wake()

        stop = self._client_api.follow(command, follow)
        keep = self._client_api.until_end(session, lost)
        try:
            await stream.run(collect)
        finally:
            stop()
            keep()
