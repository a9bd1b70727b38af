"""`aerial`: arming, take-off to the commanded height, and landing."""

from __future__ import annotations

import math
from typing import ClassVar

from rcp_kernel.testing.backend._base import Robot
from rcp_kernel.testing.profile._rig import ProfileRig

__all__ = ["FlyingTests"]


class FlyingTests(ProfileRig):
    """Take-off, flight and landing."""

    height: ClassVar[float] = 5.0
    """How high to take off, m."""

    async def land(self) -> None:
        """Bring it to the ground, ready to be armed; flight tests start there."""
        raise NotImplementedError

    async def test_it_arms_and_disarms(self, robot: Robot) -> None:
        self.needs("action/arm", "action/disarm")
        await self.land()
        for verb, wanted in (("arm", True), ("disarm", False)):
            result, _ = await self.run(f"action/{verb}", None)
            assert await self.armed() is wanted, f"{verb} is completed, and it is not so"
            assert result["armed"] is wanted, result
            assert await self.fresh("sensor/armed") is wanted

    async def test_it_takes_off_to_its_height_and_lands(self, robot: Robot) -> None:
        self.needs("action/takeoff", "action/land")
        await self.land()
        ground = (await self.body()).z
        await self.run("action/arm", None)
        result, _ = await self.run("action/takeoff", {"altitude": self.height})
        risen = (await self.body()).z - ground
        assert abs(risen - self.height) <= max(0.5, self.near), f"it rose {risen:g} m"
        assert abs(result["altitude"] - risen) <= max(0.5, self.near), (result, risen)
        await self.run("action/land", None)
        left = (await self.body()).z - ground
        assert abs(left) <= max(0.5, self.near), f"it landed {left:g} m above the ground"
        assert not await self.armed(), "it landed and is armed"

    async def test_its_orientation_is_told_as_it_is(self, robot: Robot) -> None:
        self.needs("sensor/orientation")
        await self.make_ready()
        turn = (await self.fresh("sensor/orientation"))["orientation"]
        yaw = math.atan2(
            2 * (turn["w"] * turn["z"] + turn["x"] * turn["y"]),
            1 - 2 * (turn["y"] ** 2 + turn["z"] ** 2),
        )
        found = (await self.body()).yaw
        assert abs(math.remainder(yaw - found, math.tau)) < 0.1, f"tells {yaw:g}, is {found:g} rad"
