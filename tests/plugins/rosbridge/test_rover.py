"""A rover that knows nothing of ROS, as a page made for rosbridge sees it."""

from __future__ import annotations

import base64
import json
import struct
import zlib
from collections.abc import AsyncGenerator, Generator
from typing import Any

import pytest

from plugins.rosbridge.rig import OPEN, OPERATOR, ROVER, Page, Site, page, site

FORWARD = {"linear": {"x": 0.4, "y": 0.0, "z": 0.0}, "angular": {"x": 0.0, "y": 0.0, "z": 0.0}}


@pytest.fixture
async def gateway() -> AsyncGenerator[Site]:
    async with site(OPEN, ROVER) as made:
        yield made


@pytest.fixture
async def client(gateway: Site) -> AsyncGenerator[Page]:
    async with page(gateway) as made:
        yield made


async def test_its_topics_have_the_names_and_types_of_a_ros_robot(client: Page) -> None:
    found = await client.values("/rosapi/topics")
    types = dict(zip(found["topics"], found["types"], strict=True))
    assert types["/odom"] == "nav_msgs/msg/Odometry"
    assert types["/cmd_vel"] == "geometry_msgs/msg/Twist"
    assert types["/scan"] == "sensor_msgs/msg/LaserScan"
    assert types["/battery_state"] == "sensor_msgs/msg/BatteryState"
    assert types["/imu/data"] == "sensor_msgs/msg/Imu"
    assert types["/joint_states"] == "sensor_msgs/msg/JointState"
    assert types["/map"] == "nav_msgs/msg/OccupancyGrid"


async def test_a_velocity_is_a_write_that_drives_it_and_odometry_tells(client: Page) -> None:
    await client.send(op="subscribe", topic="/odom", type="nav_msgs/Odometry")
    await client.send(op="advertise", topic="/cmd_vel", type="geometry_msgs/Twist")

    def moves(message: dict[str, Any]) -> bool:
        return message["op"] == "publish" and message["msg"]["twist"]["twist"]["linear"]["x"] > 0.1

    await client.send(op="publish", topic="/cmd_vel", msg=FORWARD)
    moved = await client.until(moves)
    assert moved["topic"] == "/odom"
    assert moved["msg"]["header"]["frame_id"] == "map"
    assert moved["msg"]["header"]["stamp"]["sec"] > 1_000_000_000
    assert len(moved["msg"]["pose"]["covariance"]) == 36


async def test_the_rover_stops_when_the_page_publishes_no_more(client: Page) -> None:
    await client.send(op="subscribe", topic="/odom")
    await client.send(op="publish", topic="/cmd_vel", msg=FORWARD)

    def speed(message: dict[str, Any]) -> float:
        return message["msg"]["twist"]["twist"]["linear"]["x"]

    await client.until(lambda m: m["op"] == "publish" and speed(m) > 0.3)
    await client.until(lambda m: m["op"] == "publish" and abs(speed(m)) < 0.01)


async def test_a_velocity_beyond_the_limits_is_told_with_the_reason(client: Page) -> None:
    fast = {"linear": {"x": 50.0}, "angular": {}}
    await client.send(op="publish", id="p7", topic="/cmd_vel", msg=fast)
    told = await client.status("2.5 m/s")
    assert told["level"] == "error"
    assert told["id"] == "p7"


async def test_an_e_stop_holds_for_pages_too(client: Page) -> None:
    stopped = await client.call("/system/estop", {"scope": "/tenant/alpha", "reason": "test"})
    assert stopped["result"], stopped
    await client.send(op="publish", topic="/cmd_vel", msg=FORWARD)
    told = await client.status("/cmd_vel")
    assert "emergency stop" in told["msg"].lower() or "e-stop" in told["msg"].lower()


async def test_a_call_of_a_trigger_and_of_a_service_that_is_not_there(client: Page) -> None:
    values = await client.values("/reset_system")
    assert values["success"] is True
    assert values["message"]
    missing = await client.call("/no_such_service")
    assert missing["result"] is False
    assert "no service" in missing["values"]


async def test_parameters_are_read_and_written(client: Page) -> None:
    names = (await client.values("/rosapi/get_param_names"))["names"]
    assert "/rover:speed_limit" in names
    done = await client.values("/rosapi/set_param", name="/rover:speed_limit", value="0.7")
    assert done["successful"], done
    found = await client.values("/rosapi/get_param", name="/rover:speed_limit")
    assert json.loads(found["value"]) == pytest.approx(0.7)
    refused = await client.values("/rosapi/set_param", name="/rover:speed_limit", value='"fast"')
    assert not refused["successful"]
    assert refused["reason"]
    absent = await client.values("/rosapi/get_param", name="/rover:nix", default_value="3")
    assert absent["value"] == "3"
    assert not (await client.values("/rosapi/has_param", name="/rover:nix"))["exists"]


async def test_what_does_not_exist_yet_is_waited_for(client: Page) -> None:
    await client.send(op="subscribe", topic="/later", id="s1")
    assert (await client.status("nobody publishes /later"))["level"] == "info"


async def test_unsubscribed_topics_are_silent(client: Page) -> None:
    await client.send(op="subscribe", topic="/imu/data", id="s1")
    await client.message("/imu/data")
    await client.send(op="unsubscribe", topic="/imu/data", id="s1")
    await client.values("/rosapi/get_time")  # what was on its way has arrived
    await client.send(op="unsubscribe", topic="/imu/data", id="s1")
    await client.status("no subscription to /imu/data")
    before = len(client._received)  # noqa: SLF001 - what the client has kept
    await client.values("/rosapi/get_time")
    assert len(client._received) == before  # noqa: SLF001


async def test_throttled_messages_come_as_rarely_as_asked(client: Page) -> None:
    await client.send(op="subscribe", topic="/imu/data", throttle_rate=500, queue_length=1)
    stamps = []
    for _ in range(4):
        stamp = (await client.message("/imu/data"))["header"]["stamp"]
        stamps.append(stamp["sec"] + stamp["nanosec"] / 1e9)
    assert stamps[-1] - stamps[1] > 0.7  # two periods, less what a source may be early


async def test_long_messages_come_in_fragments(client: Page) -> None:
    await client.send(op="subscribe", topic="/scan", fragment_size=1000)
    parts: dict[int, str] = {}
    first = await client.op("fragment", num=0)
    parts[0] = first["data"]
    for number in range(1, first["total"]):
        parts[number] = (await client.op("fragment", id=first["id"], num=number))["data"]
    whole = json.loads("".join(parts[number] for number in sorted(parts)))
    assert whole["topic"] == "/scan"
    assert len(whole["msg"]["ranges"]) > 10
    assert isinstance(first["total"], int)
    assert max(map(len, parts.values())) <= 1000


async def test_messages_as_pictures(client: Page) -> None:
    await client.send(op="subscribe", topic="/odom", compression="png")
    data = base64.b64decode((await client.op("png"))["data"])
    width, height = struct.unpack(">II", data[16:24])
    start = data.index(b"IDAT") + 4
    length = struct.unpack(">I", data[start - 8 : start - 4])[0]
    rows = zlib.decompress(data[start : start + length])
    row = width * 3 + 1
    text = b"".join(rows[at * row + 1 : (at + 1) * row] for at in range(height))
    assert json.loads(text)["topic"] == "/odom"


async def test_messages_in_cbor_have_typed_arrays(client: Page) -> None:
    await client.send(op="subscribe", topic="/scan", compression="cbor")
    message = await client.message("/scan")
    ranges = message["ranges"]
    assert ranges.tag == 85  # float32, little-endian
    assert len(ranges.value) % 4 == 0
    assert message["header"]["frame_id"] == "laser"


async def test_messages_as_the_bytes_of_ros(client: Page) -> None:
    await client.send(op="subscribe", topic="/battery_state", compression="cbor-raw")
    message = await client.message("/battery_state")
    assert message["secs"] > 1_000_000_000
    assert message["bytes"][:4] == b"\x00\x01\x00\x00"


async def test_an_unknown_number_is_null_and_never_a_bare_nan(client: Page) -> None:
    await client.send(op="subscribe", topic="/battery_state")
    assert (await client.message("/battery_state"))["temperature"] is None


async def test_a_goal_has_feedback_and_a_result(client: Page) -> None:
    goal = {"pose": {"header": {"frame_id": "map"}, "pose": {"position": {"x": 0.3, "y": 0.0}}}}
    await client.send(
        op="send_action_goal",
        id="g1",
        action="/navigate_to_pose",
        action_type="nav2_msgs/action/NavigateToPose",
        args=goal,
        feedback=True,
    )
    feedback = await client.op("action_feedback", id="g1")
    assert feedback["values"]["distance_remaining"] >= 0
    result = await client.op("action_result", id="g1")
    assert result["status"] == 4
    assert result["result"] is True


async def test_a_goal_is_cancelled(client: Page) -> None:
    goal = {"pose": {"pose": {"position": {"x": 8.0, "y": 0.0}}}}
    await client.send(
        op="send_action_goal", id="g2", action="/navigate_to_pose", args=goal, feedback=True
    )
    await client.op("action_feedback", id="g2")
    await client.send(op="cancel_action_goal", id="g2", action="/navigate_to_pose")
    result = await client.op("action_result", id="g2")
    assert result["status"] == 5


async def test_a_goal_cancelled_before_it_could_be_sent_is_never_sent() -> None:
    async with site(ROVER, OPEN) as gateway, page(gateway) as client:
        api, busy = gateway.served.server.client_api, ["busy"]

        def others() -> Generator[None]:
            while busy:
                yield

        api.turns.run(api.authenticate(None).identity, others())
        goal = {"pose": {"pose": {"position": {"x": 8.0, "y": 0.0}}}}
        await client.send(op="send_action_goal", id="g5", action="/navigate_to_pose", args=goal)
        await client.send(op="cancel_action_goal", id="g5", action="/navigate_to_pose")
        await client.send(op="nonsense", id="both have come")
        await client.status("nonsense")
        busy.clear()
        result = await client.op("action_result", id="g5")
        assert (result["status"], result["result"]) == (5, True)
        reader = gateway.served.client(OPERATOR)
        assert (await reader.request("read", "/system/commands"))["body"] == []


async def test_a_goal_that_is_refused_ends_at_once(client: Page) -> None:
    goal = {"pose": {"pose": {"position": {"x": 8000.0, "y": 0.0}}}}
    await client.send(op="send_action_goal", id="g3", action="/navigate_to_pose", args=goal)
    result = await client.op("action_result", id="g3")
    assert result["result"] is False
    assert result["status"] == 6
    assert isinstance(result["values"], str)
    await client.send(op="send_action_goal", id="g4", action="/no_such_action", args={})
    assert "no action" in (await client.op("action_result", id="g4"))["values"]


async def test_a_goal_pose_is_driven_to(client: Page) -> None:
    await client.send(op="subscribe", topic="/odom")
    goal = {"header": {"frame_id": "map"}, "pose": {"position": {"x": 0.5, "y": 0.0, "z": 0.0}}}
    await client.send(op="publish", topic="/goal_pose", msg=goal)

    def arrived(message: dict[str, Any]) -> bool:
        at = message["msg"]["pose"]["pose"]["position"]["x"] if message["op"] == "publish" else 0.0
        return abs(at - 0.5) < 0.2

    await client.until(arrived)


async def test_types_are_described(client: Page) -> None:
    found = await client.values("/rosapi/message_details", type="nav_msgs/Odometry")
    first = found["typedefs"][0]
    assert first["type"] == "nav_msgs/msg/Odometry"
    assert first["fieldnames"] == ["header", "child_frame_id", "pose", "twist"]
    assert any(one["type"] == "geometry_msgs/msg/Quaternion" for one in found["typedefs"])
    own = await client.values("/rosapi/message_details", type="rcp/msg/Odometry")
    assert "pose" in own["typedefs"][0]["fieldnames"]
    raw = await client.values("/rosapi/topics_and_raw_types")
    text = raw["typedefs_full_text"][raw["topics"].index("/odom")]
    assert "MSG: geometry_msgs/Twist" in text
    request = await client.values("/rosapi/service_request_details", type="std_srvs/srv/SetBool")
    assert request["typedefs"][0]["fieldnames"] == ["data"]


async def test_every_service_of_rosapi_answers(client: Page) -> None:
    names = (await client.values("/rosapi/services"))["services"]
    for name in [name for name in names if name.startswith("/rosapi/")]:
        response = await client.call(name, {})
        assert isinstance(response["values"], dict if response["result"] else str)


async def test_the_port_of_its_own_serves_it_at_the_root(gateway: Site) -> None:
    gateway.url = f"ws://127.0.0.1:{gateway.port}"
    async with page(gateway, path="/") as client:
        assert "/odom" in (await client.values("/rosapi/topics"))["topics"]
    async with page(gateway, path="") as client:
        assert "/odom" in (await client.values("/rosapi/topics"))["topics"]
