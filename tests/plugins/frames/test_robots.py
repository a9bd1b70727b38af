"""A rover and a drone take the same goals, and tell where they are in the same frames."""

from __future__ import annotations

import math
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from typing import Any, Protocol

import pytest

import rcp_sim
from backends.mavlink.flying import agrees, airborne
from backends.mavlink.test_gateway import flying
from configuration import backend, key, table
from rcp_gateway.testing import MemoryClient, eventually, serve
from rcp_gateway.testing._serve import OPERATOR
from rcp_geometry import ecef, geodetic, local

pytestmark = pytest.mark.anyio
_YARD = (48.137154, 11.576124, 519.0)
_ROVER = (
    backend(tenant="t", use="sim", world="empty", noise=0, start={"x": 1.0, "y": 2.0, "yaw": 0.5})
    + table(
        'features.frames.anchors."/tenant/t"',
        latitude=_YARD[0],
        longitude=_YARD[1],
        altitude=_YARD[2],
    )
    + key("operator", OPERATOR, roles={"*": ["operator"]})
)


class Device(Protocol):
    """What a robot itself knows, beside the gateway."""

    client: MemoryClient
    origin: tuple[float, float, float]

    def pose(self) -> tuple[float, float, float]:
        """Return where it is in the map, and its yaw."""
        ...


class Rover:
    origin = _YARD

    def __init__(self, served: Any) -> None:
        self.client = served.client(OPERATOR)
        self._rover = served.life.backend.device.sim.rover

    def pose(self) -> tuple[float, float, float]:
        return self._rover.x, self._rover.y, self._rover.yaw


class Drone:
    def __init__(self, pilot: Any) -> None:
        self.client = pilot.client
        self._vehicle = pilot.vehicle
        self.origin = pilot.served.life.backend.robots[""].vehicle.home

    def pose(self) -> tuple[float, float, float]:
        lat, lon = self._vehicle.geographic()
        x, y, _ = local(*self.origin).inverse.point(ecef(lat, lon, self.origin[2]))
        return x, y, math.pi / 2 - self._vehicle.body.yaw


@asynccontextmanager
async def rover() -> AsyncGenerator[Device]:
    async with serve(_ROVER, *rcp_sim.rcp_backends()) as served:
        yield Rover(served)


@asynccontextmanager
async def drone() -> AsyncGenerator[Device]:
    async with flying({"heading": -45.0, "noise": 0.0}) as pilot:
        pilot.vehicle.set_home(None)
        seen = pilot.served.life.backend.robots[""].vehicle

        async def known() -> bool:
            return seen.home is not None and seen.fix is not None

        await eventually(known, "its place and its home are known")
        airborne(pilot.vehicle)
        await agrees(pilot.served.life.backend, pilot.vehicle)
        yield Drone(pilot)


@pytest.mark.parametrize("robot", [rover, drone])
async def test_one_goal_and_one_reading_for_all(robot: Any) -> None:
    async with robot() as device:
        x, y, yaw = device.pose()
        ahead = {"position": {"x": 3.0, "y": 0.0}, "frame": "base_link"}
        assert await _went(device, ahead) == pytest.approx(
            (x + 3 * math.cos(yaw), y + 3 * math.sin(yaw)), abs=0.8
        )
        lat, lon, _ = geodetic(local(*device.origin).point((4.0, 5.0, 0.0)))
        place = {"position": {"latitude": lat, "longitude": lon}, "frame": "earth"}
        assert await _went(device, place) == pytest.approx((4.0, 5.0), abs=0.8)
        at = (await _read(device, "sensor/pose", "earth"))["position"]
        there = local(*device.origin).inverse.point(tuple(ecef(*at.values())))
        assert there[:2] == pytest.approx(device.pose()[:2], abs=0.5)
        map_ = (await _read(device, "sensor/pose", "map"))["position"]
        assert there[2] == pytest.approx(map_["z"], abs=0.5)


async def _went(device: Device, goal: dict[str, Any]) -> tuple[float, float]:
    path = "/tenant/t/action/move_to"
    reply = await device.client.request("execute", path, body=goal, within=60.0)
    assert reply["status"] == "completed", reply
    return device.pose()[:2]


async def _read(device: Device, name: str, frame: str) -> Any:
    path = f"/tenant/t/{name}"
    reply = await device.client.request("read", path, body={"frame": frame})
    assert reply["status"] == "completed", reply
    return reply["body"]
