"""A rover with eyes: all that the scene of a dashboard draws, each thing where it can be told to be.

Run as `python seen.py [VISUALS]`, which go into its base; takes orders as `robot_nodes.py` does.

In `map` the robot is at (3, 1), turned by 90 degrees to the left.
"""

from __future__ import annotations

import array
import gc
import math
import os
import struct
import sys
import threading
from typing import Any

import numpy as np
import rclpy
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import OccupancyGrid, Odometry, Path
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from robot_nodes import LATCHED, Caster, serve, transforms
from rosbags.typesys import Stores, get_typestore
from sensor_msgs.msg import (
    CameraInfo,
    CompressedImage,
    Image,
    JointState,
    LaserScan,
    NavSatFix,
    PointCloud2,
    PointField,
)
from std_msgs.msg import String

from rcp_ros2.definitions import define_text
from rcp_ros2.idl import load

BEST_EFFORT = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
LEFT = math.sqrt(0.5)  # z and w of a quarter turn
WIDTH, HEIGHT = 64, 48

URDF = """
<robot name="seen">
  <material name="blue"><color rgba="0.2 0.4 0.9 1"/></material>
  <link name="base_link">
    <visual><origin xyz="0 0 0.2"/><geometry><box size="0.6 0.4 0.2"/></geometry><material name="blue"/></visual>
    MESHES
  </link>
  <link name="wheel"><visual><origin rpy="1.5708 0 0"/><geometry><cylinder radius="0.15" length="0.06"/></geometry></visual></link>
  <link name="finger"><visual><geometry><box size="0.1 0.05 0.05"/></geometry></visual></link>
  <link name="other_finger"><visual><geometry><box size="0.1 0.05 0.05"/></geometry></visual></link>
  <link name="mast"><visual><geometry><cylinder radius="0.03" length="1"/></geometry></visual></link>
  <link name="charger"><visual><geometry><box size="0.3 0.3 0.3"/></geometry></visual></link>
  <joint name="wheel_joint" type="continuous"><origin xyz="0 0.25 0.15"/><axis xyz="0 1 0"/><parent link="base_link"/><child link="wheel"/></joint>
  <joint name="finger_joint" type="prismatic"><origin xyz="0.5 0 0.4"/><axis xyz="0 1 0"/><limit lower="0" upper="0.05" effort="1" velocity="1"/><parent link="base_link"/><child link="finger"/></joint>
  <joint name="other_finger_joint" type="prismatic"><origin xyz="0.5 0 0.4"/><axis xyz="0 -1 0"/><limit lower="0" upper="0.05" effort="1" velocity="1"/><mimic joint="finger_joint"/><parent link="base_link"/><child link="other_finger"/></joint>
  <joint name="mast_joint" type="revolute"><origin xyz="-0.2 0 0.3"/><axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="1" velocity="1"/><parent link="base_link"/><child link="mast"/></joint>
</robot>
"""


def cloud(frame: str, extra: str, points: list[tuple[float, float, float, int]]) -> PointCloud2:
    """Pack points with `rgb` or `intensity` behind their places."""
    kind, letter = (PointField.FLOAT32, "I") if extra == "rgb" else (PointField.UINT16, "Hxx")
    made = PointCloud2(height=1, width=len(points), point_step=16, row_step=16 * len(points))
    made.header.frame_id = frame
    made.fields = [
        PointField(name=name, offset=4 * at, datatype=PointField.FLOAT32, count=1)
        for at, name in enumerate("xyz")
    ] + [PointField(name=extra, offset=12, datatype=kind, count=1)]
    made.data = array.array("B", b"".join(struct.pack(f"<fff{letter}", *point) for point in points))
    return made


MARKERS = "visualization_msgs/msg/MarkerArray"
"""Which no package here has: it is made of its text, and encoded by what reads and writes recordings."""


def markers(*told: tuple[str, int, int, tuple[float, float, float], bool]) -> bytes:
    """Encode markers of one metre: frame, number, type, place, and whether it moves with its frame."""
    store = get_typestore(Stores.ROS2_JAZZY)
    kinds = store.types

    def made(name: str, **fields: Any) -> Any:
        return kinds[name](**fields)

    none = np.zeros(0, np.uint8)
    stamp = made("builtin_interfaces/msg/Time", sec=0, nanosec=0)
    bare = made("std_msgs/msg/Header", stamp=stamp, frame_id="")
    picture = made("sensor_msgs/msg/CompressedImage", header=bare, format="", data=none)
    file = made("visualization_msgs/msg/MeshFile", filename="", data=none)
    found: list[Any] = []
    for frame, number, kind, (x, y, z), locked in told:
        pose = made(
            "geometry_msgs/msg/Pose",
            position=made("geometry_msgs/msg/Point", x=x, y=y, z=z),
            orientation=made("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0),
        )
        marker = made(
            "visualization_msgs/msg/Marker",
            header=made("std_msgs/msg/Header", stamp=stamp, frame_id=frame),
            ns="things",
            id=number,
            type=kind,
            action=0,
            pose=pose,
            scale=made("geometry_msgs/msg/Vector3", x=1.0, y=1.0, z=1.0),
            color=made("std_msgs/msg/ColorRGBA", r=0.0, g=0.0, b=1.0, a=1.0),
            lifetime=made("builtin_interfaces/msg/Duration", sec=0, nanosec=0),
            frame_locked=locked,
            points=[],
            colors=[],
            texture_resource="",
            texture=picture,
            uv_coordinates=[],
            text="dock",
            mesh_resource="",
            mesh_file=file,
            mesh_use_embedded_materials=False,
        )
        found.append(marker)
    return bytes(store.serialize_cdr(made(MARKERS, markers=found), MARKERS))


def type_of(publisher: Any) -> Any:
    """Return the type of a topic that no package has."""
    return publisher.msg_type


def image(encoding: str, letter: str, pixels: list[Any]) -> Image:
    """Make an image of one number, or some bytes, a pixel."""
    data = b"".join(p if isinstance(p, bytes) else struct.pack(f"<{letter}", p) for p in pixels)
    made = Image(width=WIDTH, height=HEIGHT, encoding=encoding, step=len(data) // HEIGHT)
    made.header.frame_id = "camera"
    made.data = array.array("B", data)
    return made


class Eyes(Node):
    """Publishes it all."""

    def __init__(self, urdf: str) -> None:
        super().__init__("eyes")
        self.caster = Caster("state_publisher", moving=True)
        self.lift = 0.3
        """Metres above the base where the mast is, by its transform."""
        self.values = {"wheel_joint": 1.0, "finger_joint": 0.1}
        self.made: list[tuple[Any, Any]] = []
        self.latched()
        self.streams()
        define_text(
            MARKERS,
            get_typestore(Stores.ROS2_JAZZY).generate_msgdef(MARKERS, ros_version=2)[0],
        )
        self.things = self.create_publisher(load(MARKERS), "/things", LATCHED)
        self.things.publish(
            markers(
                ("map", 1, 1, (-3.0, 5.0, 0.0), False),
                ("mast", 2, 2, (0.0, 0.0, 1.0), True),
                ("nowhere", 3, 1, (0.0, 0.0, 0.0), False),
            )
        )
        self.caster.static.publish(
            transforms(
                ("base_link", "laser", 0, [0.2, 0.0, 0.3, 0.0, 0.0, 0.0, 1.0]),
                ("base_link", "camera", 0, [0.1, 0.0, 0.5, 0.0, 0.0, 0.0, 1.0]),
                ("map", "charger", 0, [-2.0, -2.0, 0.0, 0.0, 0.0, 0.0, 1.0]),
            )
        )
        self.declare_parameter("robot_description", urdf)
        self.semantic = self.create_publisher(String, "/robot_description_semantic", LATCHED)
        self.semantic.publish(String(data='<robot name="seen"><group name="all"/></robot>'))
        self.description = self.create_publisher(String, "/robot_description", LATCHED)
        self.description.publish(String(data=urdf))
        self.joints = self.create_publisher(JointState, "/joint_states", 10)
        self.twin = self.create_publisher(type_of(self.caster.static), "/twin/tf", 10)
        self.create_timer(0.2, self.tick)

    def offer(self, message: Any, topic: str, qos: Any = 10) -> None:
        self.made.append((self.create_publisher(type(message), topic, qos), message))

    def latched(self) -> None:
        grid = OccupancyGrid()
        grid.header.frame_id = "map"
        grid.info.resolution = 0.1
        grid.info.width = grid.info.height = 120
        grid.info.origin.position.x = grid.info.origin.position.y = -5.0
        cells = [
            -1 if x < 10 else 100 if x in (10, 119) else 0 for _ in range(120) for x in range(120)
        ]
        grid.data = array.array("b", cells)
        self.map = self.create_publisher(OccupancyGrid, "/map", LATCHED)
        self.map.publish(grid)

    def streams(self) -> None:
        beams = LaserScan(angle_min=-0.05, angle_max=0.05, angle_increment=0.01, range_min=0.1)
        beams.range_max = 10.0
        beams.ranges = [math.inf, *[2.0] * 9, math.nan]
        beams.header.frame_id = "laser"
        self.offer(beams, "/scan", BEST_EFFORT)
        near = [(x / 50, y / 50) for x in range(-10, 11) for y in range(-10, 11)]
        green = [(3 + x, 1 + y, 0.0, 0x10D020) for x, y in near]
        self.offer(cloud("camera", "rgb", [*green, (math.nan, 0, 0, 0)]), "/points", BEST_EFFORT)
        weak = [(x, y - 2, 1.0, n) for n, (x, y) in enumerate(near)]
        self.offer(cloud("base_link", "intensity", weak), "/lidar/points", BEST_EFFORT)
        lost = cloud("nowhere", "rgb", [(0, 0, 0, 0)])
        self.offer(lost, "/lost/points")
        way = Path()
        way.header.frame_id = "odom"
        for at in range(4):
            pose = PoseStamped()
            pose.pose.position.x = float(at)
            way.poses.append(pose)
        self.offer(way, "/plan")
        seen = LaserScan(angle_max=0.0, angle_increment=0.1, range_min=0.1, range_max=10.0)
        seen.ranges = [1.0]
        seen.header.frame_id = "base_link"
        self.offer(seen, "/twin/scan", BEST_EFFORT)
        odom = Odometry(child_frame_id="base_link")
        odom.header.frame_id = "odom"
        odom.pose.pose.position.x, odom.pose.pose.position.y = 2.0, 1.0
        odom.pose.pose.orientation.z = odom.pose.pose.orientation.w = LEFT
        self.offer(odom, "/odom")
        goal = PoseStamped()
        goal.header.frame_id = "map"
        goal.pose.position.x = goal.pose.position.y = 2.0
        self.offer(goal, "/goal_pose")
        self.pictures()
        self.offer(NavSatFix(latitude=47.5, longitude=8.5, altitude=400.0), "/fix")

    def pictures(self) -> None:
        import simplejpeg

        halves = [b"\xd0\x20\x20" if x < WIDTH / 2 else b"\x20\x20\xd0" for x in range(WIDTH)]
        self.offer(image("rgb8", "", halves * HEIGHT), "/camera/image_raw")
        steps = [0 if x < 8 else 500 if x < 32 else 4000 for x in range(WIDTH)]
        self.offer(image("16UC1", "H", steps * HEIGHT), "/depth/image_raw")
        metres = [math.nan if x < 8 else 0.5 if x < 32 else 4.0 for x in range(WIDTH)]
        self.offer(image("32FC1", "f", metres * HEIGHT), "/far/image_raw")
        grey = np.full((HEIGHT, WIDTH, 3), 120, np.uint8)
        packed = CompressedImage(format="jpeg")
        packed.data = array.array("B", simplejpeg.encode_jpeg(grey))
        self.offer(packed, "/camera/compressed")
        self.offer(CameraInfo(width=WIDTH, height=HEIGHT), "/camera/camera_info")

    def tick(self) -> None:
        now = self.get_clock().now()
        for publisher, message in self.made:
            message.header.stamp = now.to_msg()
            publisher.publish(message)
        turned = [0.0, 0.0, LEFT, LEFT]
        self.caster.moving.publish(
            transforms(
                ("map", "odom", now.nanoseconds, [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]),
                ("odom", "base_link", now.nanoseconds, [2.0, 1.0, 0.0, *turned]),
                ("base_link", "mast", now.nanoseconds, [-0.2, 0.0, self.lift, 0.0, 0.0, 0.0, 1.0]),
            )
        )
        self.twin.publish(
            transforms(("map", "base_link", now.nanoseconds, [-3.0, 3.0, 0.0, *turned]))
        )
        state = JointState(name=list(self.values), position=list(self.values.values()))
        state.header.stamp = now.to_msg()
        self.joints.publish(state)

    def bend(self, joint: str, value: float) -> None:
        """Have a joint somewhere else."""
        self.values[joint] = value

    def raise_mast(self, lift: float) -> None:
        """Have a link somewhere else that only transforms tell of."""
        self.lift = lift


def main() -> None:
    rclpy.init()
    eyes = Eyes(URDF.replace("MESHES", sys.argv[1] if len(sys.argv) > 1 else ""))
    executor = SingleThreadedExecutor()
    for node in (eyes, eyes.caster):
        executor.add_node(node)
    spinning = threading.Thread(target=executor.spin, daemon=True)
    spinning.start()
    serve(eyes)
    executor.shutdown(timeout_sec=1)
    spinning.join(2)
    for node in (eyes, eyes.caster):
        node.destroy_node()
    rclpy.shutdown()
    del eyes, executor, spinning, node
    gc.collect()  # the participant leaves the graph with its last reference
    os._exit(0)


if __name__ == "__main__":
    main()
