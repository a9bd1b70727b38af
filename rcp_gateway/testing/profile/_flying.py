"""`aerial`: arming, take-off to the commanded height, and landing."""

from __future__ import annotations

import math
from typing import ClassVar

from rcp_gateway.testing.backend._base import Robot
from rcp_gateway.testing.profile._rig import ProfileRig, needs

__all__ = ["FlyingTests"]

_DEGREE = 111_320.0  # m per degree of latitude
_GNSS = 5.0  # m by which a position by satellites may be off


class FlyingTests(ProfileRig):
    """Take-off, flight and landing."""

    height: ClassVar[float] = 5.0
    """How high to take off, m."""
    level: ClassVar[float] = 0.5
    """By how much its height may be off, m."""

    async def land(self) -> None:
        """Bring it to the ground, ready to be armed; flight tests start there."""
        raise NotImplementedError

    async def geographic(self) -> tuple[float, float]:
        """Return its latitude and longitude, deg."""
        raise NotImplementedError

    @needs("action/arm", "action/disarm")
    async def test_it_arms_and_disarms(self, robot: Robot) -> None:
        await self.land()
        for verb, wanted in (("arm", True), ("disarm", False)):
            result, _ = await self.run(f"action/{verb}", None)
            assert await self.armed() is wanted, f"{verb} is completed, and it is not so"
            assert result["armed"] is wanted, result
            assert await self.fresh("sensor/armed") is wanted

    @needs("action/takeoff")
    async def test_it_takes_off_to_its_height_and_lands(self, robot: Robot) -> None:
        await self.land()
        ground = (await self.body()).z
        await self.run("action/arm", None)
        result, _ = await self.run("action/takeoff", {"altitude": self.height})
        risen = (await self.body()).z - ground
        assert abs(risen - self.height) <= self.level, f"it rose {risen:g} m"
        assert abs(result["altitude"] - risen) <= self.level, (result, risen)
        if self.full("action/land") not in self.running.resources:
            return  # it lands only where an approach was planned
        await self.run("action/land", None)
        left = (await self.body()).z - ground
        assert abs(left) <= self.level, f"it landed {left:g} m above the ground"
        assert not await self.armed(), "it landed and is armed"

    @needs("action/return_home", "action/takeoff", "action/move_to")
    async def test_it_returns_to_where_it_took_off(self, robot: Robot) -> None:
        await self.land()
        home = await self.body()
        await self.run("action/arm", None)
        await self.run("action/takeoff", {"altitude": self.height})
        up = (await self.body()).z
        away = {"x": home.x + self.hop, "y": home.y + self.hop, "z": up}
        await self.run("action/move_to", {"position": away, "frame": self.frame})
        await self.run("action/return_home", None)
        body = await self.body()
        off = math.hypot(body.x - home.x, body.y - home.y)
        assert off <= max(1.0, self.near), f"it returned to {off:g} m from where it took off"
        if self.full("action/land") in self.running.resources:
            assert abs(body.z - home.z) <= self.level, f"it is {body.z - home.z:g} m up"
            assert not await self.armed(), "it returned and is armed"

    @needs("action/takeoff", "action/move_to")
    async def test_it_keeps_its_height_on_the_way_to_a_goal_without_one(self, robot: Robot) -> None:
        await self.make_ready()
        start = await self.body()
        assert abs(start.z) > 2 * self.level, f"{start.z:g} m up: a descent to 0 would not be seen"
        for height in ({}, {"z": None}):
            body = await self.body()
            there = {"x": body.x + self.hop, "y": body.y, **height}
            await self.run("action/move_to", {"position": there, "frame": self.frame})
            risen = (await self.body()).z - start.z
            assert abs(risen) <= self.level, f"to a goal with {there}, it rose {risen:g} m"

    @needs("sensor/gnss")
    async def test_its_satellites_tell_where_it_is(self, robot: Robot) -> None:
        told = await self.fresh("sensor/gnss")
        latitude, longitude = await self.geographic()
        north = (told["latitude"] - latitude) * _DEGREE
        east = (told["longitude"] - longitude) * _DEGREE * math.cos(math.radians(latitude))
        assert math.hypot(north, east) <= _GNSS, f"tells {told}, is at {latitude}, {longitude}"

    @needs("sensor/orientation")
    async def test_its_orientation_is_told_as_it_is(self, robot: Robot) -> None:
        await self.make_ready()
        turn = (await self.fresh("sensor/orientation"))["orientation"]
        yaw = math.atan2(
            2 * (turn["w"] * turn["z"] + turn["x"] * turn["y"]),
            1 - 2 * (turn["y"] ** 2 + turn["z"] ** 2),
        )
        found = (await self.body()).yaw
        assert abs(math.remainder(yaw - found, math.tau)) < 0.1, f"tells {yaw:g}, is {found:g} rad"
