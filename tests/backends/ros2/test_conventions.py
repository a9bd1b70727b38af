"""The names that ROS 2 robots have in common: found late, lost, without their types, and by map."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from backends.ros2 import interfaces
from backends.ros2.robot import Wheels, fresh_domain, robot_of
from rcp_kernel.errors import AdapterUnavailable, InvalidValue
from rcp_ros2 import catalog, profiles
from rcp_ros2.conventions import CONVENTIONS, rank_of
from rcp_ros2.idl import MissingType

pytestmark = [
    pytest.mark.anyio,
    pytest.mark.skipif(not interfaces.have_tools(), reason="nav2_msgs cannot be built"),
]
DOMAIN = fresh_domain()
MOBILE = ("drive/1.0", "mobile/1.1")


@pytest.fixture(scope="module")
def wheels() -> Iterator[Wheels]:
    rover = Wheels(DOMAIN, str(interfaces.built()), "stamped", shared_memory=False)
    rover.start()
    yield rover
    rover.stop()


def _claims(robot: Any, name: str) -> tuple[str, ...]:
    return robot.resources[name].profiles if name in robot.resources else ()


async def test_a_claim_comes_with_the_robot_and_is_degraded_by_what_it_loses(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(catalog, "_LINGER", 0.2)
    domain = fresh_domain()
    rover = Wheels(domain, str(interfaces.built()))
    async with robot_of(domain, grace=0.5, poll=0.2) as robot:
        assert not any(resource.profiles for resource in robot.resources.values())
        rover.start()
        try:
            await robot.until(lambda: _claims(robot, "action/move_to") == ("mobile/1.1",))
            await robot.until(lambda: _claims(robot, "sensor/pose") == MOBILE)
            await robot.until(lambda: _claims(robot, "sensor/scan") == ("lidar/1.0",))
            rover.tell("withdraw", name="scan")
            await robot.until(lambda: any(r and "/scan" in r for r in robot.reports))
            assert _claims(robot, "sensor/scan") == ("lidar/1.0",)
            rover.tell("leave")
            await robot.until(lambda: any(r and "/odom" in r for r in robot.reports))
            assert _claims(robot, "sensor/pose") == MOBILE  # gone, not forgotten
            with pytest.raises(AdapterUnavailable):
                await robot.read("sensor/pose")

            async def motion() -> Any:
                return robot.backend.motion(None).at_rest

            await robot.until_async(motion, lambda rests: rests is None)
        finally:
            rover.stop()


async def test_a_stamped_velocity_is_sent_with_its_time(wheels: Wheels) -> None:
    async with robot_of(DOMAIN) as robot:
        await robot.until(lambda: "drive/1.0" in _claims(robot, "actuator/cmd_vel"))
        assert robot.resources["actuator/cmd_vel"].native == "geometry_msgs/msg/TwistStamped"
        value = robot.input("actuator/cmd_vel", {"linear": {"x": 0.3}})
        await robot.backend.write("actuator/cmd_vel", value)

        async def truth() -> Any:
            return wheels.tell("truth")

        await robot.until_async(truth, lambda found: found["v"] > 0.2)
        await robot.backend.halt()
        found = await truth()
        assert abs(found["v"]) < 0.06
        assert all(stamp > 0 for stamp in found["stamps"])


async def test_what_is_exposed_keeps_its_own_names(wheels: Wheels) -> None:
    async with robot_of(DOMAIN, expose=["**"]) as robot:
        names = {"sensor/odom", "sensor/joints", "actuator/cmd_vel", "param/rover/speed_limit"}
        await robot.until(lambda: names <= robot.resources.keys())
        await robot.until(lambda: "mobile/1.1" in _claims(robot, "param/speed_limit"))
        scan = await robot.read("sensor/scan")
        assert (scan.frame_id, scan.header.frame_id, len(scan.intensities)) == ("laser", "", 0)
        battery = await robot.read("sensor/battery")
        assert (battery.percentage, battery.voltage, battery.present) == (0.75, None, False)


async def test_a_parameter_with_two_paths_is_not_set_twice_by_one_write(wheels: Wheels) -> None:
    own, standard = "param/rover/speed_limit", "param/speed_limit"
    async with robot_of(DOMAIN, expose=["**"]) as robot:
        await robot.until(lambda: own in robot.resources and standard in robot.resources)
        before = await robot.read(own)
        assert robot.resources[own].atomic == robot.resources[standard].atomic is not None
        with pytest.raises(InvalidValue, match="same parameter") as refused:
            await robot.backend.write_together({own: before / 2, standard: before})
        assert refused.value.path == standard
        assert await robot.read(own) == before


async def test_a_topic_has_one_actuator_so_that_one_stop_and_one_dead_man_cover_it(
    wheels: Wheels,
) -> None:
    async with robot_of(DOMAIN, expose=["**"]) as robot:
        await robot.until(lambda: "drive/1.0" in _claims(robot, "actuator/cmd_vel"))
        of_topic = [n for n, r in robot.resources.items() if r.meta.get("topic") == "/cmd_vel"]
        assert of_topic == ["actuator/cmd_vel"]
        for forward in (0.3, 0.0):
            value = robot.input("actuator/cmd_vel", {"linear": {"x": forward}})
            await robot.backend.write("actuator/cmd_vel", value)

        async def motion() -> Any:
            return robot.backend.motion(None).at_rest

        await robot.until_async(motion, bool)


async def test_nothing_is_claimed_of_what_the_configuration_leaves_out(wheels: Wheels) -> None:
    async with robot_of(DOMAIN, expose=["/scan"]) as robot:
        await robot.until(lambda: _claims(robot, "sensor/scan"))
        assert robot.resources.keys() == {"sensor/scan"}
    async with robot_of(DOMAIN, expose=["/scan"], nice_names=False) as robot:
        await robot.until(lambda: "sensor/scan" in robot.resources)
        assert not _claims(robot, "sensor/scan")


async def test_a_map_points_a_profile_at_any_topic(wheels: Wheels) -> None:
    mapped = {"sensor/battery": {"topic": "/battery_state", "profile": True}}
    async with robot_of(DOMAIN, map=mapped) as robot:
        await robot.until(lambda: _claims(robot, "sensor/battery") == ("battery/1.0",))
        assert (await robot.read("sensor/battery")).current == -1.5


async def test_a_goal_in_the_action_s_own_form_is_taken(wheels: Wheels) -> None:
    async with robot_of(DOMAIN) as robot:
        await robot.until(lambda: "mobile/1.1" in _claims(robot, "action/move_to"))
        truth = wheels.tell("truth")
        at = {"x": truth["x"] + 0.3, "y": truth["y"]}
        goal = {"pose": {"header": {"frame_id": "odom"}, "pose": {"position": at}}}
        result = await robot.execute("action/move_to", goal)
        assert result.error < 0.2
        assert result.error_code == 0


async def test_without_its_type_an_action_is_missing_and_the_rest_is_claimed(
    wheels: Wheels, monkeypatch: pytest.MonkeyPatch
) -> None:
    known = profiles.load

    def load(name: str, group: str = "msg") -> Any:
        if name.startswith("nav2_msgs/"):
            raise MissingType(name, "no such module")
        return known(name, group)

    monkeypatch.setattr(profiles, "load", load)
    async with robot_of(DOMAIN, grace=0.5) as robot:
        await robot.until(lambda: _claims(robot, "actuator/cmd_vel") == ("drive/1.0",))
        await robot.until(lambda: any(r and "nav2_msgs" in r for r in robot.reports))


def test_a_name_belongs_to_one_resource_only_below_its_robot() -> None:
    ranks = {
        c.resource: [rank_of(c, rest) for rest in ("/odom", "/base/odom", "/scan", "/base_scan")]
        for c in CONVENTIONS
    }
    assert ranks["sensor/pose"] == [0, None, None, None]
    assert ranks["sensor/scan"] == [None, None, 0, 1]
    camera = next(c for c in CONVENTIONS if c.resource == "sensor/camera")
    assert rank_of(camera, "/front/image_raw/compressed") == 0
    assert rank_of(camera, "/image_raw/compressed") == 0
