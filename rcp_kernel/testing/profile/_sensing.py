"""`battery`, `camera`, `lidar`, `power`: what they tell is so, in the units that they name."""

from __future__ import annotations

import base64
import math
from typing import Any

from rcp_kernel.testing._suite import eventually
from rcp_kernel.testing.backend._base import Robot
from rcp_kernel.testing.profile._rig import ProfileRig

__all__ = ["PowerTests", "SensingTests"]

_PNG = b"\x89PNG\r\n\x1a\n"
_JPEG = b"\xff\xd8\xff"
_BEAM = 0.15  # m by which a range may be off
_CHARGE = 0.03  # of the charge
_SIDES = (0.0, math.pi / 2, -math.pi / 2)  # ahead, left, right


class SensingTests(ProfileRig):
    """What is measured."""

    async def test_the_battery_tells_what_is_left(self, robot: Robot) -> None:
        self.needs("sensor/battery")
        told: Any = None

        async def is_true() -> bool:
            nonlocal told
            told = (await self.fresh("sensor/battery"))["percentage"]
            return told is not None and abs(told - await self.charge()) <= _CHARGE

        try:
            await eventually(is_true, "sensor/battery", self.cancel_within)
        except AssertionError:
            left = await self.charge()
            raise AssertionError(f"{left:g} of the charge is left, and told is {told}") from None

    async def test_the_camera_sends_images_of_the_size_it_tells(self, robot: Robot) -> None:
        self.needs("sensor/camera")
        image = await self.do("read", "sensor/camera")
        data = base64.b64decode(image["data"])
        sizes = {"png": _png_size, "jpeg": _jpeg_size}
        assert sizes[image["format"]](data) == (image["width"], image["height"])

    async def test_the_scan_tells_how_far_things_are_on_each_side(self, robot: Robot) -> None:
        self.needs("sensor/scan")
        await self.make_ready()
        scan = await self.do("read", "sensor/scan")
        for bearing in _SIDES:
            number = round((bearing - scan["angle_min"]) / scan["angle_increment"])
            if not 0 <= number < len(scan["ranges"]):
                continue
            exact = scan["angle_min"] + number * scan["angle_increment"]
            told, wanted = float(scan["ranges"][number]), await self.obstacle(exact)
            if wanted is None:
                assert not math.isfinite(told), f"nothing is at {exact:g} rad, and told is {told}"
            else:
                assert abs(told - wanted) <= _BEAM, f"at {exact:g} rad: {told}, not {wanted:g} m"


class PowerTests(ProfileRig):
    """What is switched."""

    async def test_a_reset_leaves_it_at_rest_and_at_work(self, robot: Robot) -> None:
        self.needs("service/reset_system")
        await self.do("execute", "service/reset_system")
        assert await self.at_rest()

    async def test_torque_is_switched_on_and_off(self, robot: Robot) -> None:
        self.needs("service/enable", "service/disable")
        for verb, wanted in (("disable", False), ("enable", True), ("disable", False)):
            await self.do("execute", f"service/{verb}")
            assert await self.powered() is wanted, f"{verb} is completed, and torque is not so"


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
