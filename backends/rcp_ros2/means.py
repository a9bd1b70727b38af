"""Optional means of stopping a robot: an e-stop topic, the lock of a twist_mux, a service."""

from __future__ import annotations

import asyncio
from typing import Any

import msgspec

from rcp_kernel.errors import AdapterUnavailable, DeviceRejected
from rcp_ros2.caller import Caller
from rcp_ros2.config import Qos, StopService, StopTopic
from rcp_ros2.filler import filler
from rcp_ros2.idl import MissingType, fields_of, load
from rcp_ros2.link import RosLink
from rcp_ros2.outlet import Outlet
from rcp_ros2.types import inward

__all__ = ["StopCall", "StopSignal"]

_PERIOD = 0.1  # s between two transmissions of a signal
_LAST = 1.0  # s for a stop that is called while the backend closes
_QOS = Qos(reliability="reliable", durability="transient_local", depth=1)


class StopSignal:
    """A topic that signals that a robot is stopped; in the ROS thread."""

    def __init__(self, link: RosLink, config: StopTopic, robot: str | None) -> None:
        cls = load(config.type)
        fill, type_ = filler(cls), inward(cls)
        self.topic = config.name
        self.type = config.type
        self.robot = robot
        self.stopped = fill(msgspec.convert(config.value, type_))
        self.data = serialised(self.stopped)
        """The message that signals the stop, in CDR."""
        self.engaged = False
        self._delivered = True
        released = config.released
        self._released = None if released is None else fill(msgspec.convert(released, type_))
        self._outlet = Outlet(link, self.topic, cls, _QOS)
        self._outlet.poll()
        self._due = 0.0

    def engage(self, now: float) -> None:
        """Signal that the robot is stopped."""
        self.engaged = True
        self._due = now + _PERIOD
        self._send(self.stopped)

    def hold(self, now: float) -> None:
        """Repeat the signal when it is due."""
        if now >= self._due:
            self.engage(now)

    def release(self) -> None:
        """Signal the release, if the stop was signalled."""
        if self.engaged and self._released is not None:
            self._send(self._released)
        self.engaged = False

    def trouble(self) -> str | None:
        """Describe a signal without a receiver, or return None."""
        return (
            None if self._delivered or not self.engaged else f"no node subscribes to {self.topic}"
        )

    def poll(self) -> None:
        """Match the current subscribers."""
        self._outlet.poll()

    def _send(self, message: Any) -> None:
        try:
            self._delivered = self._outlet.send(message, anyhow=True) != "nobody"
        except AdapterUnavailable:  # reported as a problem of the outlet
            self._delivered = False

    def close(self) -> None:
        """Destroy the publisher."""
        self._outlet.close()


class StopCall:
    """A service that stops a robot; on the event loop."""

    def __init__(self, link: RosLink, config: StopService, robot: str | None) -> None:
        self.name = config.name
        self.robot = robot
        self.engaged = False
        self.done = False
        """Whether the service has reported success since the stop began."""
        self.error: str | None = None
        self.plan: dict[str, Any] | None = None
        """The call for the guard process, once the type is known."""
        self._link = link
        self._config = config
        self._caller: Caller | None = None
        self._srv: Any = None
        self._running: asyncio.Task[None] | None = None
        self._releasing: asyncio.Task[None] | None = None

    @property
    def type(self) -> str | None:
        """The service's type, once it is known."""
        return self._config.type or self._link.graph.services.get(self.name)

    async def engage(self) -> None:
        """Call the service; concurrent calls wait for the same response.

        :raises RcpError: it cannot be reached, does not respond, or reports failure.
        """
        self.engaged = True
        if self._releasing is not None:
            self._releasing.cancel()  # if it is on its way, the stop follows it
        if self._running is None:
            self._running = asyncio.ensure_future(self._call(self._config.request))
            self._running.add_done_callback(self._end)
        await asyncio.shield(self._running)

    def _end(self, task: asyncio.Task[None]) -> None:
        self._running = None
        error = None if task.cancelled() else task.exception()
        self.done = error is None and not task.cancelled()
        self.error = None if error is None else f"{self.name} failed: {error}"
        self._link.trouble(f"stop service {self.name}", self.error)

    def release(self) -> None:
        """Call the service with the release request, if configured."""
        engaged, self.engaged, self.done = self.engaged, False, False
        if engaged and self._config.released is not None:
            task = asyncio.ensure_future(self._call_after(self._running, self._config.released))
            task.add_done_callback(self._released)
            self._releasing = task

    async def _call_after(
        self, running: asyncio.Task[None] | None, request: dict[str, Any]
    ) -> None:
        """Call it when the call before has ended, or a stop would follow its release."""
        if running is not None:
            await asyncio.wait([running])
        await self._call(request)

    def _released(self, task: asyncio.Task[None]) -> None:
        if self._releasing is task:
            self._releasing = None
        error = None if task.cancelled() else task.exception()
        text = None if error is None else f"{self.name} did not release the robot: {error}"
        self._link.trouble(f"stop service {self.name}", text)

    def prepare(self) -> None:
        """Create the client early, so that it discovers the service; called in the ROS thread."""
        if self._caller is not None or self.type is None:
            return
        try:
            self._srv = srv = load(self.type, "srv")
            request = _filled(srv.Request, self._config.request)
        except (MissingType, ValueError) as error:
            self._link.complain(f"stop service {self.name}", f"{self.name}: {error}")
            return
        self._caller = Caller(self._link, srv, self.name)
        self._caller.prepare()
        self.plan = {"name": self.name, "type": self.type, "data": serialised(request).hex()}

    async def _call(self, plain: dict[str, Any]) -> None:
        await self._link.ros.call(self.prepare)
        if self._caller is None:
            raise AdapterUnavailable(f"no node offers service {self.name}")
        request = _filled(self._srv.Request, plain)
        response = await self._caller.call(request, self._link.config.timeout)
        if getattr(response, "success", True) is False:
            answer = getattr(response, "message", "") or "success: false"
            raise DeviceRejected(f"{self.name} responded {answer!r}")

    async def close(self) -> None:
        """Destroy the client; a stop on its way is sent first, if that does not take long."""
        if self.engaged and self._running is not None:
            await asyncio.wait([self._running], timeout=_LAST)
        for task in (self._running, self._releasing):
            if task is not None:
                task.cancel()
        if self._caller is not None:
            self._caller.close()


def serialised(message: Any) -> bytes:
    """Return a message in CDR."""
    from rclpy.serialization import serialize_message

    return serialize_message(message)


def _filled(cls: Any, plain: dict[str, Any]) -> Any:
    if not fields_of(cls):
        return cls()
    return filler(cls)(msgspec.convert(plain, inward(cls)))
