"""What a graph may do to the gateway: change under it, grow, burst, and fail."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from typing import Any

import pytest

import rcp_ros2
from backends.ros2.robot import BOUND, Fleet, robot_of
from configuration import backend, key
from rcp_gateway.testing import serve
from rcp_kernel.errors import AdapterUnavailable
from timing import in_one_of_three_attempts, in_time

pytestmark = pytest.mark.anyio
STALL = 0.5  # s; below 0.1 s on two cores


@pytest.fixture
def graph(fleet: Fleet) -> Iterator[Fleet]:
    yield fleet
    fleet.tell("withdraw", stem="/odd")


async def test_a_publisher_that_changes_its_type_is_read_as_what_it_is_now(
    fleet_domain: int, graph: Fleet
) -> None:
    graph.tell("offer", topic="/odd/changing", kind="std_msgs/Float64", latched=True)
    graph.tell("say", topic="/odd/changing", data=1.5)
    name = "sensor/odd/changing"
    async with robot_of(fleet_domain, expose=["/odd/*"], poll=0.2, grace=0.5) as robot:
        await robot.until(lambda: name in robot.resources)
        async with robot.backend.watch(name, None):
            assert (await robot.first(name)).data == 1.5
            graph.tell("offer", topic="/odd/changing", kind="std_msgs/String", latched=True)
            graph.tell("say", topic="/odd/changing", data="a text now")
            await robot.until(lambda: robot.of(name)[-1].data == "a text now")
        assert robot.resources[name].native == "std_msgs/msg/String"


async def test_two_types_on_one_topic_are_told_in_words(fleet_domain: int, graph: Fleet) -> None:
    graph.tell("offer", topic="/odd/two", kind="std_msgs/Float64", latched=True)
    graph.tell("say", topic="/odd/two", data=2.5)
    async with robot_of(fleet_domain, expose=["/odd/*"], poll=0.2, grace=0.5) as robot:
        await robot.until(lambda: "sensor/odd/two" in robot.resources)
        graph.tell("offer", topic="/odd/two", kind="std_msgs/String", beside=True)
        message = "/odd/two is published as std_msgs/msg/Float64 by /extra, std_msgs/msg/String by"
        await robot.until(lambda: robot.reports and message in (robot.reports[-1] or ""))
        assert (await robot.read("sensor/odd/two")).data == 2.5
        graph.tell("withdraw", stem="/odd/two")
        await robot.until(lambda: robot.reports[-1] is None)


async def test_a_publisher_that_changes_its_qos_is_heard_on(
    fleet_domain: int, graph: Fleet
) -> None:
    graph.tell("offer", topic="/odd/weak", kind="std_msgs/Float64", latched=True)
    name = "sensor/odd/weak"
    async with robot_of(fleet_domain, expose=["/odd/*"], poll=0.2, grace=0.5) as robot:
        await robot.until(lambda: name in robot.resources)
        async with robot.backend.watch(name, None):
            for number, terms in enumerate(({"reliable": False}, {"latched": True}, {})):
                graph.tell("offer", topic="/odd/weak", kind="std_msgs/Float64", **terms)
                value = float(number)

                async def say(value: float = value) -> Any:
                    await asyncio.to_thread(graph.tell, "say", topic="/odd/weak", data=value)
                    return robot.of(name)[-1:]

                await robot.until_async(say, lambda v, now=value: v and v[0].data == now)


async def test_a_subscriber_with_a_deadline_and_a_lease_is_offered_them(
    fleet_domain: int, graph: Fleet
) -> None:
    graph.tell("hear", topic="/odd/heard", deadline=0.5)
    name = "actuator/odd/heard"
    async with robot_of(fleet_domain, expose=["/odd/*"]) as robot:
        await robot.until(lambda: name in robot.resources)
        await robot.backend.write(name, robot.input(name, {"data": "in time"}))
        await robot.until_async(
            lambda: asyncio.to_thread(graph.tell, "heard"), lambda texts: texts == ["in time"]
        )
        assert not any(robot.reports)


async def test_a_topic_that_the_middleware_refuses_is_told_and_holds_nothing_else_up(
    fleet_domain: int, graph: Fleet
) -> None:
    graph.tell("offer", topic="/odd/mine", kind="std_msgs/Float64")
    mapping = {
        "/actuator/mine": {"topic": "/odd/mine", "type": "std_msgs/msg/String"},
        "/sensor/mine": {"topic": "/odd/mine", "type": "std_msgs/msg/Float64"},
    }
    config: dict[str, Any] = {"map": mapping, "expose": ["/odd/*"], "poll": 0.2, "grace": 0.5}
    async with robot_of(fleet_domain, **config) as robot:
        await robot.until(lambda: mapping.keys() <= {f"/{name}" for name in robot.resources})
        await robot.until(lambda: "sensor/odd/mine" in robot.resources)
        async with robot.backend.watch("sensor/mine", None):
            await robot.until(lambda: robot.reports and "cannot be" in (robot.reports[-1] or ""))
            graph.tell("offer", topic="/odd/later", kind="std_msgs/Float64")
            await robot.until(lambda: "sensor/odd/later" in robot.resources)
        command = robot.input("actuator/mine", {"data": "x"})
        async with asyncio.timeout(60):
            with pytest.raises(AdapterUnavailable):
                await robot.backend.write("actuator/mine", command)


def _busy() -> float:
    """Return the processor's time of all that may hold the interpreter, s."""
    idents = [thread.ident for thread in threading.enumerate() if thread.ident is not None]
    return sum(time.clock_gettime(time.pthread_getcpuclockid(ident)) for ident in idents)


@asynccontextmanager
async def stalls() -> AsyncIterator[list[float]]:
    """Collect how long the threads of Python kept the event loop from a timer.

    Neither what other processes took of the processor counts, nor what the middleware's own threads did.
    """
    late: list[float] = []

    async def tick() -> None:
        while True:
            wall, busy = time.perf_counter(), _busy()
            await asyncio.sleep(0.005)
            wall, busy = time.perf_counter() - wall - 0.005, _busy() - busy
            late.append(min(wall, busy))

    ticking = asyncio.ensure_future(tick())
    try:
        yield late
    finally:
        ticking.cancel()


def _subscribed(ros: Any) -> set[str]:
    return {subscription.topic_name for subscription in ros.node.subscriptions}


@pytest.mark.serial
@in_one_of_three_attempts
async def test_five_hundred_topics_come_without_a_stall_and_are_not_subscribed_to(
    fleet_domain: int, graph: Fleet
) -> None:
    graph.tell("offer_many", stem="/odd/many/t", count=500)
    async with stalls() as late, robot_of(fleet_domain, expose=["/odd/many/*"]) as robot:
        await robot.until(lambda: len(robot.resources) >= 500)
        ros = robot.backend.catalog.shared.ros
        # A stop follows the goals of whatever acts in the namespace, and nothing else.
        followed = {"/fleet/r1/navigate/_action/status", "/fleet/r2/navigate/_action/status"}
        assert await ros.call(_subscribed, ros) <= followed
        graph.tell("say", topic="/odd/many/t7", data="seven")
        async with robot.backend.watch("sensor/odd/many/t7", None):
            assert await ros.call(_subscribed, ros) - followed == {"/odd/many/t7"}
    in_time(max(late), STALL)


@pytest.mark.serial
@in_one_of_three_attempts
async def test_a_burst_arrives_in_order_and_leaves_the_event_loop_alone(
    fleet_domain: int, graph: Fleet
) -> None:
    graph.tell("offer", topic="/odd/burst", kind="std_msgs/Float64")
    name = "sensor/odd/burst"
    async with robot_of(fleet_domain, expose=["/odd/*"]) as robot:
        await robot.until(lambda: name in robot.resources)
        async with robot.backend.watch(name, None):

            async def hello() -> int:
                await asyncio.to_thread(graph.tell, "say", topic="/odd/burst", data=-1.0)
                return len(robot.samples)

            await robot.until_async(hello, bool)
            robot.samples.clear()
            async with stalls() as late:
                await asyncio.to_thread(
                    graph.tell, "say", topic="/odd/burst", data=0.0, times=3000, rate=2000.0
                )
                await robot.until(lambda: robot.samples and robot.of(name)[-1].data == 2999.0)
            values = [v.data for v in robot.of(name) if v.data >= 0]
    assert values == sorted(set(values))
    assert len(values) > 2000  # the middleware keeps ten for a reader that is late
    in_time(max(late), STALL)


async def test_when_the_side_of_ros_ends_the_backend_comes_back_by_itself(
    fleet_domain: int, fleet: Fleet
) -> None:
    domain = backend(use="ros2", domain_id=fleet_domain, namespace="/fleet/r1", expose=["*"])
    text = domain + key("operator", "operator-operator")
    async with serve(text, *rcp_ros2.rcp_backends()) as served:
        client = served.client("operator-operator")
        assert (await _pose(client))["status"] == "completed"
        opened: Any = served.life.backend
        await opened.catalog.shared.ros.stop()
        async with asyncio.timeout(2 * BOUND):
            while len(served.lives) < 2 or (await _pose(client))["status"] != "completed":  # noqa: ASYNC110
                await asyncio.sleep(0.1)
        await client.close()


async def _pose(client: Any) -> Any:
    async with asyncio.timeout(BOUND):
        while True:
            answer = await client.request("read", "/sensor/pose", within=BOUND)
            error = answer.get("error", {})
            if not error.get("retryable") and error.get("code") != "unknown_path":
                return answer
            await asyncio.sleep(0.1)
