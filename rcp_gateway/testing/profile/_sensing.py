"""`battery`, `camera`, `lidar`, `power`: reported values are correct, in the declared units."""

from __future__ import annotations

import base64
import math
from typing import Any

from rcp_gateway.testing._suite import eventually
from rcp_gateway.testing.backend._base import Robot
from rcp_gateway.testing.profile._rig import ProfileRig, needs

__all__ = ["PowerTests", "SensingTests"]

_PNG = b"\x89PNG\r\n\x1a\n"
_JPEG = b"\xff\xd8\xff"
_BEAM = 0.15  # m, tolerance of a range
_CHARGE = 0.03  # tolerance of the charge, 0…1
_SIDES = (0.0, math.pi / 2, -math.pi / 2)  # ahead, left, right


class SensingTests(ProfileRig):
    """Measured values."""

    @needs("sensor/battery")
    async def test_the_battery_tells_what_is_left(self, robot: Robot) -> None:
        reported: Any = None

        async def is_true() -> bool:
            nonlocal reported
            reported = (await self.fresh("sensor/battery"))["percentage"]
            return reported is not None and abs(reported - await self.charge()) <= _CHARGE

        try:
            await eventually(is_true, "sensor/battery", self.cancel_within)
        except AssertionError:
            actual = await self.charge()
            raise AssertionError(f"the charge is {actual:g}, but reported as {reported}") from None

    @needs("sensor/camera")
    async def test_the_camera_sends_images_of_the_size_it_tells(self, robot: Robot) -> None:
        image = await self.do("read", "sensor/camera")
        data = base64.b64decode(image["data"])
        sizes = {"png": _png_size, "jpeg": _jpeg_size}
        assert sizes[image["format"]](data) == (image["width"], image["height"])

    @needs("sensor/scan")
    async def test_the_scan_tells_how_far_things_are_on_each_side(self, robot: Robot) -> None:
        await self.make_ready()
        scan = await self.do("read", "sensor/scan")
        beams = [number for side in _SIDES if (number := _beam(scan, side)) is not None]
        assert beams, "it has no beam ahead, to the left or to the right"
        for number in beams:
            angle = scan["angle_min"] + number * scan["angle_increment"]
            exact = math.remainder(angle, math.tau)
            measured, actual = float(scan["ranges"][number]), await self.obstacle(exact)
            if actual is None:
                assert not math.isfinite(measured), f"{measured} m at {exact:g} rad, not infinity"
            else:
                off = abs(measured - actual)
                assert off <= _BEAM, f"{measured} m at {exact:g} rad, not {actual:g} m"


class PowerTests(ProfileRig):
    """Switching of the motors, and resets."""

    @needs("service/reset_system")
    async def test_a_reset_leaves_it_at_rest_and_at_work(self, robot: Robot) -> None:
        await self.do("execute", "service/reset_system")
        assert await self.at_rest()

    @needs("service/enable", "service/disable")
    async def test_torque_is_switched_on_and_off(self, robot: Robot) -> None:
        for verb, wanted in (("disable", False), ("enable", True), ("disable", False)):
            await self.do("execute", f"service/{verb}")
            assert await self.powered() is wanted, f"{verb} is completed, and torque is not so"


def _beam(scan: Any, bearing: float) -> int | None:
    """Return the beam in a direction; a scan may count its angles from 0 to a whole turn."""
    for whole in (bearing, bearing + math.tau, bearing - math.tau):
        number = round((whole - scan["angle_min"]) / scan["angle_increment"])
        if 0 <= number < len(scan["ranges"]):
            return number
    return None


def _png_size(data: bytes) -> tuple[int, int]:
    assert data.startswith(_PNG), f"no PNG: {data[:8]!r}"
    return int.from_bytes(data[16:20], "big"), int.from_bytes(data[20:24], "big")


def _jpeg_size(data: bytes) -> tuple[int, int]:
    assert data.startswith(_JPEG), f"no JPEG: {data[:8]!r}"
    at = 2
    while at + 9 < len(data):
        marker, length = data[at + 1], int.from_bytes(data[at + 2 : at + 4], "big")
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):  # a start of frame
            height = int.from_bytes(data[at + 5 : at + 7], "big")
            return int.from_bytes(data[at + 7 : at + 9], "big"), height
        at += 2 + length
    raise AssertionError("the JPEG has no frame")
