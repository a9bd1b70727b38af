"""What the profiles of the robots with physics mean, as MuJoCo's own state has it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

import rcp_mujoco
from rcp_gateway.testing import Body, ProfileSuite

KIND = next(iter(rcp_mujoco.rcp_backends()))
WALL = 6.0 - 0.05  # m from the middle of the yard
START = (1.0, -1.5)  # m
REACH = 8.0  # m, of the range finder


class PhysicsProfiles(ProfileSuite):
    """Looks at the state of the simulation."""

    kind = KIND
    model: ClassVar[str]
    complete_within = 60.0

    def table(self) -> Mapping[str, Any]:
        # Nothing but the gateway's dead-man ends a velocity while a test measures.
        return {"model": self.model, "cameras": False, "valid_for": 600.0}

    @property
    def data(self) -> Any:
        return self.backend.device.robot.simulation.data

    async def at_rest(self) -> bool:
        return bool((np.abs(self.data.qvel[:8]) < 0.05).all())


class TestRoverProfiles(PhysicsProfiles):
    """It drives, and its lidar sees the walls."""

    model = "rover"
    profiles = ("mobile", "lidar", "power")

    async def body(self) -> Body:
        x, y, z, w, i, j, k = self.data.qpos[:7].tolist()
        yaw = math.atan2(2 * (w * k + i * j), 1 - 2 * (j * j + k * k))
        east, north = self.data.qvel[:2].tolist()
        forward = east * math.cos(yaw) + north * math.sin(yaw)
        left = north * math.cos(yaw) - east * math.sin(yaw)
        rate = float(self.data.qvel[5])
        return Body(x=x, y=y, z=z, yaw=yaw, forward=forward, left=left, yaw_rate=rate)

    async def make_ready(self) -> None:
        """Put it where the wall on each side is at another distance."""

        def place(robot: Any) -> None:
            robot.simulation.data.qpos[:2] = START
            for _ in range(100):  # longer than the interval of the range finder
                robot.simulation.step()

        await self.backend.device.do(place)

    async def obstacle(self, bearing: float) -> float | None:
        body = await self.body()
        x, y = math.cos(bearing + body.yaw), math.sin(bearing + body.yaw)
        east, north = math.copysign(WALL, x) - body.x, math.copysign(WALL, y) - body.y
        found = min(east / x if x else math.inf, north / y if y else math.inf)
        return found if found < REACH else None


class TestArmProfiles(PhysicsProfiles):
    """Its joints, tool and fingers go where they are sent."""

    model = "arm"
    profiles = ("arm", "gripper", "power")

    async def joints(self) -> Mapping[str, float]:
        return {f"joint_{number + 1}": float(self.data.qpos[number]) for number in range(6)}

    async def tool(self) -> tuple[float, float, float]:
        model = self.backend.device.robot.simulation.model
        x, y, z = self.data.site_xpos[model.site("tool").id].tolist()
        return x, y, z  # the arm's base is the world's origin

    async def opening(self) -> float:
        return float(self.data.qpos[6] + self.data.qpos[7])
