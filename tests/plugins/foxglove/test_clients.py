"""Foxglove's own client and decoders in front of a simulated rover and of a real ROS 2 robot."""

from __future__ import annotations

import importlib.util
import os
from pathlib import Path
from typing import Any

import pytest

from configuration import backend, table
from plugins.foxglove.driver import driven
from serving import ROVER, serving

KEY = "operator-operator"
FOXGLOVE = table("plugins.foxglove", token_in_url=True)
HAS_ROS = importlib.util.find_spec("rclpy") is not None


def given(url: str, **more: Any) -> dict[str, Any]:
    address = url.replace("http", "ws", 1) + f"/foxglove/alpha?token={KEY}"
    return {"url": address, "subprotocol": "foxglove.sdk.v1", **more}


@pytest.mark.parametrize("subprotocol", ["foxglove.sdk.v1", "foxglove.websocket.v1"])
def test_a_rover_is_watched_and_driven(tmp_path: Path, subprotocol: str) -> None:
    topics = {
        "/sensor/pose": "foxglove.PoseInFrame",
        "/sensor/scan": "foxglove.LaserScan",
        "/sensor/camera": "foxglove.CompressedImage",
        "/sensor/map": "foxglove.Grid",
        "/sensor/points": "foxglove.PointCloud",
        "/sensor/transforms": "foxglove.FrameTransforms",
        "/sensor/battery": "rcp.Battery",
        "/sensor/odometry": "rcp.Odometry",
    }
    with serving(tmp_path / "rcp.toml", ROVER + FOXGLOVE) as url:
        found = driven(
            tmp_path,
            **given(
                url,
                robot="rover",
                topics=list(topics),
                parameters=["/param/speed_limit", "/param/robot_description"],
                set={"name": "/param/speed_limit", "value": 0.7},
                asset="package://rover/base.stl",
            )
            | {"subprotocol": subprotocol},
        )
    channels = found["channels"]
    assert {topic: one["schemaName"] for topic, one in channels.items()} == topics
    for topic in list(topics)[:6]:
        properties = channels[topic]["schema"]["properties"]
        assert set(channels[topic]["value"]) == set(properties), topic
    assert channels["/sensor/pose"]["value"]["frame_id"] == "map"
    assert found["stopped"]
    assert "<robot" in found["parameters"][1]["value"]
    assert found["set"] == found["update"]
    assert found["set"][0]["value"] == 0.7
    assert "/sensor/pose" in found["published"]
    assert "no robot here" in found["asset"]
    assert "not a valid operation" in found["wrong"]


@pytest.mark.skipif(not HAS_ROS, reason="no ROS 2 here")
def test_a_ros_robot_is_watched_and_driven_in_its_own_bytes(tmp_path: Path) -> None:
    from backends.ros2.robot import Peer, fresh_domain

    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    domain = fresh_domain()
    meshes = Path(__file__).parents[2] / "backends" / "ros2" / "peer_description"
    robot = backend(
        "peer",
        use="ros2",
        domain_id=domain,
        expose=["/**"],
        assets={"paths": {"peer_description": meshes}},
    )
    text = ROVER.replace('use = "sim"', 'use = "sim"\nrobot = "rover"') + robot + FOXGLOVE
    peer = Peer(domain)
    peer.start()
    try:
        with serving(tmp_path / "rcp.toml", text) as url:
            found = driven(
                tmp_path,
                **given(
                    url,
                    robot="ros",
                    topics=["/odom", "/imu", "/scan", "/robot_description"],
                    add={
                        "bool_value": True,
                        "int64_value": 41,
                        "uint64_value": 7,
                        "string_value": "abc",
                    },
                    parameters=["/peer.max_speed", "/peer.gear", "/peer.none"],
                    set={"name": "/peer.max_speed", "value": 2.25},
                    asset="package://peer_description/base.stl",
                ),
            )
    finally:
        peer.stop()
    sensors = found["sensors"]
    assert {topic: (one["encoding"], one["schemaName"]) for topic, one in sensors.items()} == {
        "/odom": ("cdr", "nav_msgs/msg/Odometry"),
        "/imu": ("cdr", "sensor_msgs/msg/Imu"),
        "/scan": ("cdr", "sensor_msgs/msg/LaserScan"),
        "/robot_description": ("cdr", "std_msgs/msg/String"),
    }
    odometry = sensors["/odom"]["value"]
    assert odometry["header"]["frame_id"] == "odom"
    assert odometry["child_frame_id"] == "base_link"
    assert odometry["pose"]["covariance"][0] == "Infinity"
    assert sensors["/imu"]["value"]["linear_acceleration"]["z"] == 9.81
    assert sensors["/scan"]["value"]["ranges"] == [1, "Infinity", "NaN"]
    assert "peer_description" in sensors["/robot_description"]["value"]["data"]
    assert found["driven"]["angular"]["z"] == -0.5
    assert found["stopped"]
    assert found["reset"] == {"success": True, "message": "reset done"}
    assert found["refused"] == {"success": False, "message": "it is so already"}
    assert (found["add"]["int64_value"], found["add"]["string_value"]) == (42, "cba")
    assert found["add"]["float64_value"] == "NaN"
    assert [one["value"] for one in found["parameters"]] == [1.5, 2]
    assert found["set"] == found["update"]
    assert found["asset"] == (meshes / "base.stl").stat().st_size
    assert "/odom" in found["published"]
