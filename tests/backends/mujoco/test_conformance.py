"""The simulated robots keep what the house asks of a backend, on the physics."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncGenerator, Mapping, Sequence
from contextlib import asynccontextmanager
from typing import Any, ClassVar

import numpy as np

import rcp_mujoco
from rcp_gateway.testing import BackendSuite, Goal, StopRig, StopSuite

SLOW = 0.05  # m/s and rad/s


class PhysicsRig(StopRig):
    """A robot whose truth is MuJoCo's own state."""

    kind = next(iter(rcp_mujoco.rcp_backends()))
    model: ClassVar[str]
    joints: ClassVar[slice]
    """The robot's own degrees of freedom."""
    shove: ClassVar[Mapping[str, float]]
    """Controls that somebody else sets past the gateway."""
    complete_within = 60.0

    def table(self) -> Mapping[str, Any]:
        return {"model": self.model, "cameras": False, "stalled_after": 0.5, "valid_for": 30.0}

    @property
    def simulated(self) -> Any:
        return self.backend.device.robot

    @property
    def physics(self) -> Any:
        return self.simulated.simulation

    async def truth(self, name: str) -> Any:
        pace = self.backend.device.stepper.pace
        settings = {"param/paused": pace.paused, "param/real_time_factor": pace.factor}
        if name in settings:
            return settings[name]
        return float(self.physics.data.ctrl[self.physics.drive(name.partition("/")[2]).number])

    async def confirms(self, name: str, result: Any) -> bool:
        if name == "service/step":
            return abs(result["time"] - self.physics.time) < 1e-9
        return bool(0 <= result["time"] <= self.physics.time)

    async def at_rest(self) -> bool:
        """Whether MuJoCo's velocities are next to nothing, and no control asks for one."""
        velocities = np.abs(self.physics.data.qvel[self.joints])
        return bool((velocities < SLOW).all()) and not self.physics.commanded

    def values(self, name: str) -> Sequence[Any]:
        match name:
            case "param/paused":
                return (True, False)
            case "param/real_time_factor":
                return (2.0, 1.0)
            case _:
                return super().values(name)

    @asynccontextmanager
    async def refusing(self, name: str) -> AsyncGenerator[None]:
        """Let the simulation refuse all motion: it has no control that it refuses alone."""
        self.physics.fault = "a test stopped it"
        yield
        self.physics.fault = None

    async def prepare(self, name: str) -> None:
        """Pause for `service/step`, and for it alone."""
        paused = name == "service/step"
        set_ = await self.running.ask("write", "param/paused", body=paused)
        assert set_["status"] == "completed", set_

    async def freeze_device(self) -> None:
        """Have the stepping thread hang, as in a library that does not return."""
        self.thaw = threading.Event()
        hanging = asyncio.Event()
        device, loop = self.backend.device, asyncio.get_running_loop()

        def hang(_: Any) -> None:
            loop.call_soon_threadsafe(hanging.set)
            self.thaw.wait(60)

        device.post(hang)
        await hanging.wait()

    async def thaw_device(self) -> None:
        self.thaw.set()

    @asynccontextmanager
    async def foreign_commander(self) -> AsyncGenerator[None]:
        """Write to MuJoCo's controls between any two steps."""
        device, over = self.backend.device, False

        def shove(robot: Any) -> None:
            for name, value in self.shove.items():
                robot.simulation.data.ctrl[robot.simulation.drive(name).number] = value

        async def command() -> None:
            while not over:
                device.post(shove)
                await asyncio.sleep(0.005)

        task = asyncio.create_task(command())
        try:
            yield
        finally:
            over = True
            await task


class RoverRig(PhysicsRig):
    model = "rover"
    joints = slice(0, 8)
    shove: ClassVar[Mapping[str, float]] = {"left_wheel": 5.0, "right_wheel": 4.0}

    async def truth(self, name: str) -> Any:
        if name == "param/speed_limit":
            return self.simulated.wheels.limit
        if name == "actuator/cmd_vel":
            v, w = self.simulated.wheels.target
            return {"linear": {"x": v}, "angular": {"z": w}}
        return await super().truth(name)

    async def at_rest(self) -> bool:
        return await super().at_rest() and self.simulated.wheels.target == (0.0, 0.0)

    async def confirms(self, name: str, result: Any) -> bool:
        x, y, _ = self.simulated.wheels.pose
        if name != "action/move_to":
            return await super().confirms(name, result)
        there = result["pose"]["position"]
        return abs(there["x"] - x) < 0.02 and abs(there["y"] - y) < 0.02 and result["error"] < 0.1

    def goals(self) -> Mapping[str, Goal]:
        near, far = {"position": {"x": 0.3, "y": 0.0}}, {"position": {"x": 5.0, "y": 0.0}}
        nowhere = {"position": {"x": 1.0, "y": 0.0}, "frame": "moon"}
        return {
            "action/move_to": Goal(good=near, bad=nowhere, long=far),
            "service/reset": Goal(good=None),
            "service/reset_system": Goal(good=None),
            "service/step": Goal(good={"steps": 5, "controls": {"left_wheel": 1.0}}),
        }

    def values(self, name: str) -> Sequence[Any]:
        if name == "actuator/cmd_vel":
            return ({"linear": {"x": 0.4}, "angular": {"z": 0.2}}, {"linear": {"x": 0.1}})
        if name == "param/speed_limit":
            return (0.8, 0.5)
        if name.endswith("_wheel"):
            return (3.0, 1.0)
        return super().values(name)


class ArmRig(PhysicsRig):
    model = "arm"
    joints = slice(0, 8)
    shove: ClassVar[Mapping[str, float]] = {"joint_1": 1.0, "joint_4": -1.0}

    def goals(self) -> Mapping[str, Goal]:
        near, far = {"joint_1": 0.1, "joint_4": 1.3}, {"joint_1": 2.5}
        home, there = {"joint_1": 0.0}, {"joint_1": 0.2}
        points = [{"time": 0.5, "positions": there}, {"time": 1.0, "positions": home}]
        hasty = [{"time": 0.01, "positions": far}]
        slow = [{"time": 1.0, "positions": there}, {"time": 30.0, "positions": {"joint_1": 1.0}}]
        tool = {"position": {"x": 0.4, "y": 0.1, "z": 0.25}}
        far_off = {"position": {"x": 4.0, "y": 0.0, "z": 0.2}}
        left = {"position": {"x": -0.1, "y": 0.4, "z": 0.3}, "speed": 0.05}
        return {
            "action/move_joints": Goal(
                good={"positions": near}, bad={"positions": {}}, long={"positions": far}
            ),
            "action/follow_trajectory": Goal(
                good={"points": points}, bad={"points": hasty}, long={"points": slow}
            ),
            "action/move_tool": Goal(good=tool, bad=far_off, long=left),
            "action/move_gripper": Goal(good={"width": 0.06}, long={"width": 0.0}),
            "service/reset": Goal(good=None),
            "service/step": Goal(good={"steps": 5, "controls": {"joint_1": 0.1}}),
        }

    async def prepare(self, name: str) -> None:
        await super().prepare(name)
        reset = await self.running.ask("execute", "service/reset")
        assert reset["status"] == "completed", reset

    async def confirms(self, name: str, result: Any) -> bool:
        data = self.physics.data
        match name:
            case "action/move_joints" | "action/follow_trajectory":
                there = list(result["positions"].values())
                return bool(np.abs(data.qpos[:6] - there).max() < 0.02)
            case "action/move_tool":
                site = data.site_xpos[self.physics.model.site("tool").id]
                return bool(np.abs(site - [0.4, 0.1, 0.25]).max() < 0.01)
            case "action/move_gripper":
                return abs(2 * data.qpos[6] - result["width"]) < 0.003
            case _:
                return await super().confirms(name, result)

    def values(self, name: str) -> Sequence[Any]:
        if name == "actuator/gripper":
            return (0.03, 0.02)
        if name.startswith("actuator/joint_"):
            return (0.3, 0.4)
        return super().values(name)


class TestRover(RoverRig, BackendSuite):
    """What any backend owes."""


class TestArm(ArmRig, BackendSuite):
    """What any backend owes."""


class TestRoverStops(RoverRig, StopSuite):
    """What any stop owes."""


class TestArmStops(ArmRig, StopSuite):
    """What any stop owes."""
