"""What a client of a hub gets in a frame that it names is what the robot's own gateway answers."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from functools import partial
from typing import Any

import pytest

pytest.importorskip("zenoh")

from backends.fleet.rig import appears, catalogue, hub_at, robot_at, serving
from configuration import key, role, rule, table
from ports import free_port
from rcp_fleet.frames import FrameLists
from rcp_fleet.values import RobotValue
from rcp_gateway.reload import apply
from rcp_gateway.server import prepare
from rcp_gateway.testing import OPERATOR, VIEWER, Client, Served, SteppedClock, eventually
from rcp_kernel.config.file import parse
from rcp_kernel.spi import FrameWatch, Principal

pytestmark = pytest.mark.anyio
_POSE, _SPEED = "/tenant/alpha/sensor/r7/pose", "/tenant/alpha/param/r7/speed_limit"
_ANCHOR = table(
    'features.frames.anchors."/tenant/alpha"', latitude=48.0, longitude=11.5, altitude=519.0
)


async def _in(client: Client, path: str, frame: str, **options: Any) -> dict[str, Any]:
    return await client.request("read", path, body={"frame": frame, "fresh": True, **options})


async def test_reads_and_goals_in_a_frame_are_converted_by_the_robots_own_gateway() -> None:
    port = free_port()
    async with serving(hub_at(port)) as hub, serving(robot_at(port) + _ANCHOR) as robot:
        client, local = hub.client(OPERATOR), robot.client(OPERATOR)
        await appears(client, _POSE)
        own = "/tenant/alpha/sensor/pose"
        there, here = await _in(local, own, "earth"), await _in(client, _POSE, "earth")
        assert here["status"] == "completed", here
        assert here["path"] == _POSE
        for one in (there, here):  # each is a measurement of its own
            del one["body"]["timestamp"]
        assert here["body"] == there["body"]
        assert abs(here["body"]["position"]["latitude"] - 48.0) < 0.01
        part = await _in(client, _POSE, "earth", fields=["position.latitude"])
        assert part["body"] == {"position": {"latitude": there["body"]["position"]["latitude"]}}
        plain = await client.request("read", _POSE)
        assert "latitude" not in plain["body"]["position"]  # what others read is as it was
        for path, mine, frame in (
            (_POSE, own, "nowhere"),
            (_SPEED, "/tenant/alpha/param/speed_limit", "earth"),
        ):
            refused, wanted = await _in(client, path, frame), await _in(local, mine, frame)
            assert refused["status"] == "rejected"
            for fact in ("code", "message", "details"):
                told, said = refused["error"].get(fact), wanted["error"].get(fact)
                said = said.replace(mine, path) if fact == "message" else said
                assert told == said, (refused, wanted)
        refused = await _in(client, "/tenant/alpha/sensor/r7/link", "earth")
        assert refused["error"]["code"] == "filter_unsupported"
        goal = {"position": {"latitude": 48.0, "longitude": 11.5}, "frame": "earth"}
        done = await client.request(
            "execute", "/tenant/alpha/action/r7/move_to", body=goal, within=60.0
        )
        assert done["status"] == "completed", done
        at = (await _in(local, own, "earth"))["body"]["position"]
        assert abs(at["latitude"] - 48.0) < 1e-5
        await client.close()
        await local.close()


async def test_a_read_in_a_frame_is_refused_while_the_robot_is_away() -> None:
    port = free_port()
    async with serving(hub_at(port)) as hub:
        client = hub.client(OPERATOR)
        async with serving(robot_at(port) + _ANCHOR):
            await appears(client, _POSE)
            assert (await _in(client, _POSE, "earth"))["status"] == "completed"
        refused = await _in(client, _POSE, "earth")
        assert refused["error"]["code"] == "adapter_unavailable", refused
        await client.close()


async def test_a_robot_is_not_located_by_a_hub_for_who_may_not_read_its_pose_there() -> None:
    port, path = free_port(), "/tenant/alpha/sensor/r7/odometry"
    everything = rule("discover read subscribe", "/**")
    hidden = role("blind", everything, deny=[rule("discover", "/sensor/r7/pose")])
    text = hub_at(port) + key("blind", VIEWER)  # with a token: all act as the hub at the robot
    async with (
        serving(text + role("blind", everything)) as hub,
        serving(robot_at(port) + _ANCHOR) as robot,
    ):
        client = hub.client(VIEWER)
        await appears(client, path)
        assert (await _in(client, path, "earth"))["status"] == "completed"
        id_ = await client.subscribe(path, frame="earth")
        await _update(client, id_)
        held = await _held(robot)
        await apply(hub.server, prepare(parse(text + hidden, "test"), "test"))
        told = await _notice(client, id_, "no_transform")
        refused = await _in(client, path, "earth")
        assert refused["error"]["code"] == "invalid_value", refused
        assert refused["error"]["message"] == told["message"]
        items = await _in(client, "/tenant/alpha/sensor/**", "earth")
        assert all(one["status"] == "rejected" for one in items["body"]), items
        again = await client.request("subscribe", path, body={"frame": "earth"})
        assert again["error"]["code"] == "invalid_value", again

        async def ended() -> bool:
            return await _held(robot) == held - 1

        await eventually(ended, "the robot publishes it no more", 40.0)
        await client.close()


async def _update(client: Client, id_: str) -> dict[str, Any]:
    return await client.until(lambda one: one["type"] == "update" and one.get("id") == id_, 40.0)


async def _notice(client: Client, id_: str, code: str) -> dict[str, Any]:
    return await client.until(lambda one: one.get("code") == code and one.get("id") == id_, 40.0)


async def _held(robot: Served) -> int:
    """Return how many subscriptions a robot's gateway holds."""
    client = robot.client(OPERATOR)
    reply = await client.request("status")
    await client.close()
    return reply["body"]["subscriptions"]


async def test_subscriptions_in_a_frame_are_converted_by_the_robots_own_gateway() -> None:
    port = free_port()
    async with serving(hub_at(port)) as hub, serving(robot_at(port) + _ANCHOR) as robot:
        client, local = hub.client(OPERATOR), robot.client(OPERATOR)
        await appears(client, _POSE)
        id_ = await client.subscribe(_POSE, frame="earth")
        first, second = await _update(client, id_), await _update(client, id_)
        assert abs(first["body"]["position"]["latitude"] - 48.0) < 0.01
        assert first["path"] == _POSE
        assert second["seq"] > first["seq"]
        part = await client.subscribe(_POSE, frame="earth", fields=["position.latitude"])
        body = (await _update(client, part))["body"]
        assert body["position"].keys() == {"latitude"}
        plain = await client.subscribe(_POSE)  # beside it, as the robot publishes it
        assert "latitude" not in (await _update(client, plain))["body"]["position"]
        many = await client.subscribe("/tenant/alpha/sensor/**", frame="earth")
        assert "latitude" in (await _update(client, many))["body"]["position"]
        wrong = await client.subscribe(_POSE, frame="nowhere")
        told = await _notice(client, wrong, "no_transform")
        refused = await _in(local, "/tenant/alpha/sensor/pose", "nowhere")
        assert told["message"] == refused["error"]["message"]
        battery = "/tenant/alpha/sensor/r7/link"
        reply = await client.request("subscribe", battery, body={"frame": "earth"})
        assert reply["error"]["code"] == "filter_unsupported", reply
        await client.close()
        await local.close()


async def test_what_nobody_wants_in_a_frame_any_more_ends_at_the_robot() -> None:
    port = free_port()
    async with serving(hub_at(port)) as hub, serving(robot_at(port) + _ANCHOR) as robot:
        client, other = hub.client(OPERATOR), hub.client(OPERATOR)
        await appears(client, _POSE)
        first = await client.subscribe(_POSE, frame="earth")
        await _update(client, first)
        held = await _held(robot)
        more = [await client.subscribe(_POSE, frame="earth") for _ in range(3)]
        theirs = await other.subscribe(_POSE, frame="earth")
        for id_ in more:
            await _update(client, id_)
        await _update(other, theirs)
        assert await _held(robot) == held  # of one person: it crosses the link once
        for id_ in (first, *more):
            await client.request("unsubscribe", body={"subscription": id_})
        await _update(other, theirs)
        assert await _held(robot) == held
        await other.close()

        async def ended() -> bool:
            return await _held(robot) == held - 1

        await eventually(ended, "the robot publishes it no more", 40.0)
        await client.close()


async def test_a_subscription_in_a_frame_outlives_its_robot_and_says_what_it_lacks() -> None:
    port = free_port()
    async with serving(hub_at(port)) as hub:
        client = hub.client(OPERATOR)
        async with serving(robot_at(port) + _ANCHOR):
            await appears(client, _POSE)
            id_ = await client.subscribe(_POSE, frame="earth")
            await _update(client, id_)
        told = await _notice(client, id_, "no_transform")
        assert "cannot be reached" in told["message"], told
        async with serving(robot_at(port) + _ANCHOR):
            assert "latitude" in (await _update(client, id_))["body"]["position"]
        await client.close()


async def test_a_subscription_in_a_frame_that_begins_while_the_robot_is_away_says_so() -> None:
    port = free_port()
    async with serving(hub_at(port)) as hub:
        client = hub.client(OPERATOR)
        async with serving(robot_at(port) + _ANCHOR):
            await appears(client, _POSE)
        await eventually(partial(_down, hub), "the hub knows that it is away", 40.0)
        id_ = await client.subscribe(_POSE, frame="earth")
        told = await _notice(client, id_, "no_transform")
        assert "cannot be reached" in told["message"], told
        async with serving(robot_at(port) + _ANCHOR):
            assert "latitude" in (await _update(client, id_))["body"]["position"]
        await client.close()


async def _down(hub: Served) -> bool:
    return hub.supervisor.unit("r7").state == "down"


async def test_values_in_a_frame_of_a_robot_that_was_never_seen_are_waited_for() -> None:
    port = free_port()
    async with serving(hub_at(port)) as hub:  # as after a reload: subscribers come before robots
        values: asyncio.Queue[RobotValue] = asyncio.Queue()
        missing: list[str] = []
        watcher = Principal("ann", ())
        watch = FrameWatch("earth", None, watcher, values.put_nowait, missing.append)
        await eventually(partial(_is_open, hub), "the hub is open", 40.0)
        backend = hub.supervisor.backend
        assert backend is not None
        end = backend.watch_in_frame("sensor/r7/pose", watch)
        assert missing == ["its gateway cannot be reached"]
        async with serving(robot_at(port) + _ANCHOR):
            async with asyncio.timeout(60.0):
                assert "latitude" in (await values.get()).decode()["position"]
            end()


async def _is_open(hub: Served) -> bool:
    return hub.supervisor.backend is not None


async def test_a_list_of_frames_that_fails_in_any_way_is_not_asked_for_at_each_look(
    stepped: SteppedClock, boot: Callable[[], None]
) -> None:
    asked = 0

    async def ask() -> Any:
        nonlocal asked
        asked += 1
        raise KeyError("value")  # of a gateway of another version

    boot()  # so that a list is asked for though none is old
    lists = FrameLists("r7", ask, turns=asyncio.Semaphore())
    for times in (1, 2):
        for _ in range(3):
            assert lists.of("sensor/r7/pose", ready=True) == ()
            await asyncio.wait(asyncio.all_tasks() - {asyncio.current_task()}, timeout=0.01)
        assert asked == times
        stepped.advance(100)
    await lists.close()


async def test_patterns_in_a_frame_are_asked_of_each_robots_gateway() -> None:
    port = free_port()
    second = robot_at(port, gateway="r8").replace(_ANCHOR, "")
    async with (
        serving(hub_at(port)) as hub,
        serving(robot_at(port) + _ANCHOR),
        serving(second),
    ):
        client = hub.client(OPERATOR)
        await appears(client, _POSE)
        await appears(client, "/tenant/alpha/sensor/r8/pose")
        reply = await client.request(
            "read", "/tenant/alpha/sensor/**", body={"frame": "earth", "fresh": True}
        )
        found = {one["path"]: one for one in reply["body"]}
        assert "latitude" in found[_POSE]["body"]["position"], found
        # One that knows no place on the earth is not left out without a word.
        assert found["/tenant/alpha/sensor/r8/pose"]["error"]["code"] == "invalid_value", found
        assert not any(path.endswith("/link") for path in found)
        await client.close()


async def test_discovery_lists_the_frames_that_the_robots_gateway_knows() -> None:
    port = free_port()
    async with serving(hub_at(port)) as hub, serving(robot_at(port) + _ANCHOR) as robot:
        client, local = hub.client(OPERATOR), robot.client(OPERATOR)
        await appears(client, _POSE)
        there = await catalogue(local)
        here = await catalogue(client)
        pose, goal = here[_POSE], here["/tenant/alpha/action/r7/move_to"]
        assert set(pose["frames"]) >= {"earth", "map", "base_link"}, pose
        assert goal["frames"] == there["/tenant/alpha/action/move_to"]["frames"]
        assert "latitude" in str(goal["command_schema"])
        assert "frames" not in here[_SPEED]
        await client.close()
        await local.close()


async def test_whoever_returns_is_told_which_samples_in_a_frame_were_not_kept() -> None:
    port = free_port()
    async with serving(hub_at(port)) as hub, serving(robot_at(port) + _ANCHOR):
        client, after = hub.client(OPERATOR), hub.client(OPERATOR)
        await appears(client, _POSE)
        hello = (await client.request("hello", body={}))["body"]
        id_ = await client.subscribe(_POSE, frame="earth", qos={"reliability": "reliable"})
        last = (await _update(client, id_))["seq"]
        refused = await client.request("subscribe", _POSE, body={"frame": "earth", "history": 5})
        assert refused["error"]["code"] == "filter_unsupported", refused
        client.connection.close()
        plain = await after.subscribe(_POSE)  # others still look

        def later(message: dict[str, Any]) -> bool:
            return message.get("id") == plain and message.get("seq", 0) > last + 3

        await after.until(later, 40.0)
        back = hub.client(OPERATOR)
        again = {name: hello[name] for name in ("session", "resume_token")}
        resumed = await back.request("hello", body={**again, "resume_from": {_POSE: last}})
        assert resumed["status"] == "completed", resumed
        gap = await _notice(back, id_, "gap")
        update = await _update(back, id_)
        assert "latitude" in update["body"]["position"]
        assert gap["last"] == update["seq"] - 1
        assert gap["lost"] == gap["last"] - gap["first"] + 1
        await back.close()
        await after.close()


async def test_a_hub_that_reads_its_configuration_anew_goes_on_in_the_frame() -> None:
    port = free_port()
    text = hub_at(port)
    async with serving(text) as hub, serving(robot_at(port) + _ANCHOR):
        client = hub.client(OPERATOR)
        await appears(client, _POSE)
        id_ = await client.subscribe(_POSE, frame="earth")
        seen = (await _update(client, id_))["seq"]
        changed = parse(text.replace('hub = "h1"', 'hub = "h1"\nidle = 30.0'), "test")
        await apply(hub.server, prepare(changed, "test"))

        def later(message: dict[str, Any]) -> bool:
            return message.get("id") == id_ and message.get("seq", 0) > seen + 20

        await client.until(later, 40.0)
        await client.close()
