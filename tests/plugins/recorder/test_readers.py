"""Every channel is read by the readers of others: `mcap`, `mcap-ros2-support`, `@mcap/core`."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

import httpx
import msgspec
import pytest
import yaml
from geometry_msgs.msg import Point
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from nav_msgs.msg import Odometry
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.interfaces import ConnectionExtRosbag2, QosDurability, QosReliability
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from node import node, npm_packages
from plugins.recorder.gateway import recording
from rcp_foxglove_types import extension, own_part
from rcp_kernel.model import Resource
from rcp_kernel.types import Point as Place
from rcp_kernel.types import PoseStamped
from rcp_kernel.values import value_type
from rcp_profiles.messages import Image
from rcp_ros2.cdr import Codec, Value
from rcp_ros2.native import native_type
from rcp_sim.spatial import Header, PointCloud, PointField, Stamp

pytestmark = pytest.mark.anyio
SCRIPT = Path(__file__).parents[2] / "npm" / "mcap" / "read.mjs"
JPEG = b"\xff\xd8 an image \xff\xd9"
MOMENT = "1970-01-01T00:00:03.000000004Z"


def _file(folder: Path) -> Path:
    (file,) = folder.glob("always.alpha.*.mcap")
    return file


def _in_javascript(file: Path) -> dict[str, Any]:
    packages = npm_packages("mcap")
    script = packages / "read.mjs"
    script.write_text(SCRIPT.read_text())
    done = subprocess.run([node(), script, file], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def _odometry(x: float) -> bytes:
    message = Odometry()
    message.header.stamp.sec = 1_700_000_000
    message.header.frame_id = "odom"
    message.pose.pose.position = Point(x=x, y=0.5, z=0.0)
    return serialize_message(message)


def _of_ros(name: str, value: Any) -> Resource:
    """A resource as the ROS 2 backend declares it: the whole message, or a part of it."""
    return Resource(
        name=name,
        description="From ROS.",
        value=value,
        native="nav_msgs/msg/Odometry",
        native_types={"value": native_type(Odometry)},
        meta={"topic": "/odom", "type": "nav_msgs/msg/Odometry"},
    )


class _Part:
    """A message of which a resource has the position."""

    def __init__(self, data: bytes) -> None:
        self.data = data

    def decode(self) -> float:
        return deserialize_message(self.data, Odometry).pose.pose.position.x


@pytest.mark.filterwarnings("ignore:module 'sre_:DeprecationWarning")  # of rosidl's parser
async def test_ros_messages_are_the_robots_own_bytes_and_a_bag(tmp_path: Path) -> None:
    """Both a whole message and a part of it: the topic is in a bag once, with its QoS."""
    codec = Codec(Odometry)
    whole, part = _of_ros("sensor/odom", codec.type), _of_ros("sensor/x", float)
    sent = [_odometry(float(number)) for number in range(5)]
    async with recording(tmp_path, whole, part) as gateway:
        for data in sent:
            gateway.robot.host.publish("sensor/odom", Value(data, codec))
            gateway.robot.host.publish("sensor/x", _Part(data))
        await gateway.written(10)
        body = {"path": "/tenant/alpha/sensor/odom", "fields": ["pose.pose.position.x"]}
        history = await gateway.admin.request("execute", "/system/history", body=body)
        position = await gateway.admin.request(
            "execute", "/system/history", body={"path": "/tenant/alpha/sensor/x"}
        )
    xs = [one["body"]["pose"]["pose"]["position"]["x"] for one in history["body"]["samples"]]
    assert xs == [one["body"] for one in position["body"]["samples"]] == [0.0, 1.0, 2.0, 3.0, 4.0]
    with _file(tmp_path).open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()], validate_crcs=True)
        found = list(reader.iter_decoded_messages("/tenant/alpha/sensor/odom"))
    assert [one.message.data for one in found] == sent
    assert [one.decoded_message.pose.pose.position.x for one in found] == xs
    async with recording(tmp_path, whole, part, paths=[]) as gateway:
        name = _file(tmp_path).name
        bag = await gateway.get(f"recordings/{name}?format=ros2")
        about = await gateway.get(f"recordings/{name}?format=yaml")
    _check_bag(tmp_path / "bag.mcap", bag, about, sent)
    _read_as_rosbag2_does(tmp_path / "bag", bag, about, sent)


def _check_bag(file: Path, bag: httpx.Response, about: httpx.Response, sent: list[bytes]) -> None:
    """Compare it with what rosbag2's MCAP plugin reads, field by field."""
    file.write_bytes(bag.content)
    with file.open("rb") as opened:
        reader = make_reader(opened, decoder_factories=[DecoderFactory()], validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
        assert [one.message.data for one in reader.iter_decoded_messages()] == sent
    assert summary is not None
    (channel,) = summary.channels.values()
    (schema,) = summary.schemas.values()
    assert (channel.topic, channel.message_encoding) == ("/odom", "cdr")
    assert (schema.name, schema.encoding) == ("nav_msgs/msg/Odometry", "ros2msg")
    qos = yaml.safe_load(channel.metadata["offered_qos_profiles"])
    assert [(one["history"], one["reliability"], one["durability"]) for one in qos] == [(1, 1, 2)]
    info = yaml.safe_load(about.text)["rosbag2_bagfile_information"]
    assert (info["storage_identifier"], info["message_count"]) == ("mcap", 5)
    (topic,) = info["topics_with_message_count"]
    assert topic["message_count"] == 5
    facts = topic["topic_metadata"]
    assert (facts["name"], facts["type"], facts["serialization_format"]) == (
        "/odom",
        "nav_msgs/msg/Odometry",
        "cdr",
    )
    assert yaml.safe_load(facts["offered_qos_profiles"]) == qos
    name = bag.headers["content-disposition"].partition('"')[2].rstrip('"')
    assert info["relative_file_paths"] == [name] == [one["path"] for one in info["files"]]


def _read_as_rosbag2_does(
    folder: Path, bag: httpx.Response, about: httpx.Response, sent: list[bytes]
) -> None:
    """Open the folder that `rcpctl record download --ros2` makes: by its metadata, as a bag."""
    info = yaml.safe_load(about.text)["rosbag2_bagfile_information"]
    folder.mkdir()
    (folder / "metadata.yaml").write_text(about.text)
    (folder / info["relative_file_paths"][0]).write_bytes(bag.content)
    with Reader(folder) as reader:
        (connection,) = reader.connections
        assert (connection.topic, connection.msgtype) == ("/odom", "nav_msgs/msg/Odometry")
        assert connection.msgdef.data.startswith("# This represents")
        assert reader.message_count == connection.msgcount == 5
        assert isinstance(connection.ext, ConnectionExtRosbag2)
        (qos,) = connection.ext.offered_qos_profiles
        assert (qos.reliability, qos.durability) == (
            QosReliability.RELIABLE,
            QosDurability.VOLATILE,
        )
        found = list(reader.messages())
        assert reader.start_time == found[0][1]
        assert reader.end_time == found[-1][1] + 1
    types = get_typestore(Stores.ROS2_HUMBLE)
    assert [data for _, _, data in found] == sent
    xs = [types.deserialize_cdr(data, "nav_msgs/msg/Odometry") for data in sent]
    assert [one.pose.pose.position.x for one in xs] == [0.0, 1.0, 2.0, 3.0, 4.0]


IMAGE = Image(width=4, height=3, data=JPEG, format="jpeg", frame_id="cam", timestamp=MOMENT)
CLOUD = PointCloud(
    Header(Stamp(5, 7), "depth"), 1, 2, [PointField("x", 0)], False, 16, 32, b"\0" * 32
)
POSE = PoseStamped(Place(1.0, 2.0, 0.0), frame_id="map", timestamp="2026-01-01T00:00:00.000000000Z")


async def test_images_and_clouds_are_what_viewers_draw(tmp_path: Path) -> None:
    values: dict[str, Any] = {"image": IMAGE, "cloud": CLOUD, "pose": POSE}
    resources = [
        Resource(name=f"sensor/{name}", description="One.", value=type(value))
        for name, value in values.items()
    ]
    async with recording(tmp_path, *resources) as gateway:
        for name, value in values.items():
            gateway.robot.measure(f"sensor/{name}", value, 3_000_000_004)
        await gateway.written(3)
        for name, value in values.items():  # nothing is lost by that
            body = {"path": f"/tenant/alpha/sensor/{name}"}
            reply = await gateway.admin.request("execute", "/system/history", body=body)
            (sample,) = reply["body"]["samples"]
            assert msgspec.convert(sample["body"], type(value)) == value
    found = _in_javascript(_file(tmp_path))["channels"]
    image, cloud, pose = (found[f"/tenant/alpha/sensor/{name}"] for name in values)
    assert image["schema"] == "foxglove.CompressedImage"
    assert image["last"]["timestamp"] == {"sec": 3, "nsec": 4}
    assert (image["last"]["frame_id"], image["last"]["format"]) == ("cam", "jpeg")
    assert cloud["schema"] == "foxglove.PointCloud"
    assert cloud["last"]["timestamp"] == {"sec": 5, "nsec": 7}
    assert (cloud["last"]["point_stride"], cloud["last"]["frame_id"]) == (16, "depth")
    assert cloud["last"]["fields"][0]["type"] == 7
    assert pose["schema"] == "foxglove.PoseInFrame"
    assert pose["last"]["pose"]["position"] == {"x": 1.0, "y": 2.0, "z": 0.0}


@pytest.mark.parametrize(
    "value",
    [
        POSE,
        PoseStamped(Place(0.0, 0.0, 0.0), frame_id='"timestamp":null,'),
        PoseStamped(Place(0.0, 0.0, 0.0), timestamp="2026-01-01T00:00:00.500000000Z"),
        IMAGE,
        CLOUD,
    ],
)
def test_a_value_with_the_fields_of_a_viewer_is_still_itself(value: Any) -> None:
    kind = value_type(type(value))
    made = extension(kind.schema)
    assert made is not None
    body = msgspec.json.encode(value)
    extended = msgspec.json.decode(made.encode(value, body, 1))
    assert isinstance(extended["timestamp"], dict)
    restored = msgspec.convert(own_part(extended, kind.schema), type(value))
    if getattr(value, "timestamp", "") is None:  # what had no time has that of its sample
        assert restored.timestamp == "1970-01-01T00:00:00.000000001Z"
        restored = msgspec.structs.replace(restored, timestamp=None)
    assert restored == value
