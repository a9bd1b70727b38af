"""The stop of one robot: its own gateway's e-stop, requested and watched from here."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from typing import Any

from rcp_client.calls import Call
from rcp_client.client import Client
from rcp_client.messages import Notice, Reply
from rcp_fleet.resources import ESTOP
from rcp_kernel.clock import parse_time
from rcp_kernel.spi import Host, MotionState

__all__ = ["RobotStop"]

_WAIT = 10.0  # s for the gateway's answer; it answers after 5 s if the robot is not at rest


class RobotStop:
    """What the hub asks of a gateway's e-stop, and what it was told of it."""

    def __init__(self, client: Client, hub: str, host: Host, robot: str) -> None:
        self._client, self._hub = client, hub
        self._host, self._robot = host, robot
        self._asking: asyncio.Task[None] | None = None
        self._told: dict[str, Any] | None = None
        """The last state of the gateway's e-stop on the present link."""
        self._time = 0
        """When that was, ns by the robot's clock."""
        self._overtaken = 0.0
        """Until when updates may come that an answer has overtaken, by the loop's clock."""
        self._held = 0
        """Since when it is latched, if seen since the last request for a stop; 0: not seen."""
        self._free = False
        """Whether it was told to be free since the last request for a stop was sent."""
        client.channel.listeners.append(self._heard)

    def _heard(self, notice: Notice) -> None:
        if notice.code == "disconnected":
            self._told = None  # others may reset it meanwhile
            self._overtaken = 0.0  # nor does the robot's clock have to go on where it was

    def motion(self) -> MotionState:
        """Report whether all that the gateway shows the hub is stopped, as it measures."""
        if not self._client.connected:
            return MotionState(None, "its gateway cannot be reached")
        told = self._told
        if told is None:
            return MotionState(None, "its gateway has not answered")
        if not told["robots"]:
            return MotionState(None, "its own e-stop is not latched")
        late = [one for one in told["robots"].values() if one.get("state") != "confirmed"]
        moves = any(one.get("alarm") for one in late)
        detail = "; ".join(one.get("detail") or "not confirmed" for one in late)
        return MotionState(not late or (False if moves else None), detail)

    def ask(self) -> asyncio.Task[None]:
        """Send the stop within this call, unless one is on its way; return its answer."""
        self._held = 0  # a reset from before this stop must not undo it, whenever it is told
        # One that was sent before a reset waits for a rest that nobody asks for any more.
        if self._asking is None or self._asking.done() or self._free:
            self._free = False
            body = {"reason": f"hub {self._hub}"}
            envelope = {"type": "execute", "path": ESTOP, "body": body, "deadline": _WAIT}
            call = self._client.channel.start(envelope, "always")
            self._asking = asyncio.create_task(self._answer(call), name="fleet stop")
        return self._asking

    async def _answer(self, call: Call) -> None:
        reply = await self._client.channel.finish(call, _WAIT)
        self._take(reply)

    def _take(self, reply: Reply) -> None:
        time = parse_time(reply.timestamp) if reply.timestamp is not None else self._time
        self._overtaken = asyncio.get_running_loop().time() + _WAIT
        self._learn(reply.body, time)

    def _learn(self, told: dict[str, Any], time: int) -> None:
        self._told, self._time = told, time
        # Not `active`: the latch of a tenant goes on for others when its robots are reset by name.
        latched: list[dict[str, Any]] = list(told["robots"].values())
        if latched:  # of several, one that is not at rest
            self._held = max(parse_time(one["since"]) for one in latched)
            late = (one for one in latched if one.get("state") != "confirmed")
            self._host.own_estop(self._robot, next(late, latched[0]))
            return
        self._free = True
        reset = told.get("reset")  # not if its latch was lost with its gateway
        is_reset = bool(self._held and reset and parse_time(reset) > self._held)
        if is_reset:
            self._held = 0
        self._host.own_estop(self._robot, None, reset=is_reset)

    async def stop(self) -> None:
        """Stop the robot; return when its gateway has measured it to be at rest.

        :raises DeviceTimeout: it is not at rest, or the gateway does not answer.
        """
        await asyncio.shield(self.ask())

    def hold(self) -> None:
        """Send the stop again if the gateway is not known to hold the robot."""
        if self._client.connected and not (self._told and self._told["robots"]):
            self.ask().add_done_callback(_seen)

    async def follow(self, path: str) -> AsyncIterator[object]:
        """Keep up with the gateway's e-stop, which others may set and reset."""
        async for update in self._client.subscribe(path):
            time, moment = parse_time(update.timestamp), asyncio.get_running_loop().time()
            if time >= self._time or moment > self._overtaken:  # the robot's clock may be set back
                self._learn(update.body, time)
            yield update


def _seen(task: asyncio.Task[None]) -> None:
    """Look at the outcome, so that asyncio does not report it: the kernel asks again."""
    if not task.cancelled():
        task.exception()
