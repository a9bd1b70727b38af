"""The ROS 2 backend keeps what the house asks of a stop, with a base in its own process."""

from __future__ import annotations

from collections.abc import AsyncGenerator, Iterator, Mapping, Sequence
from contextlib import asynccontextmanager
from typing import Any, ClassVar

import pytest
import rclpy.experimental.events_executor  # noqa: F401 - half a second that is not tested here

import rcp_ros2
from backends.ros2.robot import BOUND, Base, Commander, fresh_domain
from rcp_gateway.testing import Goal, StopRig, StopSuite, eventually

DOMAIN = fresh_domain()
BASE = Base(DOMAIN)
COMMANDER = Commander(DOMAIN)
STILL = 0.05  # m/s


@pytest.fixture(scope="module", autouse=True)
def _end() -> Iterator[None]:
    yield
    COMMANDER.stop()
    BASE.stop()


class BaseRig(StopRig):
    kind = next(iter(rcp_ros2.rcp_backends()))
    config: ClassVar[Mapping[str, Any]] = {
        "domain_id": DOMAIN,
        "timeout": 0.8,
        "silence": 1.0,
        "expose": ["/odom"],
        "map": {
            "/actuator/velocity": {"topic": "/cmd_vel", "type": "geometry_msgs/msg/Twist"},
            "/action/navigate": {"action": "/navigate", "unit": "1"},
            "/service/dock": {"service": "/dock"},
        },
    }
    frozen: ClassVar[bool] = False
    last: ClassVar[dict[str, Any]] = {"wheel": 0.0, "running": 0}

    @asynccontextmanager
    async def twin(self) -> AsyncGenerator[Base]:
        for process in (BASE, COMMANDER):
            if not process.runs:
                process.start()
        BASE.tell("renew")
        yield BASE
        BASE.tell("renew")

    @asynccontextmanager
    async def served_by_device(self) -> AsyncGenerator[Any]:
        async with super().served_by_device() as robot:
            # Discovery takes 0.2 s mostly and 3 s now and then: it is not what is tested.
            await eventually(self.discovered, "the base is discovered", BOUND)
            yield robot

    async def discovered(self) -> bool:
        stops = self.backend.stops
        rests = stops.keeper.rests
        named = {"action/navigate", "service/dock"} <= {
            name
            for name, b in self.backend.catalog.bindings.items()
            if type(b).__name__ != "Absent"
        }
        fresh = any(one.is_fresh() for one in stops.feedbacks.of(None))
        return bool(named and fresh and rests and rests[0].outlet.count() and stops.keeper.servers)

    async def at_rest(self) -> bool:
        if not BaseRig.frozen:
            BaseRig.last = BASE.tell("truth")
        return abs(BaseRig.last["wheel"]) <= STILL and not BaseRig.last["running"]

    def goals(self) -> Mapping[str, Goal]:
        return {
            "action/navigate": Goal(good=_steps(2), long=_steps(600)),
            "service/dock": Goal(good={"data": True}),
        }

    def values(self, name: str) -> Sequence[Any]:
        return ({"linear": {"x": 0.4}}, {"linear": {"x": 0.2}})

    async def break_link(self) -> None:
        BASE.tell("sever", cut=True)

    async def mend_link(self) -> None:
        BASE.tell("sever", cut=False)

    async def freeze_device(self) -> None:
        await self.at_rest()
        BaseRig.frozen = True
        BASE.freeze()

    async def thaw_device(self) -> None:
        BASE.thaw()
        BaseRig.frozen = False

    async def freeze_feedback(self) -> None:
        BASE.tell("put", name="frozen", value=True)

    async def thaw_feedback(self) -> None:
        BASE.tell("put", name="frozen", value=False)

    @asynccontextmanager
    async def foreign_commander(self) -> AsyncGenerator[None]:
        COMMANDER.tell("drive", rate=20, speed=0.5)
        try:
            yield
        finally:
            COMMANDER.tell("rest")


def _steps(count: int) -> dict[str, Any]:
    return {"nested_field": {"int32_value": count}}


class TestRos2Stops(BaseRig, StopSuite):
    """What any stop owes."""
