"""A request that a controller serves: its head, its caller and its response."""

from __future__ import annotations

from typing import Any

from litestar.types import ASGIApp

from rcp_gateway.api import Session
from rcp_gateway.client_api import ClientApi
from rcp_http.answers import Answers
from rcp_http.context import Follower
from rcp_http.downloads import send_download
from rcp_http.request import HttpRequest
from rcp_kernel.clock import iso, now
from rcp_kernel.wire import Reply, Request
from rcp_web.downloads import Download

__all__ = ["Call"]


class Call:
    """The request, in one record: Litestar starts a task per dependency."""

    def __init__(
        self, client_api: ClientApi, answers: Answers, http: HttpRequest, session: Session
    ) -> None:
        self.client_api = client_api
        self.http = http
        self.session = session
        self._answers = answers

    async def submit(self, request: Request) -> Reply:
        """Return the final reply to an envelope."""
        follower = Follower(self.session)
        self.client_api.submit(self.session, request, follower)
        return await follower.final()

    def reply(self, reply: Reply) -> ASGIApp:
        """Answer with an envelope."""

        async def answer(_scope: Any, _receive: Any, send: Any) -> None:
            await self._answers.reply(send, self.http, reply)

        return answer

    def plain(self, body: Any, path: str | None = None, cursor: str | None = None) -> ASGIApp:
        """Answer with an envelope around a body."""
        request = self.http.request("read")
        return self.reply(
            Reply(
                type="read",
                id=request.id,
                path=path,
                body=body,
                truncated=cursor is not None,
                cursor=cursor,
                timestamp=iso(now()),
                custom=request.custom,
            )
        )

    def download(self, download: Download) -> ASGIApp:
        """Answer with a file."""

        async def answer(_scope: Any, receive: Any, send: Any) -> None:
            await send_download(receive, send, self.http, self.session, download)

        return answer

    def encoded(self, data: bytes, etag: bytes) -> ASGIApp:
        """Answer with an encoded envelope and its validator."""

        async def answer(_scope: Any, _receive: Any, send: Any) -> None:
            await self._answers.body(send, self.http, 200, data, [], etag)

        return answer

    def unchanged(self, etag: bytes) -> ASGIApp:
        """Respond that the client's copy is current."""

        async def answer(_scope: Any, _receive: Any, send: Any) -> None:
            await self._answers.unchanged(send, etag)

        return answer
