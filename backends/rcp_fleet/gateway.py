"""One robot's gateway, as the hub knows it: its session, its resources, its values."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, AsyncIterator, Callable, Coroutine, Mapping
from contextlib import asynccontextmanager
from typing import Any

import msgspec
import structlog

from rcp_client.command import CommandHandle, Feedback
from rcp_client.errors import ConnectionLost
from rcp_client.messages import Notice, Reply, ResourceInfo
from rcp_fleet.config import FleetConfig
from rcp_fleet.frames import FrameLists, FrameStreams
from rcp_fleet.leases import RobotLeases
from rcp_fleet.link import FleetLinks
from rcp_fleet.link_status import LinkStatus
from rcp_fleet.resources import (
    CONFIGURATION,
    ESTOP,
    LEASES,
    ROBOTS,
    STATUS,
    TREE,
    facts_of,
    name_of,
    resource_of,
)
from rcp_fleet.sessions import GatewaySessions
from rcp_fleet.stops import RobotStop
from rcp_fleet.types import RobotTypes
from rcp_fleet.values import RobotFeed, RobotNumbers, RobotValue
from rcp_hubs.signer import HubSigner
from rcp_kernel.clock import parse_time
from rcp_kernel.errors import (
    AdapterUnavailable,
    DeadlineExceeded,
    FilterUnsupported,
    RcpError,
    UnknownPath,
)
from rcp_kernel.spi import (
    Caller,
    FrameWatch,
    Host,
    Principal,
    Progress,
    RobotLease,
    RobotLeaseRequest,
    caller,
)
from rcp_kernel.wire import VERSION
from rcp_protocol.task_groups import TaskGroup
from rcp_protocol.trace import Trace, current_trace

__all__ = ["RemoteGateway", "followed"]

log = structlog.get_logger("rcp.fleet")
_LONGEST_PAUSE = 1.0  # s between two attempts while the gateway is alive
_SHORTEST = 0.001  # s: a deadline must lie ahead
_AWAY = "its gateway cannot be reached"


class _Stream:
    """A subscription of the gateway, and who uses it here."""

    __slots__ = ("idle", "task", "users")

    def __init__(self, task: asyncio.Task[None]) -> None:
        self.task = task
        self.users = 0
        self.idle = False
        """Whether nobody has used it for a while, and the link was up."""


class RemoteGateway:
    """A gateway with a session that outlives its links."""

    def __init__(
        self,
        config: FleetConfig,
        links: FleetLinks,
        host: Host,
        types: RobotTypes,
        signer: HubSigner | None,
        name: str,
    ) -> None:
        self._host = host
        self._types = types
        self.name = name
        self.ready = False
        """Whether its resources are declared and it can be reached."""
        self._reached = asyncio.Event()
        """Set while it is."""
        self._why = _AWAY
        """Why it was not, when last it was not."""
        self._returned = asyncio.get_running_loop().create_future()
        """Done when a new link has been made, and then another one."""
        self._paths: dict[str, str] = {}
        self._numbers = RobotNumbers()
        self._streams: dict[tuple[str, float | None], _Stream] = {}
        self.sessions = GatewaySessions(config, links, host.tenant, name, signer)
        self._client = self.sessions.own
        self._frame_lists = FrameLists(name, self._list, turns=types.turns)
        self._frame_streams = FrameStreams(self.sessions, self._numbers, self._path_when_reached)
        self.link = LinkStatus(host, name, self.sessions.statistics)
        self.stops = RobotStop(self._client, config.hub, host, name)
        self._leases = RobotLeases(self.sessions, host, name)
        self._client.channel.listeners.append(self._heard)
        self._opening = asyncio.create_task(self._open(), name=f"fleet {name}")

    def alive(self, *, here: bool) -> None:
        """Note that the gateway's token has appeared or gone."""
        self.sessions.alive(here=here)

    def _heard(self, notice: Notice) -> None:
        if notice.code == "refused":
            self._refused(notice.message or "refused")
        elif notice.code == "reconnected":
            returned = self._returned
            self._returned = asyncio.get_running_loop().create_future()
            returned.set_result(None)
            if not notice.facts.get("resumed"):
                self._numbers.restarted()
        self._review()

    def _refused(self, reason: str) -> None:
        self._why = reason
        self._host.report(reason, down=True, robot=self.name)
        self.link.down(reason)
        self._frame_streams.missing(reason)

    def _mismatch(self) -> str | None:
        """Say why the gateway and this hub do not understand each other, if so."""
        spoken = self._client.greeting.get("version")
        self.link.speaks(spoken)
        if spoken in (None, VERSION):
            return None
        return (
            f"its gateway speaks RCP/{spoken} and this hub RCP/{VERSION}: install versions of the "
            "gateway that have one in common"
        )

    async def _open(self) -> None:
        while True:
            try:
                await self._client.channel.open()
                break
            except ConnectionLost as error:
                log.info("fleet_gateway_unreachable", gateway=self.name, reason=error.message)
            except RcpError as error:
                self._refused(error.message)
            await asyncio.sleep(_LONGEST_PAUSE)
        while (why := self._mismatch()) is not None:  # until it has been replaced
            self._refused(why)
            await asyncio.sleep(_LONGEST_PAUSE)
        while True:
            try:
                await self._follow()
            except ExceptionGroup:  # a gateway said what nobody expects; its stops must go on
                log.exception("fleet_gateway_not_followed", gateway=self.name)
                await asyncio.sleep(_LONGEST_PAUSE)
            else:
                return

    async def _follow(self) -> None:
        async with TaskGroup() as group:
            group.create_task(self._keep(TREE, self._follow_tree))
            group.create_task(self._keep(STATUS, self._ask_version))
            group.create_task(self._keep(ROBOTS, self._follow_facts))
            group.create_task(self._keep(ESTOP, self.stops.follow))
            group.create_task(self._keep(LEASES, self._leases.follow))

    async def _keep(self, path: str, follow: Callable[[str], AsyncIterator[object]]) -> None:
        """Follow what a gateway offers; again after each cut if it does not: it may be replaced."""
        while True:
            returned = self._returned
            try:
                async for _ in follow(path):
                    self.link.offers(path)
            except (ConnectionLost, DeadlineExceeded):
                await asyncio.sleep(_LONGEST_PAUSE)
                continue
            except RcpError as error:  # an earlier version, or one that does not let the hub see it
                log.info("fleet_not_offered", gateway=self.name, path=path, reason=error.message)
                self.link.lacks(path)
                if path == TREE:  # what it has now is what it will have
                    await self._declare()
            await asyncio.shield(returned)

    async def _follow_tree(self, path: str) -> AsyncIterator[object]:
        """Declare what the gateway has, and again whenever its tree changes."""
        async for update in self._client.subscribe(path):
            await self._declare()
            yield update

    async def _declare(self) -> None:
        found = await self._discover()
        resources = [resource_of(info, self.name, self._types.of) for info in found]
        gone = self._paths.keys() - {resource.name for resource in resources}
        self._paths = {name_of(info.path, self.name): info.path for info in found}
        if self._paths.pop(self.link.name, None) is not None:  # the hub's own is there
            log.warning("fleet_resource_hidden", gateway=self.name, resource=self.link.name)
            resources = [one for one in resources if one.name != self.link.name]
        # Services first: the robot's own `hold` comes before the one that the kernel would add.
        resources.sort(key=lambda one: not one.name.startswith("service/"))
        for resource in resources:
            try:
                self._host.declare(resource)
            except RcpError as error:  # one that is odd must not hide the others
                log.warning("fleet_resource_refused", gateway=self.name, reason=error.message)
        self._host.withdraw(*gone)
        self._review()

    async def _discover(self) -> list[ResourceInfo]:
        while True:
            try:
                found = await self._list()
                self._frame_lists.note(found)
                return found + await self._types.discover(self._client, CONFIGURATION)
            except RcpError as error:
                log.info("fleet_discovery_failed", gateway=self.name, reason=error.message)
            await asyncio.sleep(_LONGEST_PAUSE)

    async def _list(self) -> list[ResourceInfo]:
        return await self._types.discover(self._client, "/tenant/**")

    async def _follow_facts(self, path: str) -> AsyncIterator[object]:
        """Describe the robot as its gateway's inventory does, if it has one."""
        async for update in self._client.subscribe(path, rate=1.0):
            self._host.describe(facts_of(update.body), self.name)
            self.link.robots(update.body)
            yield update

    async def _ask_version(self, path: str) -> AsyncIterator[object]:
        """Learn the version of the gateway: once for each link."""
        facts = await self._client.read(path, fields=["version"])
        self.link.runs(facts.get("version"))
        yield facts

    def _review(self) -> None:
        connected = self._client.connected
        mismatch = self._mismatch() if connected else None
        ready = connected and mismatch is None and bool(self._paths)
        changed, self.ready = ready != self.ready, ready
        if not ready:
            self._reached.clear()
            if mismatch is not None or changed:
                self._refused(mismatch or _AWAY)
            return
        if not changed:
            return
        self._host.link_restored(self.name)  # before its commands: it may be latched
        self._host.report(None, robot=self.name)
        self.link.ready()
        self._reached.set()

    def _path(self, name: str) -> str:
        if not self.ready:
            raise AdapterUnavailable(f"the gateway of '{self.name}' cannot be reached")
        return self._paths[name]

    async def read(self, name: str) -> Any:
        """Read from the gateway, as the person who asked; what the hub itself knows, here."""
        if name == self.link.name:
            return self.link.value()
        reply = await self._sample(name, None)
        if reply.seq is None or reply.source_timestamp is None:
            return reply.body
        return self._value(name, reply, reply.source_timestamp)

    async def read_in_frame(self, name: str, frame: str) -> RobotValue:
        """Read a value in a frame, as the gateway converts it for the person who asked.

        :raises FilterUnsupported: it is the hub's own, or has none.
        """
        if name == self.link.name:
            raise FilterUnsupported(f"{name} has no frame", remedy="Omit `frame`.")
        reply = await self._sample(name, frame)
        return self._value(name, reply, reply.source_timestamp or reply.timestamp or "")

    def frames_of(self, name: str) -> tuple[str, ...]:
        """Return the frames to and from which the gateway converts."""
        return self._frame_lists.of(name, ready=self.ready)

    def watch_in_frame(self, name: str, watch: FrameWatch) -> Callable[[], None]:
        """Subscribe in a frame, as the person who wants it; return the end function."""
        if not self.ready:  # no change will tell this one
            watch.missing(self._why)
        return self._frame_streams.begin(name, watch)

    async def _path_when_reached(self, name: str) -> str:
        await self._reached.wait()
        if name not in self._paths:
            raise UnknownPath(f"'{name}' is not there any more")
        return self._paths[name]

    async def _sample(self, name: str, frame: str | None) -> Reply:
        path, asked = self._path(name), caller()
        async with self.sessions.acting(_who(asked)) as client:
            return await client.sample(path, frame=frame, deadline=_left(asked))

    def _value(self, name: str, reply: Reply, timestamp: str) -> RobotValue:
        data, time = msgspec.msgpack.encode(reply.body), parse_time(timestamp)
        return RobotValue(data, self._numbers.of(name, reply.seq or 0, time), time)

    async def write(self, name: str, value: Any) -> Any:
        """Write as the person who asked, and return the value in force."""
        path, asked = self._path(name), caller()
        current_trace.set(_trace(asked))
        async with self.sessions.acting(_who(asked)) as client:
            return await client.write(
                path,
                value,
                valid_for=None if asked is None else asked.valid_for,
                idempotency_key=_key(asked),
                deadline=_left(asked),
            )

    async def write_together(self, values: Mapping[str, Any]) -> Mapping[str, Any]:
        """Write several values as one, and return those in force."""
        names, asked = {self._path(name): name for name in values}, caller()
        current_trace.set(_trace(asked))
        async with self.sessions.acting(_who(asked)) as client:
            written = await client.write_all(
                {path: values[name] for path, name in names.items()},
                valid_for=None if asked is None else asked.valid_for,
                idempotency_key=_key(asked),
                deadline=_left(asked),
            )
        return {names[path]: value for path, value in written.items()}

    async def execute(self, name: str, value: Any, progress: Progress) -> Any:
        """Run a command as the person who asked; its errors are the robot's own."""

        def feedback(one: Feedback) -> None:
            if one.status == "in_progress":
                progress(one.body, fraction=one.progress)

        asked = caller()
        current_trace.set(_trace(asked))
        while True:  # until the kernel ends it at its deadline; its key keeps it from running twice
            await self._reached.wait()
            try:
                async with self.sessions.acting(_who(asked)) as client:
                    begun = client.start(
                        self._paths[name],
                        value,
                        deadline=_left(asked),
                        idempotency_key=_key(asked),
                        on_feedback=feedback,
                    )
                    return await followed(begun)
            except ConnectionLost as error:
                if not error.retryable:  # the gateway has forgotten it, and its key
                    raise
            await asyncio.sleep(_LONGEST_PAUSE)

    async def reset_estop(self) -> None:
        """Ask the gateway, as the person who asked, to reset its e-stop; it may refuse."""
        if not self.ready:
            raise AdapterUnavailable(_AWAY)
        async with self.sessions.acting(_who(caller())) as client:
            await client.estop(reset=True)

    async def lease(self, request: RobotLeaseRequest) -> RobotLease:
        """Ask the gateway for a lease, as the person who asked."""
        asked = caller()
        return await self._leases.ask(request, asked, _left(asked))

    @asynccontextmanager
    async def watch(self, name: str, rate: float | None) -> AsyncGenerator[None]:
        """Publish what one subscription of the gateway brings."""
        if name == self.link.name:
            async with self.link.watch(rate):
                yield
            return
        stream = self._streams.get((name, rate))
        if stream is None:
            task = asyncio.create_task(self._pass_on(name, rate), name=f"fleet watch {name}")
            stream = self._streams[name, rate] = _Stream(task)
        stream.users, stream.idle = stream.users + 1, False
        try:
            yield
        finally:
            stream.users -= 1
            self._leave(name, rate)

    def _leave(self, name: str, rate: float | None) -> None:
        """End a subscription that nobody uses, but not during a cut: it is to catch up after it."""
        stream = self._streams.get((name, rate))
        if stream is None or stream.users:
            return
        if self.ready and stream.idle:
            del self._streams[name, rate]
            stream.task.cancel()
        else:
            stream.idle = self.ready
            asyncio.get_running_loop().call_later(_LONGEST_PAUSE, self._leave, name, rate)

    async def _pass_on(self, name: str, rate: float | None) -> None:
        def publish(data: bytes, seq: int, time: int) -> None:
            number = self._numbers.of(name, seq, time)
            self._host.publish(name, RobotValue(data, number, time))

        while True:
            try:
                async for _ in RobotFeed(self._client.channel, self._paths[name], rate, publish):
                    pass  # a notice: its updates are published as they arrive
            except RcpError as error:
                log.warning("fleet_subscription_ended", resource=name, reason=error.message)
            await asyncio.sleep(_LONGEST_PAUSE)

    async def close(self) -> None:
        """End the session; what the robot does goes on as its own gateway decides."""
        tasks = [self._opening, *(stream.task for stream in self._streams.values())]
        self._streams.clear()
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        await self._frame_lists.close()
        await self._frame_streams.close()
        await self.sessions.close()


async def followed(begun: Coroutine[Any, Any, CommandHandle]) -> Any:
    """Return the result of a command; a cancellation ends with what the robot made of it."""
    starting = asyncio.ensure_future(begun)
    running: asyncio.Future[Any] | None = None
    try:
        handle = await asyncio.shield(starting)
        running = asyncio.ensure_future(handle.result())
        return await asyncio.shield(running)
    except asyncio.CancelledError:
        if running is not None and running.done():
            raise
    handle = await starting
    running = running or asyncio.ensure_future(handle.result())
    while not running.done():
        try:
            await handle.cancel()
            break
        except (ConnectionLost, DeadlineExceeded):  # the link is cut, or the session closed: again
            await asyncio.wait([running], timeout=_LONGEST_PAUSE)
    try:
        return await running
    except ConnectionLost as error:
        raise asyncio.CancelledError from error


def _who(asked: Caller | None) -> Principal | None:
    return None if asked is None else asked.principal


def _key(asked: Caller | None) -> str | None:
    return None if asked is None else asked.key


def _trace(asked: Caller | None) -> Trace | None:
    return None if asked is None else asked.trace


def _left(asked: Caller | None) -> float | None:
    """Return the seconds until the deadline of a request."""
    if asked is None:
        return None
    return max(asked.deadline - asyncio.get_running_loop().time(), _SHORTEST)
