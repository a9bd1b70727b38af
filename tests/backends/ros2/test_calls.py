"""Services, actions and parameters of a living peer."""

from __future__ import annotations

import asyncio
import math
import threading
from contextvars import ContextVar
from typing import Any

import pytest

from backends.ros2.robot import BOUND, Peer, Robot, ignore, robot_of
from rcp_kernel.contract.fence import permitted
from rcp_kernel.errors import (
    AdapterUnavailable,
    Cancelled,
    DeviceRejected,
    DeviceTimeout,
    EstopActive,
)
from rcp_kernel.model import Operation
from rcp_kernel.values import value_type

pytestmark = pytest.mark.anyio


async def test_a_service_answers(robot: Robot) -> None:
    answer = await robot.execute("service/reset")
    assert (answer.success, answer.message) == (True, "reset done")


async def test_a_service_takes_and_returns_every_kind_of_number(robot: Robot) -> None:
    asked = {"int64_value": 2**60, "uint64_value": 2**64 - 1, "string_value": "äöü"}
    answer = await robot.execute("service/add", asked)
    assert answer.int64_value == 2**60 + 1
    assert answer.uint64_value == 2**64 - 1
    assert answer.string_value == "üöä"
    assert math.isnan(answer.float64_value)


async def test_calls_at_once_each_get_their_own_answer(robot: Robot) -> None:
    numbers = range(8)  # a server queues 10
    asked = [{"int64_value": number, "string_value": f"call {number}"} for number in numbers]
    async with asyncio.timeout(BOUND):
        answers = await asyncio.gather(*(robot.execute("service/add", one) for one in asked))
    assert [answer.int64_value - 1 for answer in answers] == list(numbers)
    assert [answer.string_value[::-1] for answer in answers] == [f"call {n}" for n in numbers]


async def test_an_answer_passes_the_executor_without_a_task(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    from rclpy.task import Future, Task

    responses: list[str] = []
    run = Task.__call__

    def noted(task: Any) -> None:
        futures = [one for one in task._args if isinstance(one, Future)]  # noqa: SLF001
        responses.extend(type(future.result()).__name__ for future in futures)
        run(task)

    monkeypatch.setattr(Task, "__call__", noted)
    assert (await robot.execute("service/reset")).success
    assert (await robot.execute("service/reset")).success
    assert "Trigger_Response" not in responses


async def test_a_request_that_was_given_up_is_forgotten(robot: Robot) -> None:
    caller: Any = robot.backend.catalog.bindings["service/slow"]
    with pytest.raises(DeviceTimeout):
        await robot.execute("service/slow")
    await robot.backend.catalog.shared.ros.call(lambda: None)  # behind what forgets it
    assert caller._caller._client.waiting == 0  # noqa: SLF001
    assert (await robot.execute("service/reset")).success


async def test_what_waits_for_the_ros_thread_runs_in_order_each_in_its_own_context(
    robot: Robot,
) -> None:
    ros, caller = robot.backend.catalog.shared.ros, ContextVar("caller", default="nobody")
    busy, free, over = threading.Event(), threading.Event(), asyncio.Event()
    loop = asyncio.get_running_loop()
    heard: list[str] = []
    ros.submit(lambda: (busy.set(), free.wait(BOUND)))
    assert await asyncio.to_thread(busy.wait, BOUND)
    for name in ("ann", "ben", "cid"):
        caller.set(name)
        ros.submit(lambda: heard.append(caller.get()))
    ros.submit(loop.call_soon_threadsafe, over.set)
    free.set()
    await asyncio.wait_for(over.wait(), BOUND)
    assert heard == ["ann", "ben", "cid"]


async def test_a_service_that_says_no_is_a_refusal_with_its_reason(robot: Robot) -> None:
    await robot.execute("service/set_bool", {"data": True})
    with pytest.raises(DeviceRejected, match="it is so already") as caught:
        await robot.execute("service/set_bool", {"data": True})
    assert caught.value.details is not None
    await robot.execute("service/set_bool", {"data": False})


async def test_a_slow_service_times_out_in_time(robot: Robot) -> None:
    async with asyncio.timeout(60):
        with pytest.raises(DeviceTimeout, match=r"did not respond within 0\.5 s"):
            await robot.execute("service/slow")


async def test_an_action_tells_its_feedback_and_its_result(robot: Robot) -> None:
    received: list[Any] = []
    goal = robot.input("action/fibonacci", {"order": 6})

    def progress(feedback: Any = None, **_: Any) -> None:
        received.append(feedback)

    result = await robot.backend.execute("action/fibonacci", goal, progress)
    assert list(result.sequence) == [0, 1, 1, 2, 3, 5, 8]
    updates = [feedback for feedback in received if feedback is not None]
    assert received.count(None) == 1  # it is accepted, which a feedback may overtake
    sequences = [list(feedback.sequence) for feedback in updates]
    whole = [list(result.sequence)[:length][-5:] for length in range(3, 8)]
    assert sequences
    assert (
        sequences == whole[-len(sequences) :]
    )  # the middleware may miss the first for a new client


async def test_a_rejected_goal_is_a_refusal(robot: Robot) -> None:
    with pytest.raises(DeviceRejected, match="rejected the goal"):
        await robot.execute("action/fibonacci", {"order": -1})


async def test_an_aborted_goal_is_a_refusal_with_its_result(robot: Robot) -> None:
    with pytest.raises(DeviceRejected, match="aborted") as caught:
        await robot.execute("action/fibonacci", {"order": 0})
    assert caught.value.details is not None
    assert list(caught.value.details["result"]["sequence"]) == [0, 1]


async def test_a_cancel_reaches_the_server_before_the_command_ends(robot: Robot) -> None:
    moving = asyncio.Event()
    goal = robot.input("action/fibonacci", {"order": 2000})
    command = asyncio.ensure_future(
        robot.backend.execute("action/fibonacci", goal, lambda *_, **__: moving.set())
    )
    await asyncio.wait_for(moving.wait(), BOUND)
    (run,) = robot.backend.catalog.bindings["action/fibonacci"]._goals  # noqa: SLF001 - the server's own word on the goal
    command.cancel()
    with pytest.raises(asyncio.CancelledError):
        await asyncio.wait_for(command, BOUND)
    assert run._result.result()[0] == 5  # noqa: SLF001 - STATUS_CANCELED, said by the server


async def test_halt_cancels_what_runs(robot: Robot) -> None:
    moving = asyncio.Event()
    goal = robot.input("action/fibonacci", {"order": 2000})
    command = asyncio.ensure_future(
        robot.backend.execute("action/fibonacci", goal, lambda *_, **__: moving.set())
    )
    await asyncio.wait_for(moving.wait(), BOUND)
    await asyncio.wait_for(robot.backend.halt(), BOUND)
    with pytest.raises(Exception, match="was stopped"):
        await asyncio.wait_for(command, BOUND)


@pytest.mark.parametrize("turns", [0, 1, 3, 10, 30])
async def test_a_goal_is_stopped_however_early_the_halt_comes(robot: Robot, turns: int) -> None:
    command = asyncio.ensure_future(robot.execute("action/fibonacci", {"order": 100}))
    for _ in range(turns + 1):
        await asyncio.sleep(0)
    await asyncio.wait_for(robot.backend.halt(), BOUND)
    with pytest.raises(Cancelled):
        await asyncio.wait_for(command, BOUND)


async def test_a_parameter_carries_its_range_and_words(robot: Robot) -> None:
    resource = robot.resources["param/speed_limit"]
    assert resource.description == "Fastest the robot may drive."
    schema = value_type(resource.value).schema
    assert (schema["minimum"], schema["maximum"]) == (0, 2.5)
    gear = value_type(robot.resources["param/gear"].value).schema
    assert (gear["minimum"], gear["maximum"], gear["multipleOf"]) == (0, 10, 2)


async def test_a_read_only_parameter_offers_no_write(robot: Robot) -> None:
    operations = robot.resources["param/serial"].operations
    assert operations == Operation.READ | Operation.SUBSCRIBE


async def test_a_parameter_is_read_set_and_told(robot: Robot) -> None:
    async with robot.backend.watch("param/speed_limit", None):
        assert await robot.first("param/speed_limit") == await robot.read("param/speed_limit")
        await robot.backend.write("param/speed_limit", 0.75)
        await robot.until(lambda: robot.of("param/speed_limit")[-1] == 0.75)
    assert await robot.read("param/speed_limit") == 0.75
    assert await robot.read("param/gains") == [0.5, 0.25]


async def test_two_paths_of_one_parameter_are_told_of_its_changes(domain: int, peer: Peer) -> None:
    one = {"node": "/peer", "parameter": "max_speed"}
    async with robot_of(domain, map={"/param/a": one, "/param/b": one}) as robot:
        await robot.until(lambda: {"param/a", "param/b"} <= robot.resources.keys())
        async with robot.backend.watch("param/a", None):
            async with robot.backend.watch("param/b", None):
                await robot.first("param/a")
                await robot.first("param/b")
                await robot.backend.write("param/b", 0.6)
                await robot.until(lambda: robot.of("param/a")[-1] == robot.of("param/b")[-1] == 0.6)
            await robot.backend.write("param/b", 0.5)
            await robot.until(lambda: robot.of("param/a")[-1] == 0.5)


class Unit:
    """What a permit is for."""

    name = "ros2"
    stops = 0


async def test_a_stop_bars_parameters_that_are_said_to_move(domain: int, peer: Peer) -> None:
    target = {"node": "/peer", "parameter": "max_speed"}
    several = {"node": "/peer", "parameters": ["max_speed"], "moves": True}
    mapped = {
        "/param/moving": {**target, "moves": True},
        "/param/plain": target,
        "/service/moving": several,
    }
    async with robot_of(domain, map=mapped) as robot:
        await robot.until(lambda: {name[1:] for name in mapped} <= robot.resources.keys())
        await robot.backend.write("param/plain", 0.5)
        unit = Unit()
        with permitted(unit, unit.stops):
            given = robot.input("service/moving", {"max_speed": 0.75})
            barred = [
                asyncio.ensure_future(robot.backend.write("param/moving", 0.75)),
                asyncio.ensure_future(robot.backend.write_together({"param/moving": 0.75})),
                asyncio.ensure_future(robot.backend.execute("service/moving", given, ignore)),
            ]
            plain = asyncio.ensure_future(robot.backend.write("param/plain", 0.25))
        unit.stops += 1  # before any of them has run
        for request in barred:
            with pytest.raises(EstopActive):
                await request
        await plain
        assert await robot.read("param/moving") == 0.25


async def test_a_parameter_the_node_refuses_is_a_refusal_with_its_reason(robot: Robot) -> None:
    with pytest.raises(DeviceRejected, match="mode must be auto or manual"):
        await robot.backend.write("param/mode", "chaos")
    assert await robot.read("param/mode") == "auto"


async def test_patterns_expose_what_they_name_and_nothing_else(domain: int, peer: object) -> None:
    expose = ["/odom", "/best_effort_sink", "/reset", "/fibonacci", "/peer"]
    async with robot_of(domain, expose=expose) as robot:
        named = {
            "sensor/odom",
            "sensor/pose",
            "sensor/velocity",
            "actuator/best_effort_sink",
            "service/reset",
            "action/fibonacci",
            "sensor/goals/fibonacci",
            "service/cancel/fibonacci",
        }
        # The subscription of a test before may still be on the graph: /odom is an actuator so long.
        await robot.until(
            lambda: {n for n in robot.resources if not n.startswith("param/")} == named
        )
        await robot.until(lambda: len(robot.resources) >= 13)
        assert "param/peer/max_speed" in robot.resources
        assert await robot.read("param/peer/gear") == 2
        await robot.backend.execute("service/reset", None, ignore)


async def test_what_is_not_there_is_an_error_with_a_way_out(domain: int, peer: object) -> None:
    absent: dict[str, Any] = {
        "/sensor/unseen": {"topic": "/unseen"},
        "/sensor/untyped": {"topic": "/odom", "type": "no_such_msgs/msg/Odometry"},
        "/sensor/misled": {
            "topic": "/odom",
            "field": "pose.nowhere",
            "type": "nav_msgs/msg/Odometry",
        },
        "/service/gone": {"service": "/gone", "type": "std_srvs/srv/Trigger"},
        "/action/gone": {"action": "/gone", "type": "test_msgs/action/Fibonacci"},
        "/param/gone": {"node": "/gone", "parameter": "x"},
        "/param/unknown": {"node": "/peer", "parameter": "no_such"},
    }
    words = {
        "sensor/unseen": "no node offers the topic /unseen",
        "sensor/untyped": "no_such_msgs/msg/Odometry is not installed",
        "sensor/misled": "has no field 'nowhere'",
        "service/gone": "no node offers service /gone",
        "action/gone": "no node offers action /gone",
        "param/gone": "the node /gone is not running",
        "param/unknown": "has no parameter 'no_such'",
    }
    async with robot_of(domain, map=absent, grace=1.5) as robot:
        await robot.until(lambda: len(robot.resources) == len(absent))
        unknown = robot.backend.catalog.bindings
        await robot.until(lambda: "no_such" in getattr(unknown["param/unknown"], "why", ""))
        for name, text in words.items():
            called = name.startswith(("service", "action"))
            async with asyncio.timeout(60):
                with pytest.raises(AdapterUnavailable, match=text) as caught:
                    await (
                        robot.backend.execute(name, None, ignore) if called else robot.read(name)
                    )
            assert caught.value.remedy
        await robot.until(lambda: any(robot.reports))
        assert "/unseen" in (robot.reports[-1] or "")
