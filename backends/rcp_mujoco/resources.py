"""The resources of a simulated robot."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from rcp_kernel.model import Resource
from rcp_mujoco.arm import Arm
from rcp_mujoco.config import Factor, MujocoConfig
from rcp_mujoco.joints import plain
from rcp_mujoco.messages import Reset, SimulationState
from rcp_mujoco.model_types import drive_type, step_types
from rcp_mujoco.publisher import SCAN_RATE
from rcp_mujoco.robot import Robot
from rcp_mujoco.sensors import Reading
from rcp_mujoco.wheels import Wheels
from rcp_profiles import claim, offer
from rcp_profiles import messages as p
from rcp_profiles.claim import Offer

__all__ = ["Catalogue", "camera_resources", "catalogue"]

_COMMAND_AGE = 1.0  # s
_DRIVE_TIME = 900.0  # s
_ARM_TIME = 300.0  # s
_TRAJECTORY_TIME = 4000.0  # s
_STEP_TIME = 300.0  # s
_DEADLINE = 2.5  # s: values are repeated while the simulation is paused


class Catalogue(NamedTuple):
    """The resources of a robot, and the types generated for it."""

    resources: list[Resource]
    observation: Any

    def type_of(self, name: str) -> Any:
        """Return the type of a value."""
        return next(resource.value for resource in self.resources if resource.name == name)


def catalogue(robot: Robot, readings: list[Reading]) -> Catalogue:
    """Make the resources of a robot, with the profiles of its parts."""
    config = robot.config
    step, observation = step_types(robot.simulation.drives, readings)
    profiles = ["power"]
    offers: list[Offer | Resource] = [_sensor(reading) for reading in readings]
    offers += _time(step, observation)
    offers += _drives(robot, config.valid_for)
    if any(reading.name == "sensor/scan" for reading in readings):
        profiles.append("lidar")
    if robot.wheels is not None:
        profiles.append("mobile")
        offers += _wheels(robot.wheels, config)
    if robot.arm is not None:
        profiles.append("arm")
        offers += _arm(robot, robot.arm)
    if robot.gripper is not None:
        profiles.append("gripper")
        bounds = {"width": robot.gripper.limits}
        offers.append(offer("action/move_gripper", bounds, timeout=60.0))
    return Catalogue(claim(profiles, *offers), observation)


def _sensor(reading: Reading) -> Resource:
    return Resource(
        name=reading.name,
        description=reading.description,
        value=reading.value,
        live=not reading.is_scan,
        deadline=_DEADLINE,
        history=16 if reading.is_scan else 128,
        meta={"rate": SCAN_RATE} if reading.is_scan else {},
    )


def _time(step: Any, observation: Any) -> list[Resource]:
    return [
        Resource(
            name="sensor/simulation",
            description="Time of the simulation, how fast it passes, and whether there is a fault.",
            value=SimulationState,
            examples=(
                {
                    "time": 12.5,
                    "paused": False,
                    "real_time_factor": 1.0,
                    "resets": 0,
                    "brakes": False,
                },
            ),
            live=True,
            deadline=_DEADLINE,
        ),
        Resource(
            name="param/paused",
            description="Whether the simulation's time stands still, except for `service/step`.",
            value=bool,
            examples=(True, False),
            live=True,
        ),
        Resource(
            name="param/real_time_factor",
            description="How many seconds are simulated in a second, if the computer is fast enough.",
            value=Factor,
            examples=(1.0, 2.0),
            live=True,
        ),
        Resource(
            name="service/step",
            description="Set controls and do steps of a paused simulation, then measure.",
            input=step,
            output=observation,
            examples=({"steps": 5},),
            timeout=_STEP_TIME,
            moves=True,
        ),
        Resource(
            name="service/reset",
            description="Put everything back to the start, at rest, and clear a fault of the simulation.",
            input=Reset | None,
            output=SimulationState,
            examples=(None, {"seed": 7}),
        ),
        Resource(
            name="service/reset_system",
            description="Stop the robot where it is, count odometry from here and restore the speed limit.",
            output=SimulationState,
        ),
    ]


def _drives(robot: Robot, valid_for: float) -> list[Resource]:
    found: list[Resource] = []
    for drive in robot.simulation.drives:
        lapses: dict[str, Any] = {} if drive.safe is None else {"valid_for": valid_for}
        bounds: dict[str, Any] = {"actuator": drive.name, "mode": drive.mode, **lapses}
        middle = round(min(drive.high, max(drive.low, (drive.low + drive.high) / 2)), 6)
        found.append(
            Resource(
                name=f"actuator/{drive.name}",
                description=_DRIVES[drive.mode].format(drive.name),
                value=drive_type(drive),
                examples=(middle,),
                max_age=_COMMAND_AGE,
                safe=drive.safe,
                atomic=_CONTROLS if len(robot.simulation.drives) > 1 else None,
                meta=bounds,
            )
        )
    return found


_CONTROLS = "controls"  # which are set in the same step of the simulation
_DRIVES = {
    "position": "Position that actuator '{}' brings its joint to and holds.",
    "velocity": "Velocity of actuator '{}', in force for a time of the simulation.",
    "torque": "Force or torque of actuator '{}', in force for a time of the simulation.",
    "other": "Control of actuator '{}' of the model.",
}


def _wheels(wheels: Wheels, config: MujocoConfig) -> list[Offer | Resource]:
    most, turn = wheels.config.speed, wheels.config.turn
    none = dict.fromkeys(("linear.y", "linear.z", "angular.x", "angular.y"), (0.0, 0.0))
    bounds = {"linear.x": (-most, most), **none, "angular.z": (-turn, turn)}
    # The gateway's own dead-man uses wall-clock time. It must not be faster than the simulation's.
    window = config.valid_for / min(1.0, config.real_time_factor)
    return [
        offer(
            "actuator/cmd_vel",
            bounds,
            examples=({"linear": {"x": 0.2}, "angular": {"z": 0.2}}, {"linear": {"x": 0.0}}),
            live=True,
            valid_for=window,
            meta={"valid_for": config.valid_for, "clock": "simulation"},
        ),
        offer("param/speed_limit", (0.0, most), examples=(most, 0.3 * most), live=True),
        offer(
            "action/move_to",
            {"speed": (None, most)},
            description="Drive straight to a position, and turn to a heading if one is given; nothing is driven around.",
            examples=({"position": {"x": 1.0, "y": 0.5}},),
            timeout=_DRIVE_TIME,
        ),
    ]


def _arm(robot: Robot, arm: Arm) -> list[Offer | Resource]:
    first = arm.joints[0].name
    limits = {joint.name: (_bound(joint.low), _bound(joint.high)) for joint in arm.joints}
    goals = {f"positions.{name}": bound for name, bound in limits.items()}
    points = {f"points.{place}": bound for place, bound in goals.items()}
    there, back = ({"positions": {first: place}} for place in (0.1, 0.0))
    found: list[Offer | Resource] = [
        offer(
            "action/move_joints",
            goals,
            examples=(there, {**back, "speed": 0.5}),
            timeout=_ARM_TIME,
        ),
        offer(
            "action/follow_trajectory",
            points,
            examples=({"points": [{"time": 1.0, **there}, {"time": 2.0, **back}]},),
            timeout=_TRAJECTORY_TIME,
        ),
    ]
    if robot.kinematics is not None:
        here = robot.tool_pose(0).position
        position = {"x": round(here.x, 3), "y": round(here.y, 3), "z": round(here.z, 3)}
        found.append(
            offer("action/move_tool", examples=({"position": position},), timeout=_ARM_TIME)
        )
    return found


def _bound(limit: float) -> float | None:
    return limit if math.isfinite(limit) else None


def camera_resources(robot: Robot) -> dict[str, Resource]:
    """Make the resources of the model's cameras, by the camera's name."""
    model, config = robot.simulation.model, robot.config
    names = [model.camera(i).name for i in range(model.ncam) if model.camera(i).name]
    found: dict[str, Resource] = {}
    for name in names:
        view = Resource(
            name="sensor/camera" if len(names) == 1 else f"sensor/camera/{plain(name)}",
            description=f"Image of camera '{name}'; its first row is the upper one.",
            value=p.Image,
            deadline=_DEADLINE,
            history=4,
            meta={"rate": config.camera_rate, "fovy": float(model.camera(name).fovy[0])},
        )
        found[name] = claim(["camera"], view)[0] if len(names) == 1 else view
    return found
