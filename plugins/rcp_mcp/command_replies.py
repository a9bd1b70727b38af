"""One command from its start to the caller's result: progress, time limit, cancellation."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

from rcp_gateway.api import Session
from rcp_gateway.client_api import ClientApi
from rcp_kernel.wire import Reply, Request
from rcp_protocol.timeouts import timeout_at

__all__ = ["Following", "Report"]

Report = Callable[[float, str | None, Reply], Awaitable[None]]
"""Report progress to the client: the fraction, a text, and the reply with it."""
_STEP = 0.0001


class Following:
    """The replies of one command; the newest is reported first."""

    def __init__(self, client_api: ClientApi, session: Session) -> None:
        self._client_api = client_api
        self._session = session
        self._news = asyncio.Event()
        self.latest: Reply | None = None
        """The newest reply; a final one is the last."""
        self.command: str | None = None
        self._reported = 0.0
        self._unwanted = False

    def start(self, request: Request) -> None:
        """Send the request."""
        self._client_api.submit(self._session, request, self._answer)

    def _answer(self, reply: Reply) -> None:
        self.command = reply.command or self.command
        self.latest = reply
        self._news.set()
        if self._unwanted:
            self.stop()

    @property
    def final(self) -> Reply | None:
        """The final reply, if it has arrived."""
        return self.latest if self.latest is not None and self.latest.final else None

    async def begun(self) -> Reply:
        """Wait for the first reply."""
        while self.latest is None:
            await self._news.wait()
        return self.latest

    async def until(self, patience: float, pause: float, report: Report) -> Reply | None:
        """Wait for the final reply, reporting progress every `pause` s; None if it takes longer."""
        loop = asyncio.get_running_loop()
        end = loop.time() + patience
        free = 0.0
        while self.final is None:
            self._news.clear()
            try:
                async with timeout_at(end):
                    await self._news.wait()
                    if self.final is None and loop.time() < free:
                        await self._pause(free - loop.time())
            except TimeoutError:
                return self.final
            latest = self.latest
            if latest is not None and not latest.final and latest.status == "in_progress":
                free = loop.time() + pause
                await report(self._progress(latest), latest.message, latest)
        return self.final

    async def _pause(self, seconds: float) -> None:
        """Let newer feedback replace older, without delaying the final reply."""
        end = asyncio.get_running_loop().time() + seconds
        while self.final is None:
            self._news.clear()
            try:
                async with timeout_at(end):
                    await self._news.wait()
            except TimeoutError:
                return

    def _progress(self, reply: Reply) -> float:
        """Return an increasing number for each call, as clients require."""
        part = reply.progress if reply.progress is not None else 0.0
        self._reported = max(part, self._reported + _STEP)
        return self._reported

    def stop(self) -> None:
        """Stop the robot; called when the caller no longer waits for the result."""
        self._unwanted = self.command is None
        if self.command is not None and self.final is None:
            request = Request(type="cancel", command=self.command)
            self._client_api.submit(self._session, request, lambda _reply: None)
