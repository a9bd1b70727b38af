"""A gateway with very many robots that tell of themselves, for benchmarks of pages: run it with how many.

Each tells its pose five times a second, its battery each two seconds and its mode when that changes. All the time some
robot has a fault, and another's is over; once a minute one is stopped, and reset ten seconds later.
Prints the port, and serves until it is ended.
"""

from __future__ import annotations

import asyncio
import itertools
import math
import sys
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager, suppress
from typing import Any

import httpx
import msgspec
import uvloop

from rcp_gateway.log import configure
from rcp_gateway.testing import ScriptedRobot, serve
from rcp_kernel.config.file import parse
from rcp_kernel.model import Resource
from rcp_kernel.spi import BackendKind, Host
from rcp_kernel.types import Point, PoseStamped, Twist
from rcpd.garbage import collected_at_rest

KEY = "admin-of-this-benchmark"
TENANTS = 10
MODES = ("AUTO", "HOLD", "MANUAL")
GROUPS = 10  # of robots that tell their poses at one moment
TICK = 0.02  # s
_HEAD = f"""
[log]
level = "error"
[transports.asgi]
port = 0
[plugins.dashboard]
[limits]
subscriptions = 2000
[[keys]]
name = "admin"
role = "admin"
key = "{KEY}"
"""


class Nothing(msgspec.Struct):
    """No options."""


def resources() -> list[Resource]:
    """Return what a robot of the crowd has."""
    return [
        Resource(name="sensor/pose", description="Where.", value=PoseStamped, live=True),
        Resource(name="sensor/battery", description="Charge.", value=Any, live=True),
        Resource(name="sensor/mode", description="What it does.", value=str, live=True),
        Resource(name="event/fault", description="What is wrong.", value=Any),
        Resource(name="param/limit", description="A limit.", value=float),
        Resource(
            name="actuator/cmd_vel", description="Drives.", value=Twist, safe=Twist(), valid_for=0.5
        ),
        Resource(name="action/dock", description="Docks."),
    ]


class Crowd:
    """The robots, by their number."""

    def __init__(self, robots: int) -> None:
        self.robots = robots
        self.hosts: list[Host] = []
        self.complete = asyncio.Event()

    @asynccontextmanager
    async def opened(self, _: Nothing, host: Host) -> AsyncGenerator[ScriptedRobot]:
        robot = ScriptedRobot(host, *resources(), values={"param/limit": 1.0})
        self.hosts.append(host)
        if len(self.hosts) == self.robots:
            self.complete.set()
        host.publish("sensor/mode", MODES[0])
        yield robot

    async def tell(self) -> None:
        """Tell what robots tell, for ever."""
        loop = asyncio.get_running_loop()
        due = loop.time()
        for turn in itertools.count():
            now = turn * TICK
            for number in range(turn % GROUPS, len(self.hosts), GROUPS):
                self._tell_pose(number, now)
            for number in range(turn % 100, len(self.hosts), 100):
                charge = 0.15 + 0.8 * abs(math.sin(now / 600 + number))
                self.hosts[number].publish("sensor/battery", {"percentage": charge, "voltage": 24})
            if turn % 100 == 0:  # each two seconds
                self._tell_events(turn // 100)
            due = max(due + TICK, loop.time() - 0.5)
            await asyncio.sleep(max(0.0, due - loop.time()))

    def _tell_pose(self, number: int, now: float) -> None:
        angle = now / 7 + number
        place = Point(math.cos(angle) * 5 + number, math.sin(angle) * 5)
        self.hosts[number].publish("sensor/pose", PoseStamped(place))

    def _tell_events(self, turn: int) -> None:
        for number, active in ((turn * 7, True), ((turn - 20) * 7, False)):
            fault = {"fault": "drive_hot", "message": "the drive is hot", "severity": "warning"}
            host = self.hosts[number % len(self.hosts)]
            host.publish("event/fault", fault | {"active": active})
        host = self.hosts[turn * 13 % len(self.hosts)]
        host.publish("sensor/mode", MODES[turn % len(MODES)])


async def stopping(url: str, robots: int) -> None:
    """Stop one a minute, and reset it ten seconds later."""
    headers = {"authorization": f"Bearer {KEY}"}
    async with httpx.AsyncClient(base_url=url, headers=headers, timeout=30) as client:
        for turn in itertools.count(1):
            await asyncio.sleep(50)
            scope = f"robot-{turn * 11 % robots:03}"
            for reset in (False, True):
                body = {"scope": scope, "reason": "a drill", "reset": reset}
                told = {"type": "execute", "path": "/system/estop", "body": body}
                (await client.post("/rcp/v1/messages", json=told)).raise_for_status()
                await asyncio.sleep(5)


async def main(robots: int) -> None:
    """Serve so many robots."""
    configure("error", "json")
    crowd = Crowd(robots)
    backends = "".join(
        f'[[backends]]\nuse = "crowd"\nname = "robot-{at:03}"\ntenant = "t{at % TENANTS}"\nrobot = "robot-{at:03}"\n'
        for at in range(robots)
    )
    kind = BackendKind("crowd", Nothing, crowd.opened)
    async with serve(parse(_HEAD + backends, "benchmark"), kind) as served:
        url = next(facts["url"] for facts in served.server.status.transports if "url" in facts)
        await crowd.complete.wait()
        with collected_at_rest(asyncio.get_running_loop(), moving=lambda: False):  # as in `rcpd`
            print(url.rpartition(":")[2], flush=True)
            async with asyncio.TaskGroup() as group:
                group.create_task(crowd.tell())
                group.create_task(stopping(url, robots))


if __name__ == "__main__":
    with suppress(KeyboardInterrupt):
        uvloop.run(main(int(sys.argv[1])))
