"""Real ROS 2 on this machine only; without rclpy these tests are not collected."""

from __future__ import annotations

import importlib.util
import os
import tempfile
import warnings
from collections.abc import AsyncIterator, Iterator
from typing import Any

import pytest

from failures import failed

os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
os.environ.setdefault("ROS_LOG_DIR", tempfile.gettempdir())
os.environ.setdefault("HOME", tempfile.gettempdir())

if importlib.util.find_spec("rclpy") is None:
    collect_ignore_glob = ["test_*.py"]
else:
    with warnings.catch_warnings():  # its parser imports a module that Python has deprecated
        warnings.simplefilter("ignore")
        import rosidl_parser.definition
        import rosidl_parser.parser  # noqa: F401
    from backends.ros2.rig import Rig
    from backends.ros2.robot import Fleet, Peer, Robot, RobotNodes, fresh_domain, robot_of

    MAP: dict[str, Any] = {
        "/sensor/odom": {"topic": "/odom"},
        "/sensor/pose": {"topic": "/odom", "field": "pose.pose"},
        "/sensor/imu": {"topic": "/imu"},
        "/sensor/scan": {"topic": "/scan"},
        "/sensor/description": {"topic": "/robot_description"},
        "/sensor/heard": {"topic": "/twist_heard"},
        "/actuator/cmd_vel": {"topic": "/cmd_vel", "type": "geometry_msgs/msg/Twist"},
        "/actuator/nobody": {"topic": "/nobody", "type": "std_msgs/msg/Float64"},
        "/event/fault": {"topic": "/faults"},
        "/service/reset": {"service": "/reset", "type": "std_srvs/srv/Trigger"},
        "/service/set_bool": {"service": "/set_bool"},
        "/service/add": {"service": "/add"},
        "/service/slow": {"service": "/slow", "timeout": 0.5},
        "/service/fault": {"service": "/fault"},
        "/action/fibonacci": {"action": "/fibonacci"},
        "/param/speed_limit": {"node": "/peer", "parameter": "max_speed"},
        "/param/gear": {"node": "/peer", "parameter": "gear"},
        "/param/serial": {"node": "/peer", "parameter": "serial"},
        "/param/mode": {"node": "/peer", "parameter": "mode"},
        "/param/gains": {"node": "/peer", "parameter": "gains"},
    }

    @pytest.fixture(scope="session")
    def anyio_backend() -> str:
        """One event loop for the fixtures that several tests share."""
        return "asyncio"

    @pytest.fixture(scope="session")
    def domain() -> int:
        """The domain of the peer that lives as long as the run."""
        return fresh_domain()

    @pytest.fixture(scope="session")
    def peer(domain: int) -> Iterator[Peer]:
        """A robot that lives as long as the run."""
        peer = Peer(domain)
        peer.start()
        yield peer
        peer.stop()

    @pytest.fixture(scope="session")
    def nodes_domain() -> int:
        """The domain of the robot_nodes that lives as long as the run."""
        return fresh_domain()

    @pytest.fixture(scope="session")
    def robot_nodes(nodes_domain: int) -> Iterator[RobotNodes]:
        """Nodes that follow ROS's conventions, for as long as the run."""
        robot_nodes = RobotNodes(nodes_domain)
        robot_nodes.start()
        yield robot_nodes
        robot_nodes.stop()

    @pytest.fixture(scope="session")
    def fleet_domain() -> int:
        """The domain of the fleet that lives as long as the run."""
        return fresh_domain()

    @pytest.fixture(scope="session")
    def fleet(fleet_domain: int) -> Iterator[Fleet]:
        """Two rovers, for as long as the run."""
        fleet = Fleet(fleet_domain, "/fleet/r1", "/fleet/r2")
        fleet.start()
        yield fleet
        fleet.stop()

    @pytest.fixture(scope="module")
    async def module_robot(domain: int, peer: Peer) -> AsyncIterator[Robot]:
        """A backend with the whole map; discovery takes its time, so one does for a module."""
        async with robot_of(domain, map=MAP) as robot:
            named = {name.removeprefix("/") for name in MAP}
            await robot.until(lambda: named <= robot.resources.keys(), 60.0)
            yield robot

    @pytest.fixture
    def robot(module_robot: Robot) -> Robot:
        """The backend, with nothing said to its host yet."""
        module_robot.samples.clear()
        module_robot.reports.clear()
        return module_robot

    @pytest.fixture(scope="module")
    def module_rig() -> Iterator[Rig]:
        rig = Rig()
        rig.start()
        yield rig
        rig.stop()

    @pytest.fixture
    def rig(module_rig: Rig, request: pytest.FixtureRequest) -> Iterator[Rig]:
        """The base at rest, with nobody commanding it."""
        yield module_rig
        if failed(request.node):
            module_rig.replace()
        else:
            module_rig.renew()
