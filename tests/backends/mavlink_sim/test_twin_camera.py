"""The camera sees the ground and the boxes on it from where the vehicle is, and keeps its pictures."""

from __future__ import annotations

from io import BytesIO

import pytest
from PIL import Image

from backends.mavlink_sim.station import Station
from rcp_mavlink.geo import shifted
from rcp_mavlink_sim import Options
from rcp_mavlink_sim.options import Box
from rcp_mavlink_sim.wire import mav

HOME = Options().home[:2]
ORANGE, TOP, SKY = (186, 120, 52), (226, 160, 84), (140, 180, 220)


def placed(north: float, east: float) -> Box:
    latitude, longitude = shifted(north, east, HOME)
    return Box(latitude=latitude, longitude=longitude, side=1.0, height=1.5)


def seen(station: Station) -> Image.Image:
    return Image.open(BytesIO(station.vehicle.camera.picture(station.vehicle.mount))).convert("RGB")


def spots(picture: Image.Image, colour: tuple[int, int, int]) -> list[tuple[int, int]]:
    """List the pixels of a colour."""
    width, height = picture.size
    return [
        (x, y) for y in range(height) for x in range(width) if picture.getpixel((x, y)) == colour
    ]


def centre(found: list[tuple[int, int]]) -> tuple[float, float]:
    return sum(x for x, _ in found) / len(found), sum(y for _, y in found) / len(found)


def test_a_box_is_where_it_stands_under_the_vehicle() -> None:
    station = Station(boxes=(placed(2.0, 1.0),))
    body, mount = station.vehicle.body, station.vehicle.mount
    body.d, mount.pitch = -9.7, -90.0
    x, y = centre(spots(seen(station), TOP))
    # 171 px of focus, 8.5 m above its top: north is up.
    assert x == pytest.approx(120 + 171.4 / 8.5, abs=2)
    assert y == pytest.approx(90 - 2 * 171.4 / 8.5, abs=2)
    body.yaw = 3.14159  # it looks to the south: all is upside down
    x, y = centre(spots(seen(station), TOP))
    assert x == pytest.approx(120 - 171.4 / 8.5, abs=2)
    assert y == pytest.approx(90 + 2 * 171.4 / 8.5, abs=2)


def test_it_sees_what_the_mount_points_at() -> None:
    station = Station(boxes=(placed(6.0, 0.0),))
    station.vehicle.body.d = -2.0
    ahead = seen(station)
    assert spots(ahead, ORANGE)
    assert ahead.getpixel((120, 0)) == SKY
    station.vehicle.mount.yaw = 120.0
    assert not spots(seen(station), ORANGE), "it is behind"
    station.vehicle.mount.pitch = 90.0
    assert len(spots(seen(station), SKY)) == 240 * 180


def test_a_near_box_hides_a_far_one_and_one_beside_the_camera_is_cut() -> None:
    station = Station(boxes=(placed(9.0, 0.0), placed(4.0, 0.0), placed(0.0, 0.6)))
    near = spots(seen(station), ORANGE)
    alone = Station(boxes=(placed(4.0, 0.0), placed(0.0, 0.6)))
    assert near == spots(seen(alone), ORANGE)


@pytest.mark.parametrize(
    "number", [mav.MAV_CMD_IMAGE_START_CAPTURE, mav.MAV_CMD_DO_DIGICAM_CONTROL]
)
def test_a_picture_is_stored_and_told(number: int) -> None:
    station = Station()
    for _ in range(25):
        del station.heard[:]
        station.command(number, 0, 0, 1)
    told = {m.get_type(): m for m in station.heard}
    assert told["CAMERA_FEEDBACK"].img_idx == 25
    stored = [name for name, _ in station.vehicle.files.listed("DCIM")]
    assert stored == [f"{n:05d}.png" for n in range(6, 26)], "the newest are kept"
    if number == mav.MAV_CMD_DO_DIGICAM_CONTROL:
        assert "CAMERA_IMAGE_CAPTURED" not in told
        return
    captured = told["CAMERA_IMAGE_CAPTURED"]
    assert captured.image_index == 25
    path = captured.file_url.rstrip("\0").removeprefix("mftp:///")
    data = station.vehicle.files.read(path)
    assert data is not None
    assert Image.open(BytesIO(data)).size == (240, 180)
