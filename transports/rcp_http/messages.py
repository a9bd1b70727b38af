"""`/messages`: any single envelope by POST."""

from __future__ import annotations

from rcp_gateway.api import Session
from rcp_gateway.client_api import ClientApi
from rcp_http.answers import Answers
from rcp_http.config import HttpConfig
from rcp_http.context import Context, Follower
from rcp_http.negotiate import body_encoding
from rcp_http.request import HttpRequest
from rcp_kernel.errors import RcpError, UnsupportedOperation
from rcp_kernel.values import Encoding
from rcp_kernel.wire import Request, decode_request, failure, peek_header
from rcp_web.asgi import Receive, Send

__all__ = ["Messages"]

_STREAMS = ("subscribe", "unsubscribe", "hello")


class Messages:
    """The handler."""

    def __init__(
        self, client_api: ClientApi, config: HttpConfig, answers: Answers, context: Context
    ) -> None:
        self._client_api = client_api
        self._config = config
        self._answers = answers
        self._context = context

    async def post(self, http: HttpRequest, session: Session, receive: Receive, send: Send) -> None:
        """POST: the body is an envelope."""
        http.allow()
        client_api = self._client_api
        limit = client_api.longest(session.principal)
        turns, owner = client_api.turns, session.principal.identity
        data = await http.body(receive, limit, self._config.body_timeout, turns, owner)
        if len(data) > client_api.limits.unproved:
            client_api.check_pace(session)
        encoding = body_encoding(http.headers.get("content_type", b"")) or Encoding.JSON
        if "accept" not in http.headers or http.headers["accept"] == b"*/*":
            http.encoding = encoding
        try:
            with turns.spending():
                request = decode_request(data, encoding)
            if request.type in _STREAMS:
                raise UnsupportedOperation(
                    f"`{request.type}` is not available over HTTP",
                    remedy="Use the WebSocket at /rcp/v1/ws, or GET /rcp/v1/events.",
                )
        except RcpError as error:
            type_, id_ = peek_header(data, encoding)
            client_api.refused(type_, error.code)
            await self._answers.reply(send, http, failure(error, type_, id_))
            return
        if request.type != "execute":
            follower = Follower(session)
            client_api.submit(session, request, follower)
            await self._answers.reply(send, http, await follower.final())
            return
        await self._context.run(http, session, request, send, self._patience(http, request))

    def _patience(self, http: HttpRequest, request: Request) -> float | None:
        """Return how long an execute waits for its result: a service is a short call, an action not."""
        if http.at_once:
            return None
        if http.wait is not None:
            return http.wait
        if request.deadline is not None:
            return request.deadline + 1.0  # the gateway ends the command in time
        service = request.path is not None and "/service/" in request.path
        return self._client_api.limits.deadline if service else None
