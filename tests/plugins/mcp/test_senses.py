"""What robots sense costs a model few tokens, and says where and when."""

from __future__ import annotations

import asyncio
import base64
import json
import math
import struct
import threading
from io import BytesIO
from typing import Any

import pytest
from PIL import Image

from plugins.mcp.rig import BOUND, ROVER, Caller, Sign, Site, caller, site
from rcp_mcp.changes import Changes, compared, packed
from rcp_mcp.clouds import is_cloud, obstacles
from rcp_mcp.content import show
from rcp_mcp.maps import is_grid, pictured
from rcp_mcp.pictures import View, taken_out
from rcp_mcp.scans import is_scan, sectors
from rcp_mcp.trends import trends

pytestmark = pytest.mark.anyio


def scan(ranges: list[Any], **more: Any) -> dict[str, Any]:
    step = 2 * math.pi / len(ranges)
    facts = {"angle_min": -math.pi, "angle_increment": step, "range_min": 0.1, "range_max": 10.0}
    return {**facts, "ranges": ranges, **more}


def image_of(picture: Any) -> Image.Image:
    return Image.open(BytesIO(base64.b64decode(picture.data)))


def test_a_scan_is_the_nearest_obstacle_of_each_sector() -> None:
    ranges: list[Any] = [9.0] * 360
    ranges[180] = 2.0  # ahead
    ranges[270 - 5] = 3.0  # to the left, five degrees ahead of it
    ranges[90] = None  # no echo
    ranges[91], ranges[92] = 0.01, 11.0  # not within the scanner's range
    found = sectors(scan(ranges))["nearest_by_sector"]
    assert found["front"] == {"m": 2.0, "deg": 0}
    assert found["left"] == {"m": 3.0, "deg": 85}
    assert found["right"]["m"] == 9.0
    assert next(iter(found)) == "front"
    assert len(found) == 8


def test_a_sector_without_an_echo_is_free_and_one_out_of_view_is_left_out() -> None:
    half = scan([None] * 90)
    half |= {"angle_min": -math.pi / 4, "angle_increment": math.pi / 2 / 90}
    found = sectors(half)["nearest_by_sector"]
    assert found["front"] is None
    assert "back" not in found
    assert not is_scan({"ranges": [1.0]})


def cloud(points: list[tuple[float, float, float]], **more: Any) -> dict[str, Any]:
    fields = [{"name": n, "offset": 4 * at + 4, "datatype": 7} for at, n in enumerate("xyz")]
    data = b"".join(struct.pack("<4f", 0, *point) for point in points)
    facts = {"width": len(points), "height": 1, "fields": fields, "point_step": 16}
    return {**facts, "is_bigendian": False, "data": base64.b64encode(data).decode(), **more}


FLOOR = [(0.5 + 0.1 * n, 0.05 * (n % 7), -0.4 + 0.01 * (n % 3)) for n in range(200)]


def test_a_cloud_is_the_nearest_obstacle_by_sector_and_height() -> None:
    points = [*FLOOR, (2.0, 0.0, -0.2), (1.5, 0.0, 0.5), (0.0, 3.0, 1.5), (math.nan, 0.0, 0.0)]
    found = obstacles(cloud(points))
    assert found is not None
    assert found["nearest_by_sector"] == {
        "front": {"low": {"m": 2.0, "deg": 0}, "middle": {"m": 1.5, "deg": 0}},
        "left": {"high": {"m": 3.0, "deg": 90}},
    }
    assert found["points"] == 204
    assert found["floor_z"] == pytest.approx(-0.4, abs=0.02)


def test_a_cloud_in_an_optical_frame_looks_along_z() -> None:
    turned = [(-y, -z, x) for x, y, z in [*FLOOR, (2.0, 1.0, 0.0)]]
    found = obstacles(cloud(turned, header={"frame_id": "camera_optical_frame"}))
    assert found is not None
    assert found["nearest_by_sector"] == {"front_left": {"low": {"m": 2.24, "deg": 27}}}


def test_rows_may_be_padded_and_numbers_of_any_kind() -> None:
    doubles = [{"name": n, "offset": 8 * at, "datatype": 8} for at, n in enumerate("xyz")]
    rows = [
        struct.pack(">3d", *point) for point in ((1, 0, 0), (1, 0, 1), (2, 0, 0.3), (2, 0, 0.3))
    ]
    data = list(b"".join(rows[:2]) + bytes(5) + b"".join(rows[2:]) + bytes(5))
    node = {"width": 2, "height": 2, "fields": doubles, "point_step": 24, "row_step": 53}
    found = obstacles({**node, "is_bigendian": True, "data": data})
    assert found is not None
    assert found["nearest_by_sector"]["front"]["middle"] == {"m": 1.0, "deg": 0}
    assert found["nearest_by_sector"]["front"]["low"] == {"m": 2.0, "deg": 0}


def test_a_large_cloud_costs_few_tokens() -> None:
    rim = [(math.cos(a / 9), math.sin(a / 9), h / 100) for a in range(57) for h in range(300)]
    shown = show(cloud(rim * 8), "/a", budget=2000, image=0, view=View(100))
    assert len(json.dumps(shown.plain)) / 3 < 500
    assert len(shown.plain["nearest_by_sector"]) == 8


@pytest.mark.parametrize(
    "wrong",
    [
        {"point_step": 8},
        {"point_step": 0},
        {"fields": [{"name": "x", "offset": 0, "datatype": 7}]},
        {"fields": "xyz"},
        {"width": "4"},
        {"data": 5},
    ],
)
def test_what_has_no_coordinates_is_no_cloud(wrong: dict[str, Any]) -> None:
    assert is_cloud(cloud(FLOOR))
    assert not is_cloud({**cloud(FLOOR), **wrong})


@pytest.mark.parametrize("data", ["!", [300], ["a"], ""])
def test_a_cloud_with_broken_bytes_is_not_looked_at(data: Any) -> None:
    found = obstacles({**cloud(FLOOR), "data": data})
    assert found is None or found["nearest_by_sector"] == {}


async def test_the_rover_sees_its_depth_camera_condensed() -> None:
    async with site(robots=ROVER) as rover, caller(rover) as operator:
        read = await operator.call("read", path="/sensor/points")
        (one,) = read["structuredContent"]["values"]
        assert one["summary"]["nearest_by_sector"] == {}, "nothing is within its reach"
        assert one["summary"]["floor_z"] == -0.4
        assert one["summary"]["points"] > 1000
        assert one["pose"]["frame"] == "map"


@pytest.mark.parametrize("form", ["flat", "ros"])
def test_a_map_is_a_small_picture_with_its_scale(form: str) -> None:
    cells = [0] * (200 * 100)
    cells[0] = 100  # one cell at the lower left
    cells[-200:] = [-1] * 200  # the top row is unknown
    facts: dict[str, Any] = {"width": 200, "height": 100, "resolution": 0.5}
    facts["origin"] = {"position": {"x": -10.0, "y": 5.0}}
    node = (
        {**facts, "data": base64.b64encode(bytes(one & 255 for one in cells)).decode()}
        if form == "flat"
        else {"info": facts, "data": cells, "header": {"frame_id": "map"}}
    )
    assert is_grid(node)
    made = pictured(node, View(50), {"x": 40.0, "y": 30.0, "yaw": 0.0})
    assert made is not None
    told, picture = made
    assert (picture.width, picture.height) == (50, 25)
    assert told["picture"]["m_per_pixel"] == 2.0
    assert told["picture"]["top_left"] == {"x": -10.0, "y": 55.0}
    pixels = image_of(picture).convert("RGB")
    assert pixels.getpixel((0, 24)) == (0, 0, 0)  # a single cell does not vanish
    assert pixels.getpixel((10, 20)) == (254, 254, 254)
    red, green, _ = pixels.getpixel((25, 12))  # pyright: ignore[reportGeneralTypeIssues]
    assert red > 200 > green


@pytest.mark.parametrize(
    "wrong",
    [{"data": ""}, {"data": "!"}, {"data": [1, 2]}, {"data": ["a"] * 4}, {"width": 10**6}],
)
def test_a_map_with_broken_cells_is_no_picture(wrong: dict[str, Any]) -> None:
    good: dict[str, Any] = {
        "width": 2,
        "height": 2,
        "resolution": 0.1,
        "origin": {},
        "data": [0] * 4,
    }
    assert pictured(good, View(50), None) is not None
    assert pictured({**good, **wrong}, View(50), None) is None


def raw(width: int, height: int, encoding: str = "rgb8", **more: Any) -> dict[str, Any]:
    colours = {"rgb8": (255, 0, 0), "bgr8": (0, 0, 255), "mono8": (200,)}[encoding]
    data = bytes(colours) * (width * height)
    facts = {"width": width, "height": height, "encoding": encoding}
    return {**facts, "data": base64.b64encode(data).decode(), **more}


@pytest.mark.parametrize("encoding", ["rgb8", "bgr8"])
def test_a_raw_image_is_resized_and_keeps_its_colours(encoding: str) -> None:
    value, (picture,) = taken_out(raw(400, 200, encoding), View(100))
    assert (picture.media, picture.width, picture.height) == ("image/jpeg", 100, 50)
    red, _, blue = image_of(picture).getpixel((50, 25))  # pyright: ignore[reportGeneralTypeIssues]
    assert red > 240
    assert blue < 20
    assert value["data"] == "(image/jpeg, 100 x 50, shown as a picture)"
    assert picture.tokens == 7


def test_a_part_of_an_image_is_shown_as_it_is() -> None:
    whole = Image.new("RGB", (100, 100), (0, 0, 255))
    whole.paste((255, 0, 0), (50, 0, 100, 50))
    made = BytesIO()
    whole.save(made, "PNG")
    node = {"format": "png", "data": base64.b64encode(made.getvalue()).decode()}
    _, (same,) = taken_out(node, View(200))
    assert same.data == node["data"]
    _, (corner,) = taken_out(node, View(200, (0.5, 0.0, 0.5, 0.5)))
    assert (corner.width, corner.height) == (50, 50)
    assert image_of(corner).convert("RGB").getpixel((5, 5)) == (255, 0, 0)
    _, (edge,) = taken_out(node, View(200, (1.0, 1.0, 0.5, 0.5)))
    assert (edge.width, edge.height) == (1, 1)


@pytest.mark.parametrize(
    "node",
    [
        {"format": "png", "data": "iVBORw0KGgo="},
        {"format": "jpeg", "data": "not base64!"},
        {"encoding": "rgb8", "width": 9, "height": 9, "data": "AAAA"},
        {"encoding": "rgb8", "width": 10**6, "height": 10**6, "data": "AAAA"},
        {"encoding": "rgb8", "width": "9", "height": 9, "data": "AAAA"},
    ],
)
def test_a_broken_image_is_told_and_not_sent(node: dict[str, Any]) -> None:
    value, pictures = taken_out(node, View(100))
    assert pictures == []
    assert "no readable picture" in value["data"]


def samples(values: list[Any], path: str = "/sensor/a") -> list[dict[str, Any]]:
    return [
        {"path": path, "value": value, "timestamp": f"2026-01-01T00:00:{number:02}.000000000Z"}
        for number, value in enumerate(values)
    ]


def test_samples_become_the_trend_of_each_number() -> None:
    (one,) = trends(samples([{"v": 1.0 + 0.5 * n, "unit": "V", "timestamp": n} for n in range(5)]))
    assert one["value"]["unit"] == "V"
    assert one["value"]["v"] == {
        "first": 1.0, "last": 3.0, "min": 1.0, "max": 3.0, "mean": 2.0, "per_second": 0.5,
    }  # fmt: skip
    assert (one["samples"], one["seconds"]) == (5, 4.0)
    assert "timestamp" not in one["value"]


def test_texts_become_their_changes_and_a_constant_stays_itself() -> None:
    (mode,) = trends(samples(["AUTO", "AUTO", "LAND", "LAND", "AUTO"]))
    assert mode["value"]["changes"] == [[0.0, "AUTO"], [2.0, "LAND"], [4.0, "AUTO"]]
    (still,) = trends(samples([2.5, 2.5, 2.5]))
    assert still["value"] == 2.5
    both = trends([*samples([1, 2]), *samples([3], "/sensor/b")])
    assert [one["path"] for one in both] == ["/sensor/a", "/sensor/b"]


def test_noise_is_no_change() -> None:
    changes = Changes()
    before = [*samples([{"v": 100.0, "stamp": 1}]), *samples(["a"], "/sensor/b")]
    mark = changes.keep("me", packed(before))
    same = [*samples([{"v": 101.0, "stamp": 2}]), *samples(["a"], "/sensor/b")]
    kept = changes.of("me", mark)
    assert compared(kept, packed(same), same) == ([], [])
    moved = samples([{"v": 110.0, "stamp": 2}])
    assert compared(kept, packed(moved), moved) == (moved, ["/sensor/b"])


async def test_large_values_are_compared_beside_the_event_loop(
    operator: Caller, gateway: Site, monkeypatch: pytest.MonkeyPatch
) -> None:
    threads: list[bool] = []

    def noted(*args: Any) -> Any:
        threads.append(threading.current_thread() is threading.main_thread())
        return compared(*args)

    monkeypatch.setattr("rcp_mcp.read_tool.compared", noted)
    for text, beside in (("x", True), ("y" * 300_000, False)):
        gateway.robot.measure("sensor/sign", Sign(text))
        paths = ["/sensor/level", "/sensor/sign"]
        first = (await operator.call("read", path=paths))["structuredContent"]
        await operator.call("read", path=paths, since=first["mark"])
        assert threads.pop() is beside


async def test_marks_are_their_readers_own(operator: Caller, gateway: Site) -> None:
    first = (await operator.call("read", path="/sensor/*"))["structuredContent"]
    same = await operator.call("read", path="/sensor/*", since=first["mark"])
    facts = same["structuredContent"]
    assert (facts["values"], facts["unchanged"]) == ([], len(first["values"]))
    assert "Nothing has changed." in same["content"][0]["text"]
    gateway.robot.host.publish("sensor/level", 7.0)
    after = await operator.call("read", path="/sensor/*", since=facts["mark"])
    (changed,) = after["structuredContent"]["values"]
    assert (changed["path"], changed["value"]) == ("/tenant/alpha/sensor/level", 7.0)
    async with caller(gateway, None) as stranger:
        other = await stranger.call("read", path="/tenant/alpha/sensor/*", since=first["mark"])
        assert other["structuredContent"]["error"]["code"] == "precondition_failed"


async def test_a_rovers_senses_come_with_its_pose_in_few_tokens() -> None:
    async with site(robots=ROVER, mcp="") as rover, caller(rover) as operator:
        paths = [f"/sensor/{name}" for name in ("camera", "scan", "map")]
        async with asyncio.timeout(BOUND):
            while True:  # until the first scan and image have been made
                result = await operator.call("read", path=paths, size=200)
                values = result["structuredContent"]["values"]
                if all(one.get("status") == "completed" for one in values):
                    break
        camera, laser, grid = values
        assert all(one["pose"]["frame"] == "map" and one["timestamp"] for one in values)
        assert laser["summary"]["nearest_by_sector"]["left"]["m"] > 5
        assert grid["summary"]["picture"]["m_per_pixel"] == 0.2
        assert camera["value"]["data"].endswith("shown as a picture)")
        pictures = [one for one in result["content"] if one["type"] == "image"]
        assert len(pictures) == 2
        texts = [one["text"] for one in result["content"] if one["type"] == "text"]
        assert sum(map(len, texts)) / 4 < 600
        raw_scan = await operator.call("read", path="/sensor/scan", fields=["ranges"])
        assert len(raw_scan["structuredContent"]["values"][0]["value"]["ranges"]) == 360


async def test_watching_tells_trends(operator: Caller, gateway: Site) -> None:
    async def publish() -> None:
        for level in range(1000):
            gateway.robot.host.publish("sensor/level", float(level))
            await asyncio.sleep(0.01)

    publishing = asyncio.create_task(publish())
    result = await operator.call("watch", paths=["/sensor/level"], samples=20, seconds=BOUND)
    publishing.cancel()
    (trend,) = result["structuredContent"]["trends"]
    assert trend["samples"] == 20
    assert trend["value"]["per_second"] > 0
    assert trend["value"]["last"] > trend["value"]["first"]


async def test_several_paths_are_read_and_a_wrong_one_spoils_none(operator: Caller) -> None:
    result = await operator.call("read", path=["/sensor/level", "/sensor/none", "/param/*"])
    level, wrong, *rest = result["structuredContent"]["values"]
    assert level["value"] == 1.25
    assert wrong["error"]["code"] == "unknown_path"
    assert "trace_id" not in wrong["error"]
    assert [one["path"] for one in rest] == [
        "/tenant/alpha/param/gain",
        "/tenant/alpha/param/limit",
    ]
    refused = await operator.call("read", path=["/param/*", "/sensor/*"], cursor="x")
    assert refused["structuredContent"]["error"]["code"] == "bad_request"
