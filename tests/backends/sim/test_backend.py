"""The backend: what it declares and publishes, and how commands begin and end."""

from __future__ import annotations

import asyncio
import itertools
import math
from collections.abc import Callable
from typing import Any

import anyio
import msgspec
import pytest

import rcp_sim
from rcp_kernel.errors import (
    AdapterUnavailable,
    ConfigError,
    DeviceRejected,
    InvalidValue,
    ModeForbids,
    OutOfRange,
    UnsupportedOperation,
)
from rcp_kernel.model import Kind, kind_of
from rcp_kernel.values import value_type
from rcp_sim import SimConfig, open_sim
from rcp_sim.resources import resources

pytestmark = pytest.mark.anyio
RESOURCES = {resource.name: resource for resource in resources(SimConfig())}
LIVE = ("sensor/pose", "sensor/odometry", "sensor/imu")
HERE = {"position": {"x": 2.0, "y": 1.0, "z": 0.0}}


def numbers(schema: Any) -> list[dict[str, Any]]:
    """Return the schemas of all numbers in a schema."""
    if isinstance(schema, list):
        return [found for item in schema for found in numbers(item)]
    if not isinstance(schema, dict):
        return []
    if schema.get("type") in ("number", "integer"):
        return [schema]
    if "unit" in schema and "anyOf" in schema:
        return [schema]
    return [found for item in schema.values() for found in numbers(item)]


def test_the_plugin_offers_itself() -> None:
    (kind,) = rcp_sim.rcp_backends()
    assert kind.name == "sim"
    assert kind.config is SimConfig
    assert kind.description


def test_the_demos_names_are_there() -> None:
    assert {
        "sensor/pose",
        "sensor/odometry",
        "sensor/imu",
        "sensor/scan",
        "sensor/battery",
        "sensor/camera",
        "sensor/map",
        "sensor/points",
        "sensor/transforms",
        "sensor/joint_states",
        "actuator/cmd_vel",
        "param/speed_limit",
        "param/robot_description",
        "action/move_to",
        "action/dock",
        "service/reset_system",
        "event/boot",
        "event/fault",
        "event/task",
    } <= RESOURCES.keys()


@pytest.mark.parametrize("name", RESOURCES)
def test_each_resource_is_described_in_a_sentence_with_good_examples(name: str) -> None:
    resource = RESOURCES[name]
    assert resource.description[0].isupper()
    assert resource.description.endswith(".")
    wanted = value_type(resource.value if resource.value is not None else resource.input)
    for example in resource.examples:
        wanted.convert(example)
    if resource.live and kind_of(name) is Kind.SENSOR and name != "sensor/map":
        assert resource.deadline is not None


@pytest.mark.parametrize("name", RESOURCES)
def test_each_number_has_a_unit(name: str) -> None:
    resource = RESOURCES[name]
    for part in (resource.value, resource.input, resource.output, resource.feedback):
        if part is not None:
            for number in numbers(value_type(part).schema):
                assert number.get("unit"), number


def test_the_configuration_is_strict() -> None:
    assert msgspec.convert({}, SimConfig) == SimConfig()
    hall = {"width": 10, "height": 8, "obstacles": [{"x": 2, "y": 2, "size_x": 1, "size_y": 1}]}
    msgspec.convert({"rate": 1000, "world": hall}, SimConfig).make_world()
    for wrong in ({"rate": 1001}, {"rate": 0}, {"speed": 1}, {"battery": {"volts": 3}}):
        with pytest.raises(msgspec.ValidationError):
            msgspec.convert(wrong, SimConfig)


@pytest.mark.parametrize(
    "config",
    [
        {"start": {"x": 8, "y": 7}},
        {"start": {"x": 19.9}},
        {"faults": [{"fault": "sensor_stop", "target": "sensor/nose"}]},
    ],
)
async def test_an_impossible_configuration_stops_for_good(config: Any, host: Any) -> None:
    with pytest.raises(ConfigError):
        async with open_sim(msgspec.convert(config, SimConfig), host):
            raise AssertionError("it opened")


def test_everything_live_is_there_at_once(rig: Any) -> None:
    for name, resource in RESOURCES.items():
        if resource.live:
            assert rig.host.count(name) == 1, name
    assert rig.host.last("event/boot").reason == "power_on"


@pytest.mark.parametrize("rate", [10, 50, 200, 1000])
def test_values_come_at_their_rates(make_rig: Callable[..., Any], rate: int) -> None:
    rig = make_rig(rate=rate, scan_rate=10, battery_rate=1)
    with rig.device.publisher.watched("sensor/scan", None):
        rig.tick(3)
    for name in LIVE:
        assert rig.host.count(name) == 3 * rate + 1
    assert abs(rig.host.count("sensor/scan") - 30) <= 1
    assert abs(rig.host.count("sensor/battery") - 4) <= 1
    stamps = rig.host.stamps["sensor/pose"][1:]
    assert all(b - a == 1e9 // rate for a, b in itertools.pairwise(stamps))


def test_time_can_run_faster(make_rig: Callable[..., Any]) -> None:
    rig = make_rig(time_scale=10)
    rig.tick(2)
    assert rig.sim.seconds == pytest.approx(20)
    assert rig.host.count("sensor/pose") == 101


async def test_the_scanner_and_the_camera_run_only_while_watched(rig: Any) -> None:
    rig.tick(2)
    assert rig.host.count("sensor/scan") == rig.host.count("sensor/camera") == 0
    async with rig.backend.watch("sensor/scan", None), rig.backend.watch("sensor/camera", None):
        rig.tick(1)
    assert rig.host.count("sensor/scan") == 10
    assert rig.host.count("sensor/camera") == 4
    rig.tick(1)
    assert rig.host.count("sensor/scan") == 10


@pytest.mark.parametrize(
    ("name", "rate"),
    [("sensor/points", 5), ("sensor/transforms", 20), ("sensor/joint_states", 20)],
)
async def test_what_only_a_scene_draws_comes_while_watched(rig: Any, name: str, rate: int) -> None:
    rig.tick(1)
    assert rig.host.count(name) == 0
    async with rig.backend.watch(name, None):
        rig.tick(2)
    assert abs(rig.host.count(name) - 2 * rate) <= 1
    assert await rig.backend.read(name)


async def test_a_watched_sensor_is_no_faster_than_anybody_wants(rig: Any) -> None:
    async with rig.backend.watch("sensor/scan", 2.0):
        rig.tick(2)
        assert rig.host.count("sensor/scan") == 4
        async with rig.backend.watch("sensor/scan", 5.0):
            rig.tick(2)
    assert abs(rig.host.count("sensor/scan") - 14) <= 1


@pytest.mark.parametrize("name", [n for n in RESOURCES if n.startswith(("sens", "act", "par"))])
async def test_each_value_can_be_read(rig: Any, name: str) -> None:
    if kind_of(name) is not Kind.ACTION:
        value_type(RESOURCES[name].value).check(await rig.backend.read(name))


async def test_what_is_not_there_is_refused_by_name(rig: Any) -> None:
    with pytest.raises(UnsupportedOperation, match="event/boot"):
        await rig.backend.read("event/boot")
    with pytest.raises(UnsupportedOperation, match="sensor/pose"):
        await rig.backend.write("sensor/pose", None)
    with pytest.raises(UnsupportedOperation, match="action/fly"):
        await rig.backend.execute("action/fly", None, rig.progress)


@pytest.mark.parametrize(
    "twist",
    [
        {"linear": {"x": 2.6}},
        {"angular": {"z": -2.1}},
        {"linear": {"y": 0.1}},
        {"linear": {"x": "NaN"}},
        {"linear": {"x": float("nan")}},
    ],
)
async def test_the_type_refuses_what_the_drive_cannot_do(rig: Any, twist: Any) -> None:
    with pytest.raises(InvalidValue):
        rig.typed("actuator/cmd_vel", twist)
    with pytest.raises(OutOfRange, match=r"9.0 > 2.5 m/s"):
        rig.typed("param/speed_limit", 9.0)


async def test_a_velocity_moves_the_rover_and_is_cut_to_the_limit(rig: Any) -> None:
    in_force = await rig.drive(2.0, 0.3)
    assert (in_force.linear.x, in_force.angular.z) == (1.0, 0.3)
    rig.tick(2)
    assert rig.host.last("sensor/odometry").twist.linear.x == pytest.approx(1.0)
    assert rig.host.count("actuator/cmd_vel") == 1  # the gateway publishes what was written
    await rig.write("param/speed_limit", 0.5)
    rig.tick(2)
    assert rig.host.last("actuator/cmd_vel").linear.x == 0.5
    assert rig.sim.rover.v == pytest.approx(0.5)


async def test_move_to_arrives_and_tells_its_way(rig: Any) -> None:
    result = await rig.settle(rig.execute("action/move_to", HERE))
    assert math.dist((result.pose.position.x, result.pose.position.y), (2, 1)) <= 0.1
    assert result.error <= 0.1
    assert result.distance == pytest.approx(math.hypot(2, 1), abs=0.2)
    assert result.duration > 2
    value_type(RESOURCES["action/move_to"].output).check(result)
    remaining = [feedback.distance_remaining for feedback, _ in rig.feedback]
    fractions = [fraction for _, fraction in rig.feedback]
    assert len(remaining) > 10
    assert remaining == sorted(remaining, reverse=True)
    assert fractions == sorted(fractions)
    assert fractions[-1] == 1.0
    for feedback, _ in rig.feedback:
        value_type(RESOURCES["action/move_to"].feedback).check(feedback)
    assert [event.state for event in rig.host.samples["event/task"]] == [
        "idle",
        "started",
        "completed",
    ]


async def test_move_to_takes_a_heading_in_either_way(rig: Any) -> None:
    turned = {"x": 0.0, "y": 0.0, "z": math.sin(0.5), "w": math.cos(0.5)}
    await rig.settle(rig.execute("action/move_to", {**HERE, "orientation": turned}))
    assert rig.sim.rover.yaw == pytest.approx(1.0, abs=0.03)
    with pytest.raises(InvalidValue, match="not both"):
        await rig.execute("action/move_to", {**HERE, "orientation": turned, "yaw": 1.0})


async def test_a_goal_in_another_frame_is_refused(rig: Any) -> None:
    with pytest.raises(InvalidValue, match="no frame 'odom'") as caught:
        await rig.execute("action/move_to", {**HERE, "frame": "odom"})
    assert caught.value.details == {"pointer": "/frame"}
    assert rig.host.last("event/task").state == "idle"


async def test_a_null_tolerance_is_the_rovers_own(rig: Any) -> None:
    await rig.settle(rig.execute("action/move_to", {**HERE, "tolerance": None}))
    assert math.dist((rig.sim.rover.x, rig.sim.rover.y), (2.0, 1.0)) <= 0.1


async def test_a_goal_in_a_wall_is_rejected_with_the_reason(rig: Any) -> None:
    with pytest.raises(DeviceRejected, match=r"goal \(100, 0\) is inside or behind"):
        await rig.execute("action/move_to", {"position": {"x": 100.0, "y": 0.0}})
    assert rig.host.last("event/task").state == "idle"


async def test_a_cancelled_drive_has_stopped_when_it_ends(rig: Any) -> None:
    drive = await rig.begin(rig.execute("action/move_to", HERE), seconds=2)
    assert rig.sim.rover.v > 0.5
    drive.cancel()
    with pytest.raises(asyncio.CancelledError):
        await rig.turn(drive, seconds=2)
    assert rig.sim.rover.at_rest
    assert rig.sim.trip is None
    assert rig.host.last("event/task").state == "cancelled"


async def test_halt_ends_the_drive_and_brings_the_rover_to_rest(rig: Any) -> None:
    drive = await rig.begin(rig.execute("action/move_to", HERE), seconds=2)
    await rig.settle(rig.backend.halt(), seconds=1)
    assert rig.sim.rover.at_rest
    with pytest.raises(DeviceRejected, match="halted"):
        await rig.turn(drive, seconds=1)
    assert rig.host.last("event/task").state == "failed"


async def test_halt_stops_a_velocity(rig: Any) -> None:
    await rig.drive(1.0, 1.0)
    rig.tick(2)
    await rig.settle(rig.backend.halt(), seconds=1)
    rig.tick(1)
    assert rig.sim.rover.at_rest
    assert rig.host.last("actuator/cmd_vel").linear.x == 0


async def test_one_drive_at_a_time(rig: Any) -> None:
    drive = await rig.begin(rig.execute("action/move_to", HERE), seconds=1)
    with pytest.raises(ModeForbids):
        await rig.execute("action/dock")
    with pytest.raises(ModeForbids):
        await rig.drive(0.2)
    await rig.drive(0.0)
    with pytest.raises(DeviceRejected, match="stopped by actuator/cmd_vel"):
        await rig.turn(drive, seconds=1)


async def test_the_dead_man_does_not_end_the_trip_that_replaced_its_velocity(rig: Any) -> None:
    await rig.drive(0.5)
    far = {"position": {"x": 5.0, "y": 0.0}}
    trip = await rig.begin(rig.execute("action/move_to", far), seconds=3)
    await rig.write("actuator/cmd_vel", {})  # the dead-man's, without a permit
    assert rig.sim.trip is not None
    await rig.drive(0.0)
    with pytest.raises(DeviceRejected, match="stopped by actuator/cmd_vel"):
        await rig.turn(trip, seconds=1)


async def test_docking_charges(rig: Any) -> None:
    await rig.settle(rig.execute("action/move_to", HERE))
    docked = await rig.settle(rig.execute("action/dock"))
    assert docked.charging
    rig.tick(60)
    charged = rig.host.last("sensor/battery")
    assert charged.charging
    assert charged.current > 0
    assert charged.percentage > docked.percentage
    await rig.drive(0.1)
    rig.tick(2)
    assert not rig.host.last("sensor/battery").charging


async def test_a_reset_brings_back_the_start(rig: Any) -> None:
    await rig.write("param/speed_limit", 2.0)
    await rig.execute("service/place_obstacle", RESOURCES["service/place_obstacle"].examples[0])
    await rig.fault(fault="slow", delay=0.1, target="action/dock")
    await rig.drive(0.5, 0.2)
    rig.tick(3)
    done = await rig.settle(rig.execute("service/reset_system", {"pose": True, "battery": True}))
    assert (done.faults_cleared, done.obstacles_removed) == (1, 1)
    rig.tick()
    assert rig.host.last("param/speed_limit") == 1.0
    assert rig.host.last("sensor/odometry").pose.position.x == 0.0
    assert rig.host.last("sensor/pose").position.x == 0.0
    assert rig.host.last("event/boot").reason == "reset"
    assert rig.sim.pack.charge == pytest.approx(1.0, abs=1e-4)


async def test_a_bare_reset_leaves_the_rover_where_it_is(rig: Any) -> None:
    await rig.drive(0.5)
    rig.tick(3)
    done = await rig.settle(rig.execute("service/reset_system"))
    assert done.pose.position.x > 1.0
    rig.tick()
    assert rig.host.last("sensor/odometry").pose.position.x == 0.0


async def test_boxes_come_and_go(rig: Any) -> None:
    placed = await rig.execute(
        "service/place_obstacle", {"x": 3.0, "y": 0.0, "size_x": 1.0, "size_y": 1.0}
    )
    left = await rig.execute("service/remove_obstacle", {"id": placed.id})
    assert left.placed == {}
    with pytest.raises(DeviceRejected, match="no box"):
        await rig.execute("service/remove_obstacle", {"id": placed.id})
    for wrong, why in (((0.2, 0), "rover is there"), ((50, 0), "outside")):
        box = {"x": wrong[0], "y": wrong[1], "size_x": 1.0, "size_y": 1.0}
        with pytest.raises(DeviceRejected, match=why):
            await rig.execute("service/place_obstacle", box)


async def test_it_runs_by_itself_and_opens_again(host: Any) -> None:
    config = SimConfig(rate=200, time_scale=20, map_resolution=0.5)
    for _ in range(2):
        async with open_sim(config, host) as backend:
            before = host.count("sensor/pose")
            await host.until(lambda before=before: host.count("sensor/pose") >= before + 10)
            goal = value_type(RESOURCES["action/move_to"].input).convert(HERE)
            with anyio.fail_after(60):
                await backend.execute("action/move_to", goal, lambda *_, **__: None)
                await backend.halt()
        with pytest.raises(AdapterUnavailable, match="has stopped"):
            await backend.execute("action/move_to", goal, lambda *_, **__: None)
    assert host.reports == []


async def test_a_breakdown_is_reported_and_ends_the_connection(host: Any) -> None:
    kit = value_type(RESOURCES["service/inject_fault"].input)
    goal = value_type(RESOURCES["action/move_to"].input).convert(HERE)

    async def live() -> None:
        async with open_sim(SimConfig(rate=200, map_resolution=0.5), host) as backend:
            crash = kit.convert({"fault": "crash"})
            await backend.execute("service/inject_fault", crash, lambda *_, **__: None)
            with pytest.raises(AdapterUnavailable):
                await backend.execute("action/move_to", goal, lambda *_, **__: None)
            await anyio.sleep_forever()

    with anyio.fail_after(60), pytest.raises(RuntimeError, match="crash"):
        await live()
    assert host.reports == [("the simulated rover failed: crash, as requested", True)]


async def test_an_error_of_the_owner_passes_through_as_it_is(host: Any) -> None:
    async def live() -> None:
        async with open_sim(SimConfig(map_resolution=0.5), host):
            raise KeyError("mine")

    with anyio.fail_after(60), pytest.raises(KeyError, match="mine"):
        await live()
