"""A link with one device: connected again whenever it is lost, requests matched with answers.

    connecting → up → lost → connecting → …

A link is up once the device has answered on it, not when a connection stands: a process that is
frozen still accepts those.
"""

from __future__ import annotations

import asyncio
import itertools
import random
from collections.abc import AsyncGenerator, Callable
from contextlib import AsyncExitStack, asynccontextmanager
from typing import Generic, Protocol, TypeVar

import structlog

from rcp_links.channel import Channel, Connect
from rcp_links.messages import Messages
from rcp_links.requests import Request, Requests
from rcp_links.timing import LinkTiming
from rcp_protocol.errors import AdapterUnavailable, DeviceTimeout, NotReady
from rcp_protocol.task_groups import TaskGroup
from rcp_protocol.timeouts import timeout

__all__ = ["LinkHost", "RequestLink", "request_link"]

M = TypeVar("M")
log = structlog.get_logger("rcp.links")


class LinkHost(Protocol):
    """What a link tells the gateway; a backend's `Host` is one."""

    def report(self, detail: str | None, *, down: bool = False, robot: str | None = None) -> None:
        """Report that the link is down, with the reason; None: it is up."""
        ...

    def link_restored(self, robot: str | None = None) -> None:
        """Report that a lost device is connected again, before anything else is sent to it."""
        ...


class RequestLink(Generic[M]):
    """Requests to one device and their answers; made by `request_link`."""

    def __init__(
        self,
        connect: Connect[M],
        messages: Messages[M],
        host: LinkHost,
        *,
        robot: str | None,
        timing: LinkTiming,
    ) -> None:
        self._connect, self._messages, self._host = connect, messages, host
        self._robot, self._timing = robot, timing
        self._numbers = itertools.count(1)
        self._requests = Requests[M]()
        self._channel: Channel[M] | None = None
        self._reason = "not connected yet"

    @property
    def is_up(self) -> bool:
        """Whether the device answers."""
        return self._channel is not None

    async def request(
        self,
        make: Callable[[int], M],
        *,
        within: float,
        effect: Callable[[M], None] | None = None,
    ) -> M:
        """Send what `make` returns for a new number; return the device's answer.

        The message is sent before the first `await`, so that a `check_fence()` just before the call
        holds for it.

        Give `effect` where the device changes something. It is called with the answer, whatever has
        become of the caller: a cancellation is raised only when the answer is there, the time is
        over or the link is lost, and an answer that comes after the time still calls it.

        :param within: seconds until the answer.
        :raises AdapterUnavailable: the link is down, and nothing was sent; or it was lost before
            the answer to a request without `effect`.
        :raises DeviceTimeout: no answer in time, or the link was lost before the answer to a
            request with `effect`: the device may have done it.
        """
        if self._channel is None:
            raise AdapterUnavailable(f"the device is not connected: {self._reason}")
        number = next(self._numbers)
        request = Request(effect)
        try:
            self._channel.send(make(number))
        except OSError as error:
            raise AdapterUnavailable(f"the device is not connected: {error}") from error
        self._requests.add(number, request)
        try:
            return await self._answer(request, within)
        finally:
            self._requests.leave(number)

    def post(self, make: Callable[[int], M]) -> None:
        """Send a message without waiting for an answer; it is dropped while the link is down."""
        if self._channel is not None:
            self._send(self._channel, make)

    async def run(self, first: asyncio.Future[None]) -> None:
        """Keep the link up until cancelled; `first` tells what became of the first connection."""
        pause = self._timing.first_pause
        try:
            while True:
                self._reason = await self._ended(first)
                if not first.done():
                    first.set_exception(NotReady(self._reason))
                    return
                if self._channel is not None:
                    pause = self._timing.first_pause
                self._lose()
                await asyncio.sleep(pause * random.uniform(0.75, 1.0))  # noqa: S311 - spreads them
                pause = min(2 * pause, self._timing.longest_pause)
        finally:
            self._reason = "the link was closed"
            self._channel = None
            self._requests.lose(self._reason)

    async def _answer(self, request: Request[M], within: float) -> M:
        loop = asyncio.get_running_loop()
        end, cancelled = loop.time() + within, None
        while not request.answer.done() and (left := end - loop.time()) > 0:
            try:
                await asyncio.wait([request.answer], timeout=left)
            except asyncio.CancelledError as error:
                if request.effect is None:
                    raise
                cancelled = error
        if cancelled is not None:
            raise cancelled
        if not request.answer.done():
            raise DeviceTimeout(f"the device has not answered within {within:g} s")
        return request.answer.result()

    async def _ended(self, first: asyncio.Future[None]) -> str:
        try:
            return await self._connection(first)
        except (Exception, asyncio.CancelledError) as error:
            task = asyncio.current_task()
            if isinstance(error, asyncio.CancelledError) and task is not None and task.cancelling():
                raise  # not one that a function of the author has raised
            log.exception("link failed", robot=self._robot)
            return f"fault of the backend: {error!r}"

    async def _connection(self, first: asyncio.Future[None]) -> str:
        """Connect and receive until the connection ends; return why it did."""
        silence = self._timing.silence
        async with AsyncExitStack() as stack:
            try:
                async with timeout(silence):
                    channel = await stack.enter_async_context(self._connect())
            except TimeoutError:
                return f"no connection within {silence:g} s"
            except OSError as error:
                return f"no connection: {error}"
            async with TaskGroup() as tasks:
                probing = tasks.create_task(self._probe(channel))
                try:
                    return await self._receive(channel, first)
                finally:
                    probing.cancel()

    async def _receive(self, channel: Channel[M], first: asyncio.Future[None]) -> str:
        silence = self._timing.silence
        while True:
            try:
                async with timeout(silence):
                    message = await channel.receive()
            except TimeoutError:
                return f"no message for {silence:g} s"
            except (OSError, EOFError) as error:
                return f"connection lost: {error}"
            except ValueError as error:
                return f"received something that is no message: {error}"
            if self._channel is None:
                self._restore(channel, first)
            try:
                self._take(message)
            except ValueError as error:  # an OSError of the author is a fault, no lost connection
                return f"received something that is no message: {error}"

    async def _probe(self, channel: Channel[M]) -> None:
        while True:
            self._send(channel, self._messages.probe)
            await asyncio.sleep(self._timing.silence / 3)

    def _send(self, channel: Channel[M], make: Callable[[int], M]) -> None:
        message = make(next(self._numbers))
        try:
            channel.send(message)
        except OSError:
            return  # the receiving end learns of it as well

    def _take(self, message: M) -> None:
        number = self._messages.answers(message)
        if number is None:
            self._messages.handle(message)
        else:
            self._requests.take(number, message)

    def _restore(self, channel: Channel[M], first: asyncio.Future[None]) -> None:
        self._channel = channel
        if not first.done():
            first.set_result(None)
        self._host.link_restored(self._robot)
        self._host.report(None, robot=self._robot)

    def _lose(self) -> None:
        self._channel = None
        self._requests.lose(self._reason)
        self._host.report(self._reason, down=True, robot=self._robot)


@asynccontextmanager
async def request_link(
    connect: Connect[M],
    messages: Messages[M],
    host: LinkHost,
    *,
    robot: str | None = None,
    timing: LinkTiming | None = None,
) -> AsyncGenerator[RequestLink[M]]:
    """Connect with a device, and keep connected while entered.

    Whether it is connected is told to `host`; `robot` is one of the backend's robots, if it has
    several. An exception of the functions of `messages` ends the connection, and is logged.

    :raises NotReady: the first connection failed.
    """
    link = RequestLink(connect, messages, host, robot=robot, timing=timing or LinkTiming())
    first: asyncio.Future[None] = asyncio.get_running_loop().create_future()
    running = asyncio.create_task(link.run(first))
    try:
        await first
        yield link
    finally:
        running.cancel()
        await asyncio.wait([running])
