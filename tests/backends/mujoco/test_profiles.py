"""What the profiles of the robots with physics mean, as MuJoCo's own state has it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

import rcp_mujoco
from rcp_kernel.testing import Body, ProfileSuite

KIND = next(iter(rcp_mujoco.rcp_backends()))
WALL = 6.0 - 0.05  # m from the middle of the yard


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

    async def obstacle(self, bearing: float) -> float | None:
        x, y = abs(math.cos(bearing)), abs(math.sin(bearing))
        return min(WALL / x if x else math.inf, WALL / y if y else math.inf)


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
