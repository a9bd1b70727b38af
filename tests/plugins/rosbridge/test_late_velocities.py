"""A velocity that waited for a slow robot is not driven once it is too old."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from typing import Any

import msgspec
import pytest

from configuration import backend
from plugins.rosbridge.rig import OPEN, ROVER, page, site
from rcp_gateway.testing import SteppedClock
from rcp_kernel.model import Resource
from rcp_kernel.spi import BackendKind, BaseBackend, Host
from rcp_kernel.types import Twist
from rcp_rosbridge.leases import Leases

LONG = 10.0  # s that a velocity is valid: longer than any machine takes to pass it on


class _NoOptions(msgspec.Struct):
    pass


class _SlowRobot(BaseBackend):
    """Confirms a velocity when the test says so."""

    def __init__(self, host: Host) -> None:
        self.taken: list[float] = []
        self.begun, self.confirm = asyncio.Event(), asyncio.Event()
        host.declare(
            Resource(name="actuator/cmd_vel", description="A velocity.", value=Twist, safe=Twist())
        )

    async def write(self, name: str, value: Twist) -> Any:
        """Take a velocity; a stop is confirmed at once."""
        if value == Twist():
            return value
        self.taken.append(value.linear.x)
        self.begun.set()
        await self.confirm.wait()
        return value


async def test_a_velocity_that_waited_too_long_is_not_driven(stepped: SteppedClock) -> None:
    robots: list[_SlowRobot] = []

    @asynccontextmanager
    async def open_robot(_: _NoOptions, host: Host) -> AsyncGenerator[_SlowRobot]:
        robots.append(_SlowRobot(host))
        yield robots[0]

    kind = BackendKind("slow", _NoOptions, open_robot)
    one = backend("rover", use="slow")
    async with (
        site(OPEN, one, kinds=(kind,), valid_for=LONG, clock=stepped.clock) as gateway,
        page(gateway) as client,
    ):
        for speed in (0.1, 0.2):
            await client.send(op="publish", topic="/cmd_vel", msg={"linear": {"x": speed}})
        (robot,) = robots
        async with asyncio.timeout(60):
            await robot.begun.wait()
        await client.values("/rosapi/get_time")  # the second message has been received
        stepped.advance(2 * LONG)
        robot.begun.clear()
        robot.confirm.set()
        await client.status("messages on /cmd_vel come faster")
        await client.send(op="publish", topic="/cmd_vel", msg={"linear": {"x": 0.3}})
        async with asyncio.timeout(60):
            await robot.begun.wait()
        assert robot.taken == [0.1, 0.3]


async def test_a_velocity_that_waited_for_its_lease_too_long_is_not_driven(
    monkeypatch: pytest.MonkeyPatch, stepped: SteppedClock
) -> None:
    """As that of a robot with a gateway of its own, which is asked over a slow link."""
    usual = Leases.acquire

    def slow(self: Leases, path: str, then: Any) -> None:
        stepped.advance(2 * LONG)
        usual(self, path, then)

    monkeypatch.setattr(Leases, "acquire", slow)
    safety = '[safety]\nlease_required = ["/actuator/**"]\n'
    async with (
        site(OPEN, ROVER, limits=safety, valid_for=LONG, clock=stepped.clock) as gateway,
        page(gateway) as client,
    ):
        await client.send(op="subscribe", topic="/velocity")
        drive = {"op": "publish", "topic": "/cmd_vel", "msg": {"linear": {"x": 0.4}}}
        await client.send(**drive)
        await client.status("messages on /cmd_vel come faster")
        assert (await client.message("/velocity"))["twist"]["linear"]["x"] == 0.0
        await client.send(**drive)  # under the lease that it has now
        await client.until(
            lambda m: m.get("topic") == "/velocity" and m["msg"]["twist"]["linear"]["x"] > 0.01
        )
