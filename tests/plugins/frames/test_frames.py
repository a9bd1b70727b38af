"""Values and goals are converted to the frames that clients name, as far as these may know."""

from __future__ import annotations

import math
from collections.abc import AsyncGenerator, Collection
from typing import Any

import pytest
from jsonschema import Draft202012Validator

import rcp_frames
from configuration import backend, key, role, rule, table
from rcp_frames.shapes import Shape
from rcp_gateway.testing import (
    FeatureSuite,
    MemoryClient,
    ScriptedRobot,
    SteppedClock,
    eventually,
    scripted,
    serve,
)
from rcp_gateway.testing._serve import Served
from rcp_geometry import ecef, geodetic, local
from rcp_kernel.model import Resource
from rcp_kernel.spi import Anchor, Host, RobotFacts
from rcp_kernel.types import (
    AngularVelocity,
    LinearVelocity,
    Point,
    PoseStamped,
    Quaternion,
    Transform,
)
from rcp_profiles.messages import MoveTo, TwistStamped

pytestmark = pytest.mark.anyio
(KIND,) = rcp_frames.rcp_features()
ADMIN, BLIND, FENCED, AWAKE = (f"{n}-{n}-{n}" for n in ("admin", "blind", "fenced", "awake"))
HOME = (48.137154, 11.576124, 519.0)
CONFIG = (
    backend(use="rover")
    + role(
        "blind",
        rule("discover read subscribe execute", "/**"),
        deny=[rule("discover", "/sensor/pose", "/sensor/odometry")],
    )
    + role(
        "awake",
        rule("discover read subscribe", "/sensor/velocity", "/sensor/gain"),
        rule("read", "/sensor/pose", when="sensor.gain > 0.5"),
    )
    + role("fenced", rule("discover read subscribe execute", "/**"))
    + """
[[envelopes]]
name = "yard"
roles = ["fenced"]
paths = ["/action/move_to"]
[envelopes.fence]
inside.yard = [[-10, -10], [10, -10], [10, 10], [-10, 10]]
"""
    + key("admin", ADMIN, roles={"*": ["admin"]})
    + key("blind", BLIND, roles={"alpha": ["blind"]})
    + key("fenced", FENCED, roles={"alpha": ["fenced"]})
    + key("awake", AWAKE, roles={"alpha": ["awake"]})
    + table("features.frames", max_age=30)
    + table(
        "features.frames.origins.gate",
        latitude=HOME[0] + 0.001,
        longitude=HOME[1],
        altitude=HOME[2],
        axes="ned",
    )
)
LEFT = Quaternion(z=math.sin(math.pi / 4), w=math.cos(math.pi / 4))
"""Turned left by a quarter: it faces north where x is east."""
POSE, VELOCITY, MOVE_TO = "/sensor/pose", "/sensor/velocity", "/action/move_to"


def rover(host: Host) -> ScriptedRobot:
    robot = ScriptedRobot(
        host,
        Resource(name="sensor/pose", description="Where.", value=PoseStamped, live=True),
        Resource(name="sensor/velocity", description="Speed.", value=TwistStamped, live=True),
        Resource(name="sensor/gain", description="A number.", value=float, live=True),
        Resource(name="action/move_to", description="Go there.", input=MoveTo, output=MoveTo),
    )
    robot.release.set()
    host.describe(RobotFacts(kind="rover", frames=("map",)))
    host.anchor(Anchor(latitude=HOME[0], longitude=HOME[1], altitude=HOME[2]))
    publish(host)
    return robot


def publish(host: Host, x: float = 3.0, y: float = 4.0) -> None:
    host.publish("sensor/pose", PoseStamped(Point(x, y, 1.0), LEFT))
    velocity = TwistStamped(LinearVelocity(x=1.0), AngularVelocity(z=0.5))
    host.publish("sensor/velocity", velocity)


@pytest.fixture
async def served() -> AsyncGenerator[Served]:
    async with serve(CONFIG, scripted(rover, "rover")) as served:
        yield served


async def read(client: MemoryClient, path: str, **body: Any) -> Any:
    return await client.request("read", path, body=body)


def geo(east: float, north: float, up: float | None = None) -> dict[str, float]:
    """Return a place on the earth, in metres from home."""
    found = geodetic(local(*HOME).point((east, north, up or 0.0)))
    place = dict(zip(("latitude", "longitude", "altitude"), found, strict=True))
    return place if up is not None else {name: place[name] for name in ("latitude", "longitude")}


def ran(served: Served) -> Any:
    return served.life.backend.ran[-1][1]


def at(body: Any) -> tuple[float, float, float]:
    return body["x"], body["y"], body.get("z", 0.0)


def near(*numbers: float) -> Any:
    return pytest.approx(numbers, abs=1e-6)


async def test_a_pose_is_read_on_the_earth(served: Served) -> None:
    reply = await read(served.client(ADMIN), POSE, frame="earth")
    body = reply["body"]
    where = [body["position"][name] for name in ("latitude", "longitude", "altitude")]
    assert local(*HOME).inverse.point(ecef(*where)) == near(3.0, 4.0, 1.0)
    assert body["heading"] % math.tau == pytest.approx(0.0, abs=1e-6)  # north
    assert (body["frame_id"], reply["seq"]) == ("earth", 1)


async def test_values_follow_the_signs_of_each_frame(served: Served) -> None:
    client = served.client(ADMIN)
    velocity = (await read(client, VELOCITY, frame="map"))["body"]
    assert at(velocity["linear"]) == near(0.0, 1.0, 0.0)  # it drives north
    assert at(velocity["angular"]) == near(0.0, 0.0, 0.5)
    earth = (await read(client, VELOCITY, frame="earth"))["body"]
    assert at(earth["linear"]) == near(0.0, 1.0, 0.0)
    ned = (await read(client, VELOCITY, frame="gate"))["body"]
    assert at(ned["linear"]) == pytest.approx((1.0, 0.0, 0.0), abs=1e-4)  # 111 m further north
    assert at(ned["angular"]) == pytest.approx((0.0, 0.0, -0.5), abs=1e-4)  # down is positive
    pose = (await read(client, POSE, frame="gate"))["body"]["position"]
    assert pose["x"] == pytest.approx(4.0 - 111.2, abs=0.5)  # the gate is 0.001 degrees north
    assert (pose["y"], pose["z"]) == pytest.approx((3.0, -1.0), abs=0.01)
    own = (await read(client, POSE, frame="base_link"))["body"]
    assert at(own["position"]) == near(0.0, 0.0, 0.0)


async def test_projections_and_patterns_are_of_converted_values(served: Served) -> None:
    client = served.client(ADMIN)
    reply = await read(client, POSE, frame="earth", fields=["position.latitude"])
    assert list(reply["body"]["position"]) == ["latitude"]
    refused = await read(client, POSE, frame="earth", fields=["position.x"])
    assert refused["error"]["code"] == "filter_unsupported"
    every = (await read(client, "/sensor/*", frame="earth"))["body"]
    assert {one["path"].rpartition("/")[2]: one["body"]["frame_id"] for one in every} == {
        "pose": "earth",
        "velocity": "earth",
    }


async def test_what_cannot_be_converted_is_refused_with_the_known_frames(served: Served) -> None:
    client = served.client(ADMIN)
    unknown = (await read(client, POSE, frame="mars"))["error"]
    assert unknown["code"] == "invalid_value"
    assert unknown["details"]["frames"] == ["base_link", "earth", "gate", "map"]
    assert "base_link" in unknown["remedy"]
    assert (await read(client, "/sensor/gain", frame="map"))["error"][
        "code"
    ] == "filter_unsupported"
    system = await read(client, "/system/status", frame="map")
    assert system["error"]["code"] == "filter_unsupported"
    refused = await client.request("subscribe", POSE, body={"frame": "mars"})
    assert refused["error"]["details"]["frames"] == unknown["details"]["frames"]
    goal = {"position": {"x": 1, "y": 0}, "frame": "mars"}
    missing = (await client.request("execute", MOVE_TO, body=goal))["error"]
    assert missing["details"]["frames"] == unknown["details"]["frames"]


async def test_subscriptions_filter_converted_values_and_replay_them(served: Served) -> None:
    client, host = served.client(ADMIN), served.life.backend.host
    body = {"frame": "gate", "where": {"field": "position.y", "gt": 5.0}, "fields": ["position"]}
    await client.request("subscribe", POSE, id="s", body=body)
    publish(host, x=4.0)
    publish(host, x=6.0)
    update = await client.until(lambda m: m.get("type") == "update")
    assert update["seq"] == 3
    assert update["body"]["position"]["y"] == pytest.approx(6.0, abs=0.01)
    await client.request("subscribe", POSE, id="h", body={"frame": "earth", "history": 3})
    update = await client.until(lambda m: m.get("id") == "h" and m.get("type") == "update")
    assert "latitude" in update["body"]["position"]


async def test_subscribers_of_one_frame_share_one_conversion(
    served: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    moves = 0
    moved = Shape.moved

    def counted(self: Shape, *args: Any) -> Any:
        nonlocal moves
        moves += 1
        return moved(self, *args)

    monkeypatch.setattr(Shape, "moved", counted)
    clients = [served.client(ADMIN) for _ in range(3)]
    for client in clients:
        await client.request("subscribe", POSE, body={"frame": "earth", "initial": False})
    moves = 0
    publish(served.life.backend.host)
    for client in clients:
        await client.until(lambda m: m.get("type") == "update")
    assert moves == 1


async def test_a_subscriber_is_told_once_that_the_pose_is_missing(served: Served) -> None:
    client, host = served.client(ADMIN), served.life.backend.host
    await client.request("subscribe", POSE, id="s", body={"frame": "earth", "initial": False})
    host.anchor(None)
    publish(host)
    notice = await client.until(lambda m: m.get("type") == "notice")
    assert (notice["code"], notice["id"]) == ("no_transform", "s")
    publish(host)
    host.anchor(Anchor(latitude=HOME[0], longitude=HOME[1], altitude=HOME[2]))
    publish(host)
    update = await client.until(lambda m: m.get("type") in ("update", "notice"))
    assert (update["type"], update["seq"]) == ("update", 4)


@pytest.mark.parametrize(
    ("goal", "x", "y", "yaw"),
    [
        ({"position": geo(7.0, -2.0, 0.0), "frame": "earth"}, 7.0, -2.0, None),
        ({"position": geo(7.0, -2.0), "frame": "earth", "yaw": 0.3}, 7.0, -2.0, 0.3),
        (
            {"position": {"x": 2.0, "y": 1.0}, "frame": "base_link", "yaw": 0.0},
            2.0,
            6.0,
            math.pi / 2,
        ),
        ({"position": {"x": 2.0, "y": 1.0}, "frame": "map"}, 2.0, 1.0, None),
        ({"position": {"x": 2.0, "y": 1.0}}, 2.0, 1.0, None),
    ],
)
async def test_a_goal_reaches_the_robot_in_its_own_frame(
    served: Served, goal: dict[str, Any], x: float, y: float, yaw: float | None
) -> None:
    reply = await served.client(ADMIN).request("execute", MOVE_TO, body=goal)
    assert reply["status"] == "completed", reply
    got = ran(served)
    assert got.frame == "map"
    assert (got.position.x, got.position.y) == pytest.approx((x, y), abs=1e-3)
    assert got.yaw == (None if yaw is None else pytest.approx(yaw, abs=1e-4))


@pytest.mark.parametrize(
    "wrong",
    [
        {"position": {"x": 1.0, "y": 2.0}, "frame": "earth"},
        {"position": {"latitude": 91, "longitude": 0}, "frame": "earth"},
        {"position": {"latitude": 1}, "frame": "earth"},
        {"position": {"x": "a", "y": 2.0}, "frame": "base_link"},
        {"position": {"x": 1.0, "y": 2.0, "w": 1}, "frame": "base_link"},
        {"position": {"x": 1.0, "y": 2.0}, "frame": "base_link", "speed": "fast"},
        {"position": {"x": 1.0, "y": 2.0}, "frame": 7},
        {"frame": "earth"},
        [],
    ],
)
async def test_a_wrong_goal_is_refused_whatever_its_frame(served: Served, wrong: Any) -> None:
    reply = await served.client(ADMIN).request("execute", MOVE_TO, body=wrong)
    assert reply["error"]["code"] in ("invalid_value", "out_of_range"), reply
    assert not served.life.backend.ran


async def test_a_fence_checks_the_converted_goal(served: Served) -> None:
    client = served.client(FENCED)
    for goal in (
        {"position": geo(30.0, 0.0), "frame": "earth"},
        {"position": {"x": 8.0, "y": 0.0}, "frame": "base_link"},
    ):
        reply = await client.request("execute", MOVE_TO, body=goal)
        assert reply["error"]["code"] == "out_of_range", reply
    inside = {"position": {"x": 3.0, "y": 0.0}, "frame": "base_link"}
    assert (await client.request("execute", MOVE_TO, body=inside))["status"] == "completed"


async def test_a_fence_refuses_goals_in_frames_that_only_the_robot_knows() -> None:
    async with serve(CONFIG, scripted(rover, "rover")) as served:
        served.life.backend.host.describe(RobotFacts(kind="rover"))
        goal = {"position": {"x": 1.0, "y": 0.0}, "frame": "dock"}
        reply = await served.client(ADMIN).request("execute", MOVE_TO, body=goal)
        assert (reply["status"], ran(served).frame) == ("completed", "dock")
        fenced = await served.client(FENCED).request("execute", MOVE_TO, body=goal)
        assert fenced["error"]["code"] == "out_of_range", fenced
        assert "'dock'" in fenced["message"]
        assert len(served.life.backend.ran) == 1


async def test_a_dry_run_shows_the_converted_goal(served: Served) -> None:
    goal = {"position": {"x": 2.0, "y": 1.0}, "frame": "base_link"}
    reply = await served.client(ADMIN).request("execute", MOVE_TO, body=goal, dry_run=True)
    assert at(reply["body"]["execute"]["position"])[:2] == near(2.0, 6.0)


async def test_who_may_not_read_the_pose_learns_nothing_of_it(served: Served) -> None:
    client = served.client(BLIND)
    hidden = (await read(client, VELOCITY, frame="map"))["error"]
    assert (hidden["code"], hidden["details"]["frames"]) == ("invalid_value", ["base_link"])
    refused = await client.request("subscribe", VELOCITY, body={"frame": "map"})
    assert refused["error"]["message"] == hidden["message"]
    goal = {"position": {"x": 1.0, "y": 0.0}, "frame": "base_link"}
    for dry_run in (True, False):
        reply = await client.request("execute", MOVE_TO, body=goal, dry_run=dry_run)
        assert reply["error"]["code"] == "invalid_value"
    fixed = {"position": geo(1.0, 1.0), "frame": "earth"}
    assert (await client.request("execute", MOVE_TO, body=fixed))["status"] == "completed"


async def test_a_right_that_ends_ends_the_conversion_of_a_subscription(served: Served) -> None:
    client, host = served.client(AWAKE), served.life.backend.host
    host.publish("sensor/gain", 1.0)
    await client.request("subscribe", VELOCITY, id="s", body={"frame": "map"})
    update = await client.until(lambda m: m.get("type") == "update")
    assert at(update["body"]["linear"]) == near(0.0, 1.0, 0.0)
    host.publish("sensor/gain", 0.0)
    publish(host)
    notice = await client.until(lambda m: m.get("type") in ("update", "notice"))
    assert notice["code"] == "no_transform"
    assert "base_link" in notice["message"]


async def test_a_pose_that_is_published_only_for_subscribers_is_requested() -> None:
    def lazy(host: Host) -> ScriptedRobot:
        robot = ScriptedRobot(
            host,
            Resource(name="sensor/pose", description="Where.", value=PoseStamped),
            Resource(name="sensor/velocity", description="Speed.", value=TwistStamped, live=True),
        )
        robot.lazy["sensor/pose"] = PoseStamped(Point(3.0, 4.0), LEFT)
        host.publish("sensor/velocity", TwistStamped(LinearVelocity(x=1.0), AngularVelocity()))
        return robot

    async with serve(CONFIG, scripted(lazy, "rover")) as served:
        client = served.client(ADMIN)
        first = (await read(client, VELOCITY, frame="map"))["error"]
        assert (first["code"], first["retry_after"] > 0) == ("precondition_failed", True)

        async def converted() -> bool:
            return "error" not in await read(client, VELOCITY, frame="map")

        await eventually(converted, "the pose is published")
        velocity = (await read(client, VELOCITY, frame="map"))["body"]
        assert at(velocity["linear"]) == near(0.0, 1.0, 0.0)


async def test_a_pose_too_long_ago_converts_nothing(stepped: SteppedClock) -> None:
    async with serve(CONFIG, scripted(rover, "rover"), clock=stepped.clock) as served:
        client, host = served.client(ADMIN), served.life.backend.host
        stepped.advance(31.0)
        host.publish("sensor/velocity", TwistStamped(LinearVelocity(x=1.0), AngularVelocity()))
        old = (await read(client, VELOCITY, frame="map"))["error"]
        assert old["code"] == "precondition_failed"
        assert old["details"] == {"age": pytest.approx(31.0, abs=1.0), "max_age": 30.0}
        assert "error" not in await read(client, POSE, frame="earth")  # needs no pose but its own
        goal = {"position": {"x": 1.0, "y": 0.0}, "frame": "base_link"}
        refused = await client.request("execute", MOVE_TO, body=goal)
        assert refused["error"]["code"] == "precondition_failed"


async def test_discovery_lists_the_frames_that_a_caller_may_know(served: Served) -> None:
    async def frames(token: str) -> dict[str, Any]:
        reply = await served.client(token).request("discover", "/**")
        return {one["path"][14:]: one.get("frames") for one in reply["body"]["resources"]}

    known = ["base_link", "earth", "gate", "map"]
    assert (await frames(ADMIN)) | {} == await frames(ADMIN)
    every = await frames(ADMIN)
    assert every["sensor/pose"] == every["sensor/velocity"] == every["action/move_to"] == known
    assert every["sensor/gain"] is None
    blind = await frames(BLIND)
    assert blind["sensor/velocity"] == ["base_link"]
    assert blind["action/move_to"] == ["earth", "gate", "map"]


async def test_discovery_shows_that_a_goal_may_be_a_place_on_the_earth(served: Served) -> None:
    async def schema(token: str, **query: Any) -> dict[str, Any] | None:
        reply = await served.client(token).request("discover", MOVE_TO, body=query or None)
        (found,) = reply["body"]["resources"]
        return found.get("command_schema")

    found = await schema(ADMIN)
    assert found is not None
    taken = Draft202012Validator(found).is_valid
    latitude, longitude, altitude = HOME
    for position in (
        {"x": 1.0, "y": 2.0},
        {"x": 1.0, "y": 2.0, "z": None},
        {"latitude": latitude, "longitude": longitude},
        {"latitude": latitude, "longitude": longitude, "altitude": altitude},
    ):
        assert taken({"position": position, "frame": "earth" if "latitude" in position else "map"})
    for position in (
        {"x": 1.0},
        {"latitude": latitude},
        {"latitude": 91.0, "longitude": longitude},
        {"x": 1.0, "y": 2.0, "latitude": latitude, "longitude": longitude},
        {"x": 1.0, "y": 2.0, "altitude": altitude},
    ):
        assert not taken({"position": position})
    assert await schema(ADMIN, schemas=False) is None


class TestFramesSuite(FeatureSuite):
    kind = KIND


@pytest.mark.parametrize("height", [None, 2.0])
@pytest.mark.parametrize("frame", ["map", "base_link", "gate", "earth"])
async def test_a_goal_of_the_profiles_without_a_height_has_none_for_the_robot(
    served: Served, frame: str, height: float | None
) -> None:
    named = ("latitude", "longitude", "altitude") if frame == "earth" else ("x", "y", "z")
    place = dict(zip(named, (*HOME[:2], height), strict=True))
    for position in (place, {name: place[name] for name in named[: 2 if height is None else 3]}):
        goal = {"position": position, "frame": frame}
        reply = await served.client(ADMIN).request("execute", MOVE_TO, body=goal)
        assert reply["status"] == "completed", reply
        assert (ran(served).position.z is None) is (height is None)


async def test_a_repeated_key_returns_its_command_although_the_goal_cannot_be_converted_any_more(
    stepped: SteppedClock,
) -> None:
    async with serve(CONFIG, scripted(rover, "rover"), clock=stepped.clock) as served:
        client = served.client(ADMIN)
        goal = {"position": {"x": 2.0, "y": 0.0}, "frame": "base_link"}
        first = await client.request("execute", MOVE_TO, body=goal, idempotency_key="k")
        assert first["status"] == "completed"
        stepped.advance(31.0)
        again = await client.request("execute", MOVE_TO, body=goal, idempotency_key="k")
        assert (again["status"], again["command"]) == ("completed", first["command"])
        assert len(served.life.backend.ran) == 1


async def test_a_value_is_converted_anew_after_the_anchor_has_moved(served: Served) -> None:
    client, host = served.client(ADMIN), served.life.backend.host
    await client.request("subscribe", POSE, body={"frame": "earth"})  # keeps the conversion
    before = (await read(client, POSE, frame="earth"))["body"]["position"]
    host.anchor(Anchor(latitude=HOME[0] + 1, longitude=HOME[1], altitude=HOME[2]))
    after = (await read(client, POSE, frame="earth"))["body"]["position"]
    assert after["latitude"] - before["latitude"] == pytest.approx(1.0, abs=1e-3)


async def test_a_pose_whose_quaternion_is_not_of_unit_length_converts_without_scaling(
    served: Served,
) -> None:
    client, host = served.client(ADMIN), served.life.backend.host
    host.publish("sensor/pose", PoseStamped(Point(3.0, 4.0, 1.0), Quaternion(0.0, 0.0, 1.0, 1.0)))
    own = (await read(client, POSE, frame="base_link"))["body"]
    assert at(own["position"]) == near(0.0, 0.0, 0.0)


async def test_a_pose_without_an_orientation_converts_no_goal(served: Served) -> None:
    client, host = served.client(ADMIN), served.life.backend.host
    host.publish("sensor/pose", PoseStamped(Point(3.0, 4.0, 1.0), Quaternion(0.0, 0.0, 0.0, 0.0)))
    goal = {"position": {"x": 2.0, "y": 0.0}, "frame": "base_link"}
    reply = await client.request("execute", MOVE_TO, body=goal)
    assert reply["error"]["code"] == "precondition_failed", reply
    assert not served.life.backend.ran


class StaticTree:
    """Frames that do not move: where each is in `map`."""

    def __init__(self, **places: float) -> None:
        self._places = {"map": 0.0, **places}

    def frames(self) -> Collection[str]:
        return self._places

    def lookup(self, target: str, source: str, time: int | None) -> tuple[Transform, float]:
        try:
            x = self._places[source] - self._places[target]
        except KeyError:
            raise LookupError from None
        return Transform(Point(x, 0.0), Quaternion(), target, source), 0.0


def adrift(host: Host) -> ScriptedRobot:
    """Return a robot that reports its pose in a frame which is far from the map."""
    robot = rover(host)
    host.describe(RobotFacts(kind="rover"))
    host.anchor(None)
    host.transforms(StaticTree(odom=100.0, base_link=103.0))
    host.publish("sensor/pose", PoseStamped(Point(3.0, 4.0, 1.0), LEFT, frame_id="odom"))
    return robot


@pytest.mark.parametrize("sees_pose", [True, False])
async def test_a_fence_is_compared_only_with_goals_in_the_frame_of_the_pose(
    *, sees_pose: bool
) -> None:
    rights = 'roles = { alpha = ["fenced", "blind"] }'
    text = CONFIG if sees_pose else CONFIG.replace('roles = { alpha = ["fenced"] }', rights)
    async with serve(text, scripted(adrift, "rover")) as served:
        goal = {"position": {"x": 5.0, "y": 0.0}}  # in the map, 95 m outside
        reply = await served.client(FENCED).request("execute", MOVE_TO, body=goal)
        assert reply["error"]["code"] == "out_of_range", reply
        assert not served.life.backend.ran


def pair(host: Host) -> ScriptedRobot:
    """Return two robots whose backend has one tree for both."""
    names = ("r1", "r2")
    robot = ScriptedRobot(
        host,
        *(
            Resource(
                name=f"sensor/{name}/pose",
                description="Where.",
                value=PoseStamped,
                live=True,
                robot=name,
            )
            for name in names
        ),
    )
    host.transforms(StaticTree(**{"r1/base_link": 7.0, "r2/base_link": 9.0}))
    for name in names:
        host.publish(f"sensor/{name}/pose", PoseStamped(Point(1.0, 2.0), LEFT))
    return robot


async def test_a_tree_of_several_robots_is_for_those_who_may_read_all_their_poses() -> None:
    one = role("one", rule("discover read subscribe", "/sensor/r2/**")) + key(
        "one", "one-one-one-one-one", roles={"alpha": ["one"]}
    )
    async with serve(CONFIG + one, scripted(pair, "rover")) as served:
        path, frame = "/sensor/r2/pose", "r1/base_link"
        assert (await read(served.client(ADMIN), path, frame=frame))["status"] == "completed"
        hidden = (await read(served.client("one-one-one-one-one"), path, frame=frame))["error"]
        assert (hidden["code"], hidden["details"]["frames"]) == (
            "invalid_value",
            ["base_link", "map"],
        )
