"""A subscription of this adapter, with its own connection."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import msgspec

from rcp_gateway.api import Session
from rcp_gateway.client_api import ClientApi
from rcp_kernel.values import Encoding
from rcp_kernel.wire import Reply, Request

if TYPE_CHECKING:
    from rcp_gateway.api import Sample

__all__ = ["ResourceFeed"]

_HELD = 1000  # updates queued for the consumer


class ResourceFeed:
    """Updates of some paths, in the order of arrival."""

    def __init__(self, client_api: ClientApi, session: Session) -> None:
        self._client_api = client_api
        self._news = asyncio.Event()
        self._updates: deque[tuple[str, bytes]] = deque(maxlen=_HELD)
        self.ended = False
        """Whether it has ended: the credentials expired, or nothing is subscribed."""
        self._connection = client_api.connect(
            session.principal,
            Encoding.JSON,
            self._flush,
            session.tenant,
            one_way=True,
            wraps=True,
        )

    def _flush(self) -> None:
        connection = self._connection
        connection.outbox.collect(wrap=self._take)
        if connection.expelled or not connection.session.subscriptions:
            self.ended = True
        connection.outbox.again()
        self._news.set()

    def _take(self, data: bytes, sample: Sample | None) -> bytes:
        if sample is not None:
            self._updates.append((sample.entry.path, data))
        return b""

    async def subscribe(self, paths: Sequence[str], **options: Any) -> Reply:
        """Subscribe; a refusal is the reply's error."""
        body = {"paths": list(paths[1:]), **options}
        raw = msgspec.Raw(msgspec.json.encode(body))
        request = Request(type="subscribe", path=paths[0], body=raw)
        return await self._client_api.request(self._connection.session, request)

    async def next(self) -> list[tuple[str, bytes]]:
        """Wait for updates; return the path and envelope of each. Empty once the feed has ended."""
        while not self._updates and not self.ended:
            self._news.clear()
            await self._news.wait()
        taken = list(self._updates)
        self._updates.clear()
        return taken

    def close(self) -> None:
        """Close the connection."""
        self._connection.close(resumable=False)
