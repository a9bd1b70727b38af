"""A simulated robot: its physics, sensors and parts."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from rcp_kernel.clock import iso
from rcp_kernel.errors import ConfigError, DeviceRejected
from rcp_kernel.types import AngularVelocity, LinearVelocity, Point, Pose, PoseStamped, Twist
from rcp_mujoco.arm import Arm
from rcp_mujoco.bindings import mujoco
from rcp_mujoco.config import MujocoConfig
from rcp_mujoco.gripper import Gripper
from rcp_mujoco.joints import distinct
from rcp_mujoco.kinematics import Kinematics
from rcp_mujoco.loading import load_model
from rcp_mujoco.messages import Odometry, SimulationState
from rcp_mujoco.robots import complete, model_path
from rcp_mujoco.sensors import Reading, Sensors, quaternion
from rcp_mujoco.simulation import Simulation
from rcp_mujoco.wheels import Wheels
from rcp_profiles import messages as p

__all__ = ["Robot", "Snapshot"]


class Snapshot(NamedTuple):
    """The simulation's state for the event loop: immutable, replaced as a whole."""

    number: int
    at_rest: bool
    """Measured at rest, without commands or motions in progress."""
    speed: float
    fault: str | None
    doubt: str | None
    braking: bool


class Robot:
    """The part of one robot that the stepping thread owns.

    :raises ConfigError: the model does not load, or has no such parts.
    """

    def __init__(self, config: MujocoConfig) -> None:
        self.config = config = complete(config)
        model = load_model(model_path(config), config.actuate)
        offscreen = model.vis.global_
        offscreen.offwidth = max(offscreen.offwidth, config.camera_width)
        offscreen.offheight = max(offscreen.offheight, config.camera_height)
        try:
            self.simulation = simulation = Simulation(model, keyframe=config.keyframe)
            self.sensors = Sensors(model, simulation.data, config.seed)
            self.wheels = Wheels(config.wheels, simulation) if config.wheels else None
            self.arm = Arm(config.arm, simulation) if config.arm else None
            tool = self.arm is not None and self.arm.config.tool is not None
            self.kinematics = Kinematics(self.arm, simulation) if tool and self.arm else None
            self.gripper = Gripper(config.gripper, simulation) if config.gripper else None
        except (KeyError, DeviceRejected, mujoco.FatalError) as error:
            reason = error.args[0] if error.args else error
            raise ConfigError(f"{config.model}: {reason}") from error
        parts = (self.wheels, self.arm, self.gripper)
        simulation.controllers += [part for part in parts if part is not None]
        self._snapshots = 0

    def snapshot(self) -> Snapshot:
        """Return the state on which stops and status depend."""
        simulation = self.simulation
        self._snapshots += 1
        idle = self.busy is None and not simulation.commanded
        if self.wheels is not None:
            idle = idle and self.wheels.target == (0.0, 0.0)
        return Snapshot(
            self._snapshots,
            simulation.at_rest and idle,
            simulation.speed,
            simulation.fault,
            simulation.doubt,
            simulation.braking,
        )

    @property
    def busy(self) -> str | None:
        """The action that a part is carrying out."""
        if self.wheels is not None and self.wheels.trip is not None:
            return "action/move_to"
        if self.arm is not None and self.arm.motion is not None:
            return "a motion of the arm"
        if self.gripper is not None and self.gripper.grip is not None:
            return "action/move_gripper"
        return None

    def reset(self, seed: int | None) -> None:
        """Restore the initial state."""
        self.simulation.reset()
        if seed is not None:
            self.sensors.seed(seed)

    # Values

    def readings(self) -> list[Reading]:
        """List its readings, apart from cameras and the simulation's state."""
        own = self._own()
        taken = {"sensor/simulation", "sensor/camera", *(reading.name for reading in own)}
        named = [r._replace(name=distinct(r.name, taken)) for r in self.sensors.readings]
        return [*named, *own]

    def _own(self) -> list[Reading]:
        """List the readings of the joints and parts, whose names the profiles give."""
        found: list[Reading] = []
        if self.simulation.joints:
            text = "Position, velocity and force of each joint."
            found.append(Reading("sensor/joint_states", text, p.JointStates, self._joints))
        if self.wheels is not None:
            found += self._of_wheels(self.wheels)
        if self.kinematics is not None:
            text = "Pose of the tool in the frame of the arm's base."
            found.append(Reading("sensor/tool_pose", text, PoseStamped, self.tool_pose))
        if self.gripper is not None:
            text = "How far the gripper is open, and whether it holds something."
            found.append(Reading("sensor/gripper", text, p.GripperState, self.grip_state))
        return found

    def _of_wheels(self, wheels: Wheels) -> list[Reading]:
        base = wheels.config.base

        def pose(now: int) -> PoseStamped:
            position, turn = wheels.body
            return PoseStamped(Point(*position), quaternion(turn), "map", iso(now))

        def velocity(now: int) -> p.TwistStamped:
            v, w = wheels.velocity
            return p.TwistStamped(LinearVelocity(v), AngularVelocity(z=w), base, iso(now))

        def odometry(now: int) -> Odometry:
            x, y, yaw = wheels.odometry
            v, w = wheels.velocity
            here = Pose(Point(x, y), turned(yaw))
            twist = Twist(LinearVelocity(v), AngularVelocity(z=w))
            return Odometry(here, twist, "odom", base, iso(now))

        return [
            Reading("sensor/pose", "Position and heading of the robot.", PoseStamped, pose),
            Reading(
                "sensor/velocity",
                "Velocity of the base as measured at its wheels; positive yaw rate turns left.",
                p.TwistStamped,
                velocity,
            ),
            Reading(
                "sensor/odometry",
                "Pose and velocity counted from the wheels since the last reset; it drifts.",
                Odometry,
                odometry,
            ),
        ]

    def _joints(self, now: int) -> p.JointStates:
        joints, data = self.simulation.joints, self.simulation.data
        return p.JointStates(
            [joint.name for joint in joints],
            data.qpos[[joint.qpos for joint in joints]].tolist(),
            data.qvel[[joint.dof for joint in joints]].tolist(),
            data.qfrc_actuator[[joint.dof for joint in joints]].tolist(),
            iso(now),
        )

    def tool_pose(self, now: int, frame: str | None = None) -> PoseStamped:
        """Return the tool's pose in the frame of the base, or in `map`."""
        assert self.kinematics is not None
        assert self.arm is not None
        pose = self.kinematics.tool()
        if frame == "map":
            pose = self.kinematics.world(pose)
        frame = frame or self.arm.config.base
        place = Point(*pose.position.tolist())
        return PoseStamped(place, quaternion(pose.quaternion.tolist()), frame, iso(now))

    def grip_state(self, now: int) -> p.GripperState:
        """Return the state of the gripper."""
        assert self.gripper is not None
        return p.GripperState(self.gripper.width, self.gripper.holding, iso(now))

    def state(self, *, paused: bool, measured: float) -> SimulationState:
        """Return how the simulation runs."""
        simulation = self.simulation
        return SimulationState(
            simulation.time,
            paused,
            measured,
            simulation.resets,
            simulation.braking,
            simulation.fault,
        )

    def controls(self) -> dict[str, Any]:
        """Return the controls of the actuators."""
        simulation = self.simulation
        return {
            drive.name: float(simulation.data.ctrl[drive.number]) for drive in simulation.drives
        }


def turned(yaw: float) -> Any:
    """Return the orientation of a heading."""
    return quaternion((math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)))
