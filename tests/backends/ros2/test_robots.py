"""Many robots in one graph: each under its own name, or with a tenant of its own."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from typing import Any

import msgspec
import pytest

import rcp_ros2
from backends.ros2.robot import BOUND, Fleet, Robot, fresh_domain, robot_of
from configuration import backend, key
from rcp_gateway.testing import Client, Message, serve
from rcp_kernel.values import value_type
from rcp_ros2 import Ros2Config, catalog
from rcp_ros2.naming import Naming, nice

pytestmark = pytest.mark.anyio

EACH: dict[str, Any] = {
    "/sensor/where": {"topic": "odom", "field": "pose.pose.position"},
    "/param/lowest": {"node": "rover", "parameter": "low"},
}
OF_ONE = {
    "action/{}/navigate",
    "actuator/{}/cmd_vel",
    "param/{}/lowest",
    "param/{}/rover/high",
    "sensor/{}/battery",
    "sensor/{}/goals/navigate",
    "sensor/{}/odom",
    "sensor/{}/pose",
    "sensor/{}/scan",
    "sensor/{}/velocity",
    "sensor/{}/where",
    "service/{}/cancel/navigate",
    "service/{}/dock",
}


@pytest.fixture(scope="module")
async def both(fleet_domain: int, fleet: Fleet) -> AsyncIterator[Robot]:
    config: dict[str, Any] = {"robots": ["/fleet/*"], "expose": ["**"], "map": EACH}
    async with robot_of(fleet_domain, **config) as robot:
        await robot.until(lambda: of(robot, "r1") | of(robot, "r2") <= robot.resources.keys())
        yield robot


def of(_robot: Robot, name: str) -> set[str]:
    return {path.format(name) for path in OF_ONE}


async def test_every_robot_has_all_its_paths_below_its_name(both: Robot) -> None:
    found = {name for name in both.resources if "/calls/" not in name}
    assert found >= of(both, "r1") | of(both, "r2")
    extra = {name for name in found if name.split("/")[1] not in ("r1", "r2")}
    assert not extra


async def test_each_robot_claims_its_profiles(both: Robot) -> None:
    for name in ("r1", "r2"):
        cmd_vel, battery = f"actuator/{name}/cmd_vel", f"sensor/{name}/battery"
        await both.until(lambda: "drive/1.0" in both.resources[cmd_vel].profiles)  # noqa: B023 - awaited
        await both.until(lambda: both.resources[battery].profiles == ("battery/1.0",))  # noqa: B023 - awaited
        assert both.resources[cmd_vel].robot == name


async def test_nice_names_are_parts_of_the_same_topics(both: Robot) -> None:
    pose = await both.read("sensor/r1/pose")
    whole = await both.read("sensor/r1/odom")
    where = await both.read("sensor/r1/where")
    assert msgspec.to_builtins(pose.position) == msgspec.to_builtins(where)
    assert whole.pose.pose.position == where
    assert (await both.read("sensor/r1/battery")).percentage == 0.5
    assert list((await both.read("sensor/r2/scan")).ranges) == [1.0]
    assert value_type(both.resources["sensor/r1/velocity"].value).schema


async def test_a_command_reaches_its_robot_alone(both: Robot, fleet: Fleet) -> None:
    path = "actuator/r1/cmd_vel"
    assert both.resources[path].valid_for == 0.5
    await both.backend.write(path, both.input(path, {"linear": {"x": 0.5}}))
    async with both.backend.watch("sensor/r1/velocity", None):
        await both.until(lambda: any(v.linear.x == 0.5 for v in both.of("sensor/r1/velocity")))
    assert fleet.tell("driven", space="/fleet/r2") == 0.0
    await both.backend.halt()


def _forward(robot: Robot, name: str) -> float | None:
    seen = robot.of(name)
    return seen[-1].linear.x if seen else None


async def test_one_robot_is_halted_and_the_other_drives_on(both: Robot, fleet: Fleet) -> None:
    assert {name.split("/")[1]: made.robot for name, made in both.resources.items()} == {
        "r1": "r1",
        "r2": "r2",
    }
    for name in ("r1", "r2"):
        path, seen = f"actuator/{name}/cmd_vel", f"sensor/{name}/velocity"
        async with both.backend.watch(seen, None):
            await both.backend.write(path, both.input(path, {"linear": {"x": 0.25}}))
            await both.until(lambda seen=seen: _forward(both, seen) == 0.25)
    async with both.backend.watch("sensor/r1/velocity", None):
        await both.backend.halt_robot("r1")
        await both.until(lambda: _forward(both, "sensor/r1/velocity") == 0.0)
    assert fleet.tell("driven", space="/fleet/r2") == 0.25
    await both.backend.halt()


async def test_a_robot_that_comes_is_there_and_one_that_leaves_is_not(
    both: Robot, fleet: Fleet, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(catalog, "_LINGER", 0.5)
    fleet.tell("add", space="/fleet/r3")
    await both.until(lambda: of(both, "r3") <= both.resources.keys())
    assert await both.read("param/r3/lowest") == 1.0
    fleet.tell("drop", space="/fleet/r3")
    await both.until(lambda: not of(both, "r3") & both.resources.keys(), 2 * BOUND)
    assert of(both, "r1") <= both.resources.keys()


async def test_robots_of_one_graph_have_tenants_that_share_nothing_and_paths_come_and_go_live(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(catalog, "_LINGER", 0.5)
    domain = fresh_domain()
    fleet = Fleet(domain, "/fleet/r1")
    fleet.start()
    graph: dict[str, Any] = {"use": "ros2", "domain_id": domain, "expose": ["**"]}
    text = (
        backend("one", namespace="/fleet/r1", **graph)
        + backend("two", "beta", robot="second", namespace="/fleet/r2", **graph)
        + key("a", "operator-of-alpha", role="operator", tenants=["alpha"])
        + key("b", "operator-of-beta", role="operator", tenants=["beta"])
    )
    try:
        async with serve(text, *rcp_ros2.rcp_backends()) as served:
            alpha, beta = served.client("operator-of-alpha"), served.client("operator-of-beta")
            watching = await beta.send(type="subscribe", path="/sensor/**", body={"rate": 5})
            fleet.tell("add", space="/fleet/r2")
            path, profiled = (f"/tenant/beta/sensor/second/{name}" for name in ("odom", "pose"))
            came = lambda m: m.get("code") == "resource_added" and m["path"] == path  # noqa: E731
            assert (await beta.until(came, BOUND))["id"] == watching
            posed = lambda m: m["type"] == "update" and m["path"] == profiled  # noqa: E731
            update = await beta.until(posed, BOUND)
            assert update["body"]["position"]["x"] == len("/fleet/r2")
            own = await _there(alpha, "/sensor/pose")
            assert own["body"]["position"]["x"] == len("/fleet/r1")
            found = await alpha.request("discover", "/**")
            assert not [r for r in found["body"]["resources"] if "beta" in r["path"]]
            for other in (path, profiled):
                hidden = await alpha.request("read", other)
                assert hidden["error"]["code"] == "unknown_path"

            # What a configured robot claims stays until it is back; the rest leaves with its nodes.
            fleet.tell("drop", space="/fleet/r2")
            gone = lambda m: m.get("code") == "resource_removed" and m["path"] == path  # noqa: E731
            await beta.until(gone, 2 * BOUND)
            await alpha.close()
            await beta.close()
    finally:
        fleet.stop()


async def _there(client: Client, path: str) -> Message:
    """Read what may still have to be discovered."""
    async with asyncio.timeout(BOUND):
        while (reply := await client.request("read", path))["status"] != "completed":  # noqa: ASYNC110
            await asyncio.sleep(0.1)
    return reply


def paths(branch: str, name: str, type_: str, **config: Any) -> list[str]:
    naming = Naming(msgspec.convert(config, Ros2Config))
    return [naming.path(branch, other) for other, _ in nice(branch, name, type_)]


def test_nice_names_go_by_type_and_by_the_end_of_the_name() -> None:
    scan = "sensor_msgs/msg/LaserScan"
    assert paths("sensor", "/front/base_scan", scan) == ["sensor/front/scan"]
    assert paths("sensor", "/front_scan", scan) == []
    assert paths("sensor", "/scan", "std_msgs/msg/String") == []
    imu = "sensor_msgs/msg/Imu"
    assert paths("sensor", "/r1/imu/data", imu, robots=["/*"]) == ["sensor/r1/imu"]
    odom = paths("sensor", "/odom", "nav_msgs/msg/Odometry")
    assert odom == ["sensor/pose", "sensor/velocity"]


def test_a_robot_is_named_by_what_the_stars_stand_for() -> None:
    naming = Naming(msgspec.convert({"robots": ["/site/*/rover*", "/crane"]}, Ros2Config))
    assert naming.split("/site/north/rover7/odom") == ("north_7", "/site/north/rover7", "/odom")
    assert naming.split("/crane/hook") == ("crane", "/crane", "/hook")
    assert naming.split("/cranes/hook") == (None, "", "/cranes/hook")
    with pytest.raises(ValueError, match="would be ambiguous"):
        Ros2Config(robots=("/fleet/**",))


async def test_a_name_that_somebody_gave_goes_before_a_nice_one(
    fleet_domain: int, fleet: Fleet
) -> None:
    fleet.tell("offer", topic="/fleet/r1/pose", kind="geometry_msgs/PoseStamped")
    fleet.tell("offer", topic="/fleet/r1/scan/base_scan", kind="sensor_msgs/LaserScan")
    given = {"/sensor/velocity": {"topic": "odom", "field": "twist.twist.linear"}}
    config: dict[str, Any] = {"namespace": "/fleet/r1", "expose": ["*", "scan/*"], "map": given}
    async with robot_of(fleet_domain, **config) as robot:
        await robot.until(lambda: "sensor/scan/scan" in robot.resources)
        await robot.until(lambda: robot.resources["sensor/pose"].meta["topic"].endswith("/pose"))
        assert robot.resources["sensor/velocity"].meta["field"] == "twist.twist.linear"
    fleet.tell("withdraw", stem="/fleet/r1")


async def test_what_the_map_commands_has_no_second_path_past_its_limits(
    fleet_domain: int, fleet: Fleet
) -> None:
    given: dict[str, Any] = {
        "/actuator/drive": {"topic": "cmd_vel"},
        "/action/go": {"action": "navigate"},
        "/service/park": {"service": "dock"},
        "/param/low": {"node": "rover", "parameter": "low"},
        "/sensor/where": {"topic": "odom"},
    }
    async with robot_of(fleet_domain, namespace="/fleet/r1", expose=["*"], map=given) as robot:
        await robot.until(lambda: {"param/rover/high", "sensor/odom"} <= robot.resources.keys())
        await robot.until(lambda: given.keys() <= {f"/{name}" for name in robot.resources})
        second = {"actuator/velocity", "actuator/cmd_vel", "action/navigate", "service/dock"}
        assert not (second | {"param/rover/low"}) & robot.resources.keys()


async def test_nice_names_can_be_turned_off(fleet_domain: int, fleet: Fleet) -> None:
    config: dict[str, Any] = {"namespace": "/fleet/r1", "expose": ["*"], "nice_names": False}
    async with robot_of(fleet_domain, **config) as robot:
        await robot.until(
            lambda: {"sensor/battery_state", "actuator/cmd_vel"} <= robot.resources.keys()
        )
        assert not {"sensor/battery", "sensor/pose", "actuator/velocity"} & robot.resources.keys()
