"""The resources of a simulated rover."""

from __future__ import annotations

from rcp_kernel.model import Operation, Resource
from rcp_profiles import Offer, claim, offer, twist_limits
from rcp_sim import messages as m
from rcp_sim.body import DESCRIPTION
from rcp_sim.config import SimConfig
from rcp_sim.spatial import JointState, PointCloud, Transforms

__all__ = ["PROFILES", "resources"]

_DRIVE_TIME = 900.0  # s, enough for the longest path in the largest hall at walking pace
_TURNED = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
PROFILES = ("mobile", "battery", "camera", "lidar", "power")
_DRIVE = "drive"  # what can be written as one
_BOX = {"x": 3.0, "y": 1.0, "size_x": 0.5, "size_y": 2.0}


def resources(config: SimConfig) -> list[Resource]:
    """Return the resources of one rover."""
    return claim(
        PROFILES,
        *_sensors(config),
        *_seen(),
        *_commands(),
        *_services(),
        *_events(),
    )


def _sensors(config: SimConfig) -> list[Resource | Offer]:
    fast = max(0.5, 5 / config.rate)
    position = {"x": 12.4, "y": 7.8, "z": 0.0}
    return [
        offer("sensor/pose", live=True, deadline=fast),
        offer("sensor/velocity", live=True, deadline=fast),
        Resource(
            name="sensor/odometry",
            description="Position and speeds from the wheel odometry; it drifts.",
            value=m.Odometry,
            examples=({"pose": {"position": position}, "twist": {"linear": {"x": 0.5}}},),
            live=True,
            deadline=fast,
        ),
        Resource(
            name="sensor/imu",
            description="Angular rate and acceleration of the rover's body, and its heading.",
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
        offer("sensor/scan", deadline=2.5, history=16),
        offer(
            "sensor/battery",
            value=m.Battery,
            examples=({"voltage": 12.1, "current": -0.7, "percentage": 0.81, "energy": 48.6},),
            live=True,
            deadline=max(3.0, 3 / config.battery_rate),
        ),
        offer(
            "sensor/camera",
            value=m.Image,
            examples=({"width": 160, "height": 120, "data": "iVBORw0KGgo="},),
            deadline=2.5,
            history=4,
        ),
        Resource(
            name="sensor/map",
            description="Map of the warehouse as a grid of free and occupied cells.",
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
            description="Point cloud of the forward depth camera, as coloured points in its frame.",
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
            description="Transforms of the rover's frames: map, odom, base_link, laser and camera.",
            value=Transforms,
            examples=({"transforms": [place]},),
            deadline=2.5,
            history=16,
        ),
        Resource(
            name="sensor/joint_states",
            description="Angles and angular velocities of the wheels.",
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


def _commands() -> list[Resource | Offer]:
    goal = {
        "yaw": (-m.FULL_TURN, m.FULL_TURN),
        "tolerance": (0.02, 2),
        "speed": (None, m.TOP_SPEED),
    }
    return [
        offer(
            "actuator/cmd_vel",
            twist_limits(x=m.TOP_SPEED, yaw=m.TOP_TURN),
            live=True,
            atomic=_DRIVE,
        ),
        offer("param/speed_limit", (0, m.TOP_SPEED), examples=(1.0, 0.5), live=True, atomic=_DRIVE),
        offer(
            "action/move_to",
            goal,
            input=m.MoveTo,
            output=m.MoveResult,
            feedback=m.MoveFeedback,
            examples=(
                {"position": {"x": 2.0, "y": 1.0, "z": 0.0}},
                {"position": {"x": -3.0, "y": 2.0}, "yaw": 1.57, "tolerance": 0.05, "speed": 0.8},
            ),
            timeout=_DRIVE_TIME,
        ),
        Resource(
            name="action/dock",
            description="Drive to the charger, which is at the start, and start charging.",
            input=m.Dock | None,
            output=m.DockResult,
            feedback=m.MoveFeedback,
            examples=(None, {}),
            timeout=_DRIVE_TIME,
            max_age=30.0,
        ),
    ]


def _services() -> list[Resource | Offer]:
    return [
        offer(
            "service/reset_system",
            description="Stop the rover and reset odometry, faults, placed boxes and speed limit.",
            input=m.ResetSystem | None,
            output=m.ResetResult,
            examples=(None, {}, {"pose": True, "battery": True}),
        ),
        Resource(
            name="service/place_obstacle",
            description="Put a box on the floor; the map, the scan and planned paths change accordingly.",
            input=m.Box,
            output=m.ObstacleId,
            examples=(_BOX,),
        ),
        Resource(
            name="service/remove_obstacle",
            description="Remove a placed box.",
            input=m.ObstacleId,
            output=m.Obstacles,
            examples=({"id": "box-1"},),
        ),
        Resource(
            name="service/inject_fault",
            description="Inject a fault into the simulated rover. While its"
            " link is lost, nothing reaches it, not even `clear_faults`: the link is restored by itself.",
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
            description="The rover started, after power-on or a reset.",
            value=m.Boot,
            examples=({"reason": "power_on", "model": "rover", "message": "Ready."},),
            live=True,
        ),
        Resource(
            name="event/fault",
            description="A fault of the rover appeared or cleared.",
            value=m.FaultEvent,
            examples=({"fault": "collision", "active": True, "message": "Bumper touched."},),
            live=True,
        ),
        Resource(
            name="event/task",
            description="A task of the rover started, completed, failed or was cancelled.",
            value=m.TaskEvent,
            examples=({"task": "move_to", "state": "completed", "message": "Arrived."},),
            live=True,
        ),
    ]
