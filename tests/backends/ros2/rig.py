"""A base that obeys whoever commands it, somebody who does, and a backend beside them."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from typing import Any

from backends.ros2.robot import BOUND, Base, Commander, Robot, fresh_domain, robot_of
from rcp_kernel.errors import AdapterUnavailable, DeviceTimeout
from timing import Load, measured_load

VELOCITY = "actuator/velocity"
MAP: dict[str, Any] = {
    "/actuator/velocity": {"topic": "/cmd_vel", "type": "geometry_msgs/msg/Twist"},
    "/action/navigate": {"action": "/navigate", "type": "test_msgs/action/NestedMessage"},
    "/service/dock": {"service": "/dock", "type": "std_srvs/srv/SetBool"},
}
EXPOSE = ["/odom"]
CREEP = 0.1  # m/s that a command which slips in between two zeros may give the wheels
SLIP = 0.4  # m/s: the same, where a zero comes late
LATE = (0.05, 0.02)  # m/s that this and the mean may be more at most, where the machine is busy
WINDOW = 1.5  # s for which they are looked at


async def until(holds: Callable[[], Any], seconds: float = BOUND) -> None:
    """Wait until something holds that nothing tells of."""
    async with asyncio.timeout(seconds):
        while not holds():  # noqa: ASYNC110 - nothing tells of it
            await asyncio.sleep(0.02)


def _parties() -> tuple[int, Base, Commander]:
    domain = fresh_domain()
    return domain, Base(domain), Commander(domain)


class Rig:
    """The base, the commander, and the domain they share."""

    def __init__(self) -> None:
        self.domain, self.base, self.commander = _parties()

    def start(self) -> None:
        self.base.start()
        self.commander.start()

    def stop(self) -> None:
        self.commander.stop()
        self.base.stop()

    def renew(self) -> None:
        self.commander.tell("rest")
        self.base.tell("renew")

    def replace(self) -> None:
        """Begin again elsewhere: what one test left wrong fails no other."""
        self.stop()
        self.domain, self.base, self.commander = _parties()
        self.start()

    @property
    def truth(self) -> dict[str, Any]:
        return self.base.tell("truth")

    async def until(self, holds: Callable[[dict[str, Any]], Any], seconds: float = BOUND) -> None:
        """Wait until something holds of the truth."""
        await until(lambda: holds(self.truth), seconds)

    async def drives(self) -> None:
        await self.until(lambda t: t["wheel"] > 0.3)

    async def rests(self, window: float = WINDOW) -> float:
        """Return the most that the wheels turned in a while from now."""
        await asyncio.sleep(window)  # in which nothing may move
        return self.base.tell("peak", seconds=window)

    async def counters(self) -> None:
        """See for a while that others hardly drive the wheels."""
        with measured_load() as load:
            await asyncio.sleep(WINDOW)  # in which others command them
        self.slips(load)

    def slips(self, load: Load) -> None:
        """See that the wheels hardly turned in the while before, though others command them."""
        peak, mean = (self.base.tell(what, seconds=WINDOW) for what in ("peak", "mean"))
        assert peak < load.allows(SLIP, LATE[0])
        assert mean < load.allows(CREEP / 2, LATE[1])


@asynccontextmanager
async def gateway(rig: Rig, **config: Any) -> AsyncIterator[Robot]:
    """Open a backend that knows all of the base."""
    given: dict[str, Any] = {"map": MAP, "expose": EXPOSE, **config}
    async with robot_of(rig.domain, **given) as robot:
        await known(robot)
        yield robot


async def known(robot: Robot) -> None:
    """Return once the base and what it offers is discovered."""
    stops = robot.backend.stops
    keeper = stops.keeper
    await until(lambda: "/navigate" in keeper.servers and keeper.rests)
    await until(lambda: keeper.rests[0].outlet.count() and keeper.rests[0].outlet.nodes)
    await until(lambda: MAP.keys() <= {f"/{name}" for name in robot.resources})
    if robot.backend.catalog.shared.config.stop.feedback is True:
        await until(lambda: any(one.is_fresh() for one in stops.feedbacks.of(None)))


async def estop(robot: Robot) -> float:
    """Latch and halt as the kernel does; return how long the halt took."""
    robot.latched.add(None)
    began = time.monotonic()
    await asyncio.wait_for(robot.backend.halt(), BOUND)
    return time.monotonic() - began


async def confirmed(robot: Robot) -> None:
    """Halt again until it is confirmed, as the kernel does."""
    async with asyncio.timeout(BOUND):
        while True:
            with suppress(AdapterUnavailable, DeviceTimeout):
                return await robot.backend.halt()


async def write(robot: Robot, speed: float) -> None:
    await robot.backend.write(VELOCITY, robot.input(VELOCITY, {"linear": {"x": speed}}))


async def released(robot: Robot) -> None:
    """Return once the reset is noticed."""
    await until(lambda: not robot.backend.stops.keeper.holds)
