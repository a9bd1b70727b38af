"""The table of what a simulated rover offers."""

from __future__ import annotations

from typing import Any

from rcp_kernel.model import Operation, Resource
from rcp_kernel.types import LaserScan, PoseStamped
from rcp_sim import messages as m
from rcp_sim.body import DESCRIPTION
from rcp_sim.config import SimConfig
from rcp_sim.spatial import JointState, PointCloud, Transforms

__all__ = ["resources"]

_DRIVE_TIME = 900.0  # s: enough for the longest way in the largest hall at walking pace
_AT = "2026-05-29T14:12:04Z"
_TURNED = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
_BOX = {"x": 3.0, "y": 1.0, "size_x": 0.5, "size_y": 2.0}


def resources(config: SimConfig) -> list[Resource]:
    """Return everything one rover declares."""
    return [*_sensors(config), *_seen(), *_settings(), *_actions(), *_services(), *_events()]


def _sensors(config: SimConfig) -> list[Resource]:
    fast = max(0.5, 5 / config.rate)
    position = {"x": 12.4, "y": 7.8, "z": 0.0}
    return [
        Resource(
            name="sensor/pose",
            description="Where the rover is on the map, position in metres and heading.",
            value=PoseStamped,
            examples=(
                {
                    "position": position,
                    "orientation": _TURNED,
                    "frame_id": "map",
                    "timestamp": _AT,
                },
            ),
            live=True,
            deadline=fast,
        ),
        Resource(
            name="sensor/odometry",
            description="Where the wheels say the rover is, with its speeds; it drifts.",
            value=m.Odometry,
            examples=({"pose": {"position": position}, "twist": {"linear": {"x": 0.5}}},),
            live=True,
            deadline=fast,
        ),
        Resource(
            name="sensor/imu",
            description="Turning rate and acceleration of the rover's body, and its heading.",
            value=m.Imu,
            examples=(
                {
                    "orientation": _TURNED,
                    "angular_velocity": {"z": 0.1},
                    "linear_acceleration": {"z": 9.81},
                },
            ),
            live=True,
            deadline=fast,
        ),
        Resource(
            name="sensor/scan",
            description="One sweep of the laser range finder; a beam without a return is Infinity.",
            value=LaserScan,
            examples=(
                {
                    "angle_min": -3.14,
                    "angle_increment": 1.57,
                    "range_min": 0.05,
                    "range_max": 12.0,
                    "ranges": [4.2, "Infinity", 3.9, "Infinity"],
                },
            ),
            deadline=2.5,
            history=16,
        ),
        Resource(
            name="sensor/battery",
            description="Voltage, current and remaining charge of the battery.",
            value=m.Battery,
            examples=({"voltage": 12.1, "current": -0.7, "percentage": 0.81, "energy": 48.6},),
            live=True,
            deadline=max(3.0, 3 / config.battery_rate),
        ),
        Resource(
            name="sensor/camera",
            description="What the rover's forward camera sees, as a small PNG picture.",
            value=m.Image,
            examples=({"width": 160, "height": 120, "data": "iVBORw0KGgo="},),
            deadline=2.5,
            history=4,
        ),
        Resource(
            name="sensor/map",
            description="The map of the hall as a grid of free and occupied cells.",
            value=m.OccupancyGrid,
            examples=(
                {
                    "resolution": 0.02,
                    "width": 2,
                    "height": 2,
                    "origin": {"position": {"x": -20.0, "y": -20.0}},
                    "data": "AABkZA==",
                },
            ),
            live=True,
            history=1,
        ),
    ]


def _seen() -> list[Resource]:
    stamp = {"sec": 1_780_000_000, "nanosec": 0}
    header = {"stamp": stamp, "frame_id": "base_link"}
    up = {"translation": {"x": 0.0, "y": 0.0, "z": 0.4}, "rotation": _TURNED}
    place = {"header": header, "child_frame_id": "camera", "transform": up}
    return [
        Resource(
            name="sensor/points",
            description="What the depth camera ahead measures, as coloured points in its frame.",
            value=PointCloud,
            examples=(
                {
                    "header": {"stamp": stamp, "frame_id": "camera"},
                    "height": 1,
                    "width": 0,
                    "fields": [{"name": "x", "offset": 0}],
                    "is_bigendian": False,
                    "point_step": 16,
                    "row_step": 0,
                    "data": "",
                },
            ),
            deadline=2.5,
            history=4,
        ),
        Resource(
            name="sensor/transforms",
            description="Where the rover's frames are: map, odom, base_link, laser and camera.",
            value=Transforms,
            examples=({"transforms": [place]},),
            deadline=2.5,
            history=16,
        ),
        Resource(
            name="sensor/joint_states",
            description="How far the wheels have turned, and how fast they do.",
            value=JointState,
            examples=(
                {
                    "header": header,
                    "name": ["left_wheel_joint"],
                    "position": [1.5],
                    "velocity": [0.2],
                },
            ),
            deadline=2.5,
            history=16,
        ),
        Resource(
            name="param/robot_description",
            description="The rover's description, as URDF.",
            value=str,
            operations=Operation.READ | Operation.SUBSCRIBE,
            examples=(DESCRIPTION,),
            live=True,
            history=1,
        ),
    ]


def _settings() -> list[Resource]:
    rest: dict[str, Any] = {"linear": {"x": 0.0}, "angular": {"z": 0.0}}
    return [
        Resource(
            name="actuator/cmd_vel",
            description="Velocity to drive with, forward and turning, until the next one.",
            value=m.Drive,
            examples=({"linear": {"x": 0.4}, "angular": {"z": 0.2}}, rest),
            live=True,
            max_age=1.0,
            valid_for=0.5,
            safe=rest,
        ),
        Resource(
            name="param/speed_limit",
            description="The highest speed the rover drives at, by whatever command.",
            value=m.SpeedLimit,
            examples=(1.0, 0.5),
            live=True,
        ),
    ]


def _actions() -> list[Resource]:
    return [
        Resource(
            name="action/move_to",
            description="Drive to a position on the map, round whatever stands in the way.",
            input=m.MoveTo,
            output=m.MoveResult,
            feedback=m.MoveFeedback,
            examples=(
                {"position": {"x": 2.0, "y": 1.0, "z": 0.0}},
                {"position": {"x": -3.0, "y": 2.0}, "yaw": 1.57, "tolerance": 0.05, "speed": 0.8},
            ),
            timeout=_DRIVE_TIME,
            max_age=30.0,
        ),
        Resource(
            name="action/dock",
            description="Drive to the charger, which stands at the start, and begin to charge.",
            input=m.Dock | None,
            output=m.DockResult,
            feedback=m.MoveFeedback,
            examples=(None, {}),
            timeout=_DRIVE_TIME,
            max_age=30.0,
        ),
    ]


def _services() -> list[Resource]:
    return [
        Resource(
            name="service/reset_system",
            description="Stop the rover and reset odometry, faults, placed boxes and speed limit.",
            input=m.ResetSystem | None,
            output=m.ResetResult,
            examples=(None, {}, {"pose": True, "battery": True}),
        ),
        Resource(
            name="service/place_obstacle",
            description="Put a box on the floor; the map, the scan and the ways change with it.",
            input=m.Box,
            output=m.ObstacleId,
            examples=(_BOX,),
        ),
        Resource(
            name="service/remove_obstacle",
            description="Take a placed box away again.",
            input=m.ObstacleId,
            output=m.Obstacles,
            examples=({"id": "box-1"},),
        ),
        Resource(
            name="service/inject_fault",
            description="Make the simulated rover fail in a chosen way, to see what follows. While its"
            " link is lost nothing reaches it, not even the end of that: it comes back by itself.",
            input=m.FaultSpec,
            output=m.FaultsActive,
            examples=(
                {"fault": "sensor_stop", "target": "sensor/scan", "seconds": 5.0},
                {"fault": "refuse", "target": "action/move_to", "seconds": 30.0},
                {"fault": "slow", "delay": 0.5},
            ),
        ),
        Resource(
            name="service/clear_faults",
            description="End the injected faults, all of them or those of one kind.",
            input=m.ClearFaults | None,
            output=m.FaultsActive,
            examples=(None, {"fault": "slow"}),
        ),
    ]


def _events() -> list[Resource]:
    return [
        Resource(
            name="event/boot",
            description="The rover came up, after power-on or a reset.",
            value=m.Boot,
            examples=({"reason": "power_on", "model": "rover", "message": "Ready."},),
            live=True,
        ),
        Resource(
            name="event/fault",
            description="A fault of the rover came or went.",
            value=m.FaultEvent,
            examples=({"fault": "collision", "active": True, "message": "Bumper touched."},),
            live=True,
        ),
        Resource(
            name="event/task",
            description="A task of the rover began, was completed, cancelled, or failed.",
            value=m.TaskEvent,
            examples=({"task": "move_to", "state": "completed", "message": "Arrived."},),
            live=True,
        ),
    ]
