"""A simulation that ticks, pauses and begins again, behind a whole gateway."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Iterator
from typing import Any

import pytest

import rcp_ros2
from backends.ros2.robot import BOUND, Simulated, fresh_domain
from configuration import backend, key
from rcp_gateway.testing import Client, Message, eventually, serve

pytestmark = pytest.mark.anyio

EXPOSED = ["/odom", "/cmd_vel", "/tf"]
DRIVE, POSE, JUMP = "/actuator/cmd_vel", "/sensor/pose", "/event/clock_jump"
S = 1_000_000_000


@pytest.fixture(scope="module")
def simulated() -> Iterator[tuple[int, Simulated]]:
    domain = fresh_domain()
    simulator = Simulated(domain)
    simulator.start()
    yield domain, simulator
    simulator.stop()


@pytest.fixture
async def client(simulated: tuple[int, Simulated]) -> AsyncIterator[Client]:
    domain, simulator = simulated
    simulator.tell("resume")
    ros = backend(use="ros2", domain_id=domain, expose=EXPOSED, use_sim_time=True)
    text = ros + key("operator", "operator-operator")
    async with serve(text, *rcp_ros2.rcp_backends()) as served:
        client = served.client("operator-operator")

        async def known() -> bool:
            replies = [await client.request("read", path) for path in (POSE, "/sensor/clock")]
            drives = await client.request("write", DRIVE, body={})
            return all(reply["status"] == "completed" for reply in (*replies, drives))

        await eventually(known, "the simulation is discovered", 2 * BOUND)
        yield client
        await client.close()


def _of_pose(message: Message) -> bool:
    return message["type"] == "update" and message["path"].endswith("sensor/pose")


def _is_simulated(message: Message) -> bool:
    return message["timestamp"].startswith("1970-01-01")


def _seconds(message: Message) -> float:
    hours, minutes, seconds = message["timestamp"].partition("T")[2].rstrip("Z").split(":")
    assert _is_simulated(message), message
    return int(hours) * 3600 + int(minutes) * 60 + float(seconds)


async def _drives(simulator: Simulated, speed: float) -> None:
    async def told() -> bool:
        return simulator.tell("truth")["wanted"] == speed

    await eventually(told, f"the rover is told {speed:g} m/s", BOUND)


async def test_values_and_commands_have_the_time_of_the_simulation(
    client: Client, simulated: tuple[int, Simulated]
) -> None:
    simulator = simulated[1]
    await client.subscribe(POSE)
    published = lambda m: (_of_pose(m) and m["timestamp"][:4] == "1970") or m["seq"] > 3  # noqa: E731 - the first was read
    times = [_seconds(await client.until(published)) for _ in range(5)]
    assert times == sorted(times)
    assert times[-1] <= simulator.tell("truth")["now"] / S + 1e-6  # a float of seconds
    await client.request("write", DRIVE, body={"linear": {"x": 0.5}})
    await _drives(simulator, 0.5)
    truth = simulator.tell("truth")
    assert abs(truth["stamps"][-1] - truth["now"]) < 20 * S  # not years ahead of its clock

    async def moves() -> bool:
        return simulator.tell("truth")["v"] == 0.5 or await _again(client)

    await eventually(moves, "it obeys", BOUND)


async def _again(client: Client) -> bool:
    await client.request("write", DRIVE, body={"linear": {"x": 0.5}})
    return False


async def test_a_dead_man_and_a_stop_do_not_wait_for_a_paused_clock(
    client: Client, simulated: tuple[int, Simulated]
) -> None:
    simulator = simulated[1]
    await client.request("write", DRIVE, body={"linear": {"x": 0.4}}, valid_for=1.0)
    await _drives(simulator, 0.4)
    simulator.tell("pause")
    paused = simulator.tell("truth")["now"]
    await _drives(simulator, 0.0)  # the client was silent
    await client.request("write", DRIVE, body={"linear": {"x": 0.3}}, valid_for=60.0)
    await _drives(simulator, 0.3)
    stop = await client.send(type="execute", path="/system/estop")
    await _drives(simulator, 0.0)
    assert simulator.tell("truth")["now"] == paused
    simulator.tell("resume")
    await client.final(stop)  # unknown or at rest: the odometry stood still with the clock

    async def rests() -> bool:
        reply = await client.request("execute", "/system/estop")
        return reply["status"] == "completed"

    await eventually(rests, "the stop is confirmed by the odometry that is back", BOUND)
    assert simulator.tell("truth")["v"] == 0.0


async def test_a_simulation_that_begins_again_is_followed_from_its_beginning(
    client: Client, simulated: tuple[int, Simulated]
) -> None:
    simulator = simulated[1]
    await client.subscribe(JUMP)
    lookup = {"target": "odom", "source": "base_link"}

    async def found() -> Any:
        return await client.request("execute", "/service/lookup_transform", body=lookup)

    async def knows() -> bool:
        return (await found())["status"] == "completed"

    await eventually(knows, "the frames are known", BOUND)
    before = simulator.tell("truth")["now"] / S
    feed = await client.subscribe(POSE)
    await client.update(feed)
    simulator.tell("reset")
    jump = await client.until(
        lambda m: m["type"] == "update" and m["path"].endswith("clock_jump"), BOUND
    )
    assert jump["body"]["before"] >= before > jump["body"]["after"]
    update = await client.until(
        lambda m: _of_pose(m) and _is_simulated(m) and _seconds(m) < before - 1.0, BOUND
    )
    assert not update.get("stale")
    assert abs(update["body"]["position"]["x"]) < 1.0
    await eventually(knows, "the frames are known again", BOUND)
    past = await client.request(
        "execute", "/service/lookup_transform", body=lookup | {"time": before}
    )
    assert past["error"]["code"] in ("out_of_range", "invalid_value"), past
    read = await client.request("read", POSE, body={"fresh": True})
    assert read["status"] == "completed"
    assert _seconds(read["body"]) < before
    async with asyncio.timeout(BOUND):
        for _ in range(50):  # one jump, and no storm of notices after it
            message = await client.until(lambda _: True)
            assert message["type"] != "notice", message
            assert not message.get("path", "").endswith("clock_jump"), message
