"""Maps and clouds that are cropped and decimated: right in every number, and the same for every wire."""

from __future__ import annotations

import asyncio
import math
import threading
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from typing import Any

import msgspec
import numpy as np
import pytest
import rclpy
from nav_msgs.msg import OccupancyGrid
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import PointCloud2, PointField
from websockets.asyncio.client import connect

import rcp_ros2
from backends.ros2.robot import fresh_domain
from configuration import backend, key, listener, table
from plugins.foxglove.viewer import viewing
from plugins.rosbridge.rig import OPERATOR, Page
from rcp_foxglove import rcp_adapters
from rcp_gateway.testing import serve
from rcp_kernel.config.file import parse
from rcp_kernel.errors import ConfigError, DeviceRejected
from rcp_ros2 import Ros2Config
from rcp_ros2.reduction import reduction
from rcp_rosbridge import ROSBRIDGE

pytestmark = pytest.mark.anyio
CLOUD, MAP = "sensor_msgs/msg/PointCloud2", "nav_msgs/msg/OccupancyGrid"
BOX = (-1.0, -1.0, 0.0, 1.0, 1.0, 2.0)


def cloud(
    count: int = 1000, *, rows: int = 1, padding: int = 0, big: bool = False, double: bool = False
) -> PointCloud2:
    """Make a cloud in a cube of 6 m with its number in each point, some of them without a place."""
    letter, size, kind = ("f8", 8, PointField.FLOAT64) if double else ("f4", 4, PointField.FLOAT32)
    order = ">" if big else "<"
    form = np.dtype([(n, order + letter) for n in "xyz"] + [("number", order + "u4")])
    points = np.zeros(count, form)
    numbers = np.random.default_rng(7)
    for name in "xyz":
        points[name] = numbers.uniform(-3, 3, count)
    points["x"][::50] = math.nan
    points["number"] = np.arange(count)
    made = PointCloud2(height=rows, width=count // rows, is_bigendian=big, is_dense=False)
    made.header.frame_id = "lidar"
    made.header.stamp.sec = 12
    made.fields = [
        *(PointField(name=n, offset=i * size, datatype=kind, count=1) for i, n in enumerate("xyz")),
        PointField(name="number", offset=3 * size, datatype=PointField.UINT32, count=1),
    ]
    made.point_step = form.itemsize
    made.row_step = form.itemsize * made.width + padding
    lines = points.reshape(rows, -1)
    made.data = b"".join(line.tobytes() + bytes(padding) for line in lines)
    return made


def points_of(message: PointCloud2, *, double: bool = False) -> Any:
    order = ">" if message.is_bigendian else "<"
    letter = "f8" if double else "f4"
    form = np.dtype([(n, order + letter) for n in "xyz"] + [("number", order + "u4")])
    return np.frombuffer(bytes(message.data), form)


def grid(yaw: float = 0.0) -> OccupancyGrid:
    """Make a map of 60 x 40 cells of 0.5 m whose corner is at (-10, -5): cell (c, r) is free but for some."""
    made = OccupancyGrid()
    made.header.frame_id = "map"
    made.info.resolution = 0.5
    made.info.width, made.info.height = 60, 40
    made.info.origin.position.x, made.info.origin.position.y = -10.0, -5.0
    made.info.origin.orientation.z = math.sin(yaw / 2)
    made.info.origin.orientation.w = math.cos(yaw / 2)
    cells = np.zeros((40, 60), np.int8)
    cells[0, :] = -1
    cells[10, 20] = 100
    made.data = cells.flatten().tolist()
    return made


def reduced(message: Any, crop: Any = None, every: int | None = None) -> Any:
    name = CLOUD if isinstance(message, PointCloud2) else MAP
    data = reduction(name, crop, every)(serialize_message(message))
    return deserialize_message(data, type(message))


@pytest.mark.parametrize(
    "form",
    [{}, {"double": True}, {"big": True}, {"rows": 10}, {"rows": 10, "padding": 12}],
    ids=str,
)
def test_a_cropped_cloud_has_the_points_within_and_all_of_them(form: dict[str, Any]) -> None:
    whole = cloud(**form)
    found = reduced(whole, BOX)
    double = form.get("double", False)
    plain = dict(form) | {"rows": 1, "padding": 0}
    points = points_of(cloud(**plain), double=double)
    within = (np.abs(points["x"]) <= 1) & (np.abs(points["y"]) <= 1)
    within &= (points["z"] >= 0) & (points["z"] <= 2)
    assert 0 < within.sum() < 100
    assert points_of(found, double=double).tolist() == points[within].tolist()
    assert (found.height, found.width) == (1, within.sum())
    assert found.row_step == found.width * found.point_step == len(found.data)
    assert found.header == whole.header
    assert found.fields == whole.fields
    assert found.is_dense == whole.is_dense


def test_a_decimated_cloud_has_each_nth_point() -> None:
    assert points_of(reduced(cloud(), None, 7))["number"].tolist() == list(range(0, 1000, 7))
    both = points_of(reduced(cloud(), BOX, 3))["number"].tolist()
    assert both == points_of(reduced(cloud(), BOX))["number"].tolist()[::3]


def test_an_empty_cloud_stays_one() -> None:
    assert reduced(cloud(0), BOX, 2).width == 0
    assert reduced(cloud(), (50.0, 50.0, 50.0, 51.0, 51.0, 51.0)).width == 0


@pytest.mark.parametrize("yaw", [0.0, math.pi / 2, 0.3])
def test_a_cropped_map_has_its_cells_where_they_were(yaw: float) -> None:
    whole = grid(yaw)
    wall = place(whole, 20, 10)
    near = (wall[0] - 2, wall[1] - 2, wall[0] + 2, wall[1] + 2)
    found = reduced(whole, near)
    assert found.info.width < 20
    assert found.info.height < 20
    cells = np.array(found.data, np.int8).reshape(found.info.height, found.info.width)
    (row,), (column,) = np.nonzero(cells == 100)
    assert place(found, column, row) == pytest.approx(wall, abs=1e-5)
    assert found.info.resolution == pytest.approx(0.5)


def place(of: OccupancyGrid, column: int, row: int) -> tuple[float, float]:
    """Return where the lowest corner of a cell is."""
    origin = of.info.origin
    yaw = 2 * math.atan2(origin.orientation.z, origin.orientation.w)
    u, v = column * of.info.resolution, row * of.info.resolution
    return (
        origin.position.x + u * math.cos(yaw) - v * math.sin(yaw),
        origin.position.y + u * math.sin(yaw) + v * math.cos(yaw),
    )


def test_a_decimated_map_loses_no_obstacle_and_ends_where_it_ended() -> None:
    found = reduced(grid(), None, 7)
    assert (found.info.width, found.info.height) == (9, 6)
    assert found.info.resolution == pytest.approx(3.5)
    cells = np.array(found.data, np.int8).reshape(6, 9)
    assert cells[10 // 7, 20 // 7] == 100
    assert (cells == 100).sum() == 1
    assert cells[0].max() == 0  # free where a part of it is known
    assert reduced(grid(), (100.0, 100.0, 101.0, 101.0), 2).info.width == 0


@pytest.mark.parametrize(
    ("type_", "crop", "said"),
    [
        (CLOUD, (0.0, 0.0, 1.0, 1.0), "6 numbers"),
        (MAP, BOX, "4 numbers"),
        ("sensor_msgs/msg/Image", None, "not for sensor_msgs/msg/Image"),
    ],
)
def test_what_cannot_be_reduced_is_a_fault_of_the_mapping(type_: str, crop: Any, said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        reduction(type_, crop, 2)


def test_damaged_messages_are_refused_and_never_read_beyond() -> None:
    for message in (cloud(20), grid()):
        name = CLOUD if isinstance(message, PointCloud2) else MAP
        data = serialize_message(message)
        reduce = reduction(name, BOX if name == CLOUD else BOX[:4], 2)
        for length in range(0, len(data) - 8, 3):
            with pytest.raises(DeviceRejected):
                reduce(data[:length])
    wrong = cloud(10)
    wrong.width = 2**31
    with pytest.raises(DeviceRejected):
        reduced(wrong, BOX)
    wrong = cloud(10)
    wrong.fields[0].offset = 2**31
    with pytest.raises(DeviceRejected, match="beyond"):
        reduced(wrong, BOX)
    wrong = cloud(10)
    wrong.fields = wrong.fields[1:]
    with pytest.raises(DeviceRejected, match="no x"):
        reduced(wrong, BOX)


@pytest.mark.parametrize(
    ("path", "options", "said"),
    [
        ("/sensor/points", {"crop": [1, 1, 1, 0, 0, 0]}, "lowest corner"),
        ("/sensor/points", {"crop": [0, 0, 0, 1, 1]}, "4 or 6 numbers"),
        ("/sensor/points", {"decimate": 2, "field": "data"}, "whole messages"),
        ("/event/points", {"rate": 2}, "for sensors"),
        ("/sensor/points", {"decimate": 1}, ">= 2"),
    ],
)
def test_wrong_options_are_refused(path: str, options: dict[str, Any], said: str) -> None:
    with pytest.raises(msgspec.ValidationError, match=said):
        msgspec.convert({"map": {path: {"topic": "/points", **options}}}, Ros2Config)


DOMAIN = fresh_domain()
ROBOT = backend(
    "robot",
    use="ros2",
    domain_id=DOMAIN,
    stop={"feedback": False},
    map={
        "/sensor/points": {"topic": "/points", "type": CLOUD, "crop": list(BOX), "rate": 5},
        "/sensor/map": {"topic": "/map", "type": MAP, "decimate": 4},
    },
)


@asynccontextmanager
async def publishing() -> AsyncGenerator[None]:
    """Publish a map once, and clouds at 50 Hz."""
    context = Context()
    rclpy.init(context=context, domain_id=DOMAIN)
    node = rclpy.create_node("lidar", context=context)
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    node.create_publisher(OccupancyGrid, "/map", latched).publish(grid())
    points, message = node.create_publisher(PointCloud2, "/points", 5), cloud()
    node.create_timer(0.02, lambda: points.publish(message))
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    thread = threading.Thread(target=executor.spin, daemon=True)
    thread.start()
    try:
        yield
    finally:
        executor.shutdown()
        await asyncio.to_thread(thread.join, 20)
        node.destroy_node()
        context.shutdown()


async def test_every_wire_has_the_reduced_message() -> None:
    expected = points_of(reduced(cloud(), BOX))["number"].tolist()
    text = listener() + ROBOT + table("anonymous", role="operator") + key("operator", OPERATOR)
    text += table("plugins.rosbridge") + table("plugins.foxglove")
    kinds, adapters = rcp_ros2.rcp_backends(), (ROSBRIDGE, *rcp_adapters())
    async with publishing(), serve(parse(text, "test"), *kinds, adapters=adapters) as served:
        url = next(f["url"] for f in served.server.status.transports if "url" in f)
        client = served.client(OPERATOR)
        id_ = await client.subscribe("/tenant/alpha/sensor/points", initial=False)
        async with asyncio.timeout(60):
            first, second = [await client.update(id_) for _ in range(2)]
        assert first["body"]["width"] == len(expected)
        assert second["seq"] == first["seq"] + 1
        async with asyncio.timeout(60):
            read = await client.request("read", "/tenant/alpha/sensor/map")
        assert (read["body"]["info"]["width"], read["body"]["info"]["height"]) == (15, 10)
        async with connect(url.replace("http", "ws", 1) + "/rosbridge") as socket:
            page = Page(socket)
            await page.send(op="subscribe", topic="/points", compression="cbor-raw")
            raw = (await page.message("/points"))["bytes"]
        assert points_of(deserialize_message(raw, PointCloud2))["number"].tolist() == expected
        async with viewing(url + "/foxglove/alpha", OPERATOR) as viewer:
            await viewer.subscribe("/points")
            _, data = await viewer.message()
        assert points_of(deserialize_message(data, PointCloud2))["number"].tolist() == expected
