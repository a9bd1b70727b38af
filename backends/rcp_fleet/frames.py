"""What a robot's gateway converts to other frames: its list of them, and streams of values."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterable
from functools import partial

import structlog

from rcp_client.messages import Notice, ResourceInfo
from rcp_fleet.resources import name_of
from rcp_fleet.sessions import GatewaySessions
from rcp_fleet.values import RobotFeed, RobotNumbers, RobotValue
from rcp_kernel.errors import AdapterUnavailable, RcpError
from rcp_kernel.spi import FrameWatch

__all__ = ["FrameLists", "FrameStreams"]

log = structlog.get_logger("rcp.fleet")
_AGE = 30.0  # s after which a list is asked for again when somebody looks
_PAUSE, _LONG_PAUSE = 1.0, 10.0  # s before a refused subscription is tried again


class FrameLists:
    """The frames of each resource: which ones there are changes while the robot runs."""

    def __init__(
        self,
        gateway: str,
        ask: Callable[[], Awaitable[list[ResourceInfo]]],
        *,
        turns: asyncio.Semaphore,
    ) -> None:
        self._gateway, self._ask, self._turns = gateway, ask, turns
        self._known: dict[str, tuple[str, ...]] = {}
        self._at = float("-inf")
        self._asking: asyncio.Task[None] | None = None

    def note(self, found: Iterable[ResourceInfo]) -> None:
        """Take up what the gateway's discovery lists."""
        self._at = asyncio.get_running_loop().time()
        self._known = {
            name_of(info.path, self._gateway): tuple(info.frames) for info in found if info.frames
        }

    def of(self, name: str, *, ready: bool) -> tuple[str, ...]:
        """Return those of a resource; an old list is asked for again, for whoever looks next."""
        loop = asyncio.get_running_loop()
        if ready and self._asking is None and loop.time() - self._at > _AGE:
            self._asking = loop.create_task(self._refresh(), name=f"fleet frames {self._gateway}")
        return self._known.get(name, ())

    async def _refresh(self) -> None:
        try:
            async with self._turns:
                self.note(await self._ask())
        except RcpError as error:
            log.info("fleet_frames_unknown", gateway=self._gateway, reason=error.message)
        except Exception:  # a gateway of another version
            log.exception("fleet_frames_unknown", gateway=self._gateway)
        finally:
            self._at = asyncio.get_running_loop().time()
            self._asking = None

    async def close(self) -> None:
        """Ask for nothing more."""
        if self._asking is not None:
            self._asking.cancel()
            await asyncio.gather(self._asking, return_exceptions=True)


class FrameStreams:
    """Subscriptions in a frame at one gateway, each in the session of the person who wants it."""

    def __init__(
        self,
        sessions: GatewaySessions,
        numbers: RobotNumbers,
        path_of: Callable[[str], Awaitable[str]],
    ) -> None:
        self._sessions, self._numbers, self._path_of = sessions, numbers, path_of
        self._running: dict[asyncio.Task[None], FrameWatch] = {}

    def begin(self, name: str, watch: FrameWatch) -> Callable[[], None]:
        """Begin a subscription; return its end function."""
        task = asyncio.create_task(self._run(name, watch), name=f"fleet {watch.frame} {name}")
        self._running[task] = watch
        task.add_done_callback(self._running.pop)
        return partial(_end, task)

    def missing(self, why: str) -> None:
        """Tell all who subscribe that nothing comes for now."""
        for watch in tuple(self._running.values()):
            watch.missing(why)

    async def _run(self, name: str, watch: FrameWatch) -> None:
        while True:
            pause = _PAUSE
            try:
                await self._follow(name, watch)
            except RcpError as error:
                watch.missing(error.message)
                pause = _PAUSE if error.retryable else _LONG_PAUSE
            except Exception:
                log.exception("fleet_frame_failed", resource=name)
                watch.missing("this hub failed to pass it on; see its log")
            await asyncio.sleep(pause)

    async def _follow(self, name: str, watch: FrameWatch) -> None:
        def publish(data: bytes, seq: int, time: int) -> None:
            watch.publish(RobotValue(data, self._numbers.of(name, seq, time), time))

        path = await self._path_of(name)
        async with self._sessions.acting(watch.principal) as client:
            feed = RobotFeed(client.channel, path, watch.rate, publish, frame=watch.frame)
            async for told in feed.events():
                if not isinstance(told, Notice):
                    continue
                if told.code == "no_transform":
                    watch.missing(told.message or "no transform")
                elif told.code == "refused":  # another session is needed: this one does not return
                    raise AdapterUnavailable(told.message or "the robot's gateway refuses this hub")

    async def close(self) -> None:
        """End all."""
        tasks = list(self._running)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


def _end(task: asyncio.Task[None]) -> None:
    task.cancel()
