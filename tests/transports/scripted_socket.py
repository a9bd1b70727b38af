"""A socket whose other end is a script, and an event loop that has a turn when a test says so."""

from __future__ import annotations

import asyncio
import json
from collections import deque
from collections.abc import Coroutine, Generator
from contextlib import AsyncExitStack, contextmanager
from typing import Any

from rcp_gateway.log import configure
from rcp_gateway.testing import ScriptedRobot, Served, scripted, serve
from rcp_kernel.config.file import parse
from rcp_kernel.spi import Host
from transports.robot import BOUND, robot


class ScriptedSocket:
    """A socket whose other end does as it is told."""

    def __init__(self, place: Place) -> None:
        self._place = place
        self.writable = True
        self.open = True
        self.compresses = False
        self.buffered = 0
        self.limit = 0
        self.reading = True
        self.inbound: deque[bytes] = deque()
        """What the client has sent and nobody has read."""
        self.replies: list[dict[str, Any]] = []
        self.code: int | None = None

    def attach(self, receiver: Any) -> None:
        self.receiver = receiver

    def write(self, messages: list[bytes]) -> None:
        if self.open:
            self.replies += map(json.loads, messages)

    def reply(self, data: bytes) -> None:
        self.write([data])

    def head(self, size: int, text: bool) -> bytes:  # noqa: FBT001 - see NativeSocket
        return b"%10d" % size

    def write_frames(self, parts: list[bytes]) -> None:
        data, messages = b"".join(parts), list[bytes]()
        while data:
            end = 10 + int(data[:10])
            messages.append(data[10:end])
            data = data[end:]
        self.write(messages)

    def pass_on(self, parts: list[bytes]) -> int | None:
        if not (self.writable and self.open):
            return None
        self.write_frames(parts)
        return 0

    def pause_reading(self) -> None:
        self.reading = False

    def resume_reading(self) -> None:
        self.reading = True

    def close(self, code: int, reason: str = "") -> None:
        if self.open:
            self.open, self.code = False, code

    # -- what the client's end and the event loop do -------------------------------------------

    def read(self, most: int) -> None:
        """Tell of what comes out of one read, if it is read at all."""
        if not self.reading or not self.inbound:
            return
        with self._place.inside():
            for _ in range(min(most, len(self.inbound))):
                data = self.inbound.popleft()
                if self.open:
                    self.receiver.received(data, True)
            if self.open:
                self.receiver.settled()

    def take(self) -> None:
        """Take all that was written."""
        if self.open and not self.writable:
            self.writable = True
            with self._place.inside():
                self.receiver.drained()

    def lose(self, code: int) -> None:
        """End without a word."""
        self.open = False
        with self._place.inside():
            self.receiver.lost(code)


class Place:
    """A gateway for all examples of a model, and the loop that it runs in."""

    def __init__(self) -> None:
        self._runner = asyncio.Runner()
        self._stack = AsyncExitStack()
        self.robots: list[ScriptedRobot] = []

    @contextmanager
    def inside(self) -> Generator[None]:
        """Call as the loop does, and let it have no turn."""
        asyncio.events._set_running_loop(self._runner.get_loop())  # noqa: SLF001 - the loop is to have no turn
        try:
            yield
        finally:
            asyncio.events._set_running_loop(None)  # noqa: SLF001 - the loop is to have no turn

    def do(self, work: Coroutine[Any, Any, Any]) -> Any:
        async def bounded() -> Any:
            async with asyncio.timeout(BOUND):
                return await work

        return self._runner.run(bounded())

    def serve(self, config: str) -> None:
        def make(host: Host) -> ScriptedRobot:
            self.robots.append(robot(host))
            return self.robots[-1]

        configure("error", "json")
        kind = scripted(make)
        served: Served = self.do(self._stack.enter_async_context(serve(parse(config, "t"), kind)))
        self.server = served.server

    def close(self) -> None:
        self.do(self._stack.aclose())
        self._runner.close()
