"""roslib and roslibpy as they are, against a robot that knows nothing of ROS."""

from __future__ import annotations

import asyncio
import json
import sys
from pathlib import Path
from typing import Any

from configuration import backend
from node import node, npm_packages
from plugins.rosbridge.rig import OPEN, OPERATOR, ROVER, Site, site
from rcp_clients import CLIENTS

_HERE = Path(__file__).parent
_LIMIT = 120.0  # s
ROVER_FACTS: dict[str, Any] = {
    "odom": "/odom",
    "cmd_vel": "/cmd_vel",
    "stops": True,
    "long": ["/scan", "sensor_msgs/LaserScan"],
    "trigger": "/reset_system",
    "param": "/rover:speed_limit",
    "value": 0.8,
    "action": {
        "name": "/navigate_to_pose",
        "type": "nav2_msgs/action/NavigateToPose",
        "goal": {"pose": {"pose": {"position": {"x": 0.3, "y": 0.0}}}},
        "far": {"pose": {"pose": {"position": {"x": 8.0, "y": 0.0}}}},
    },
}


async def run(*command: str, cwd: Path | None = None) -> dict[str, Any]:
    """Run a client; return what it found."""
    process = await asyncio.create_subprocess_exec(
        *command, cwd=cwd, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE
    )
    try:
        async with asyncio.timeout(_LIMIT):
            out, err = await process.communicate()
    finally:
        if process.returncode is None:
            process.kill()
    assert process.returncode == 0, out.decode() + err.decode()
    return json.loads(out.splitlines()[-1])


async def in_node(folder: Path, script: str, *arguments: str) -> dict[str, Any]:
    """Run a page."""
    (folder / "node_modules").symlink_to(npm_packages("rosbridge") / "node_modules")
    page = folder / script
    page.write_text((_HERE / script).read_text())
    return await run(node(), "--no-warnings", str(page), *arguments, cwd=folder)


async def roslib(folder: Path, url: str, token: str, facts: dict[str, Any]) -> dict[str, Any]:
    """Run the page that uses everything."""
    return await in_node(folder, "page.mjs", url, token, json.dumps(facts))


async def roslib_offers(folder: Path, url: str) -> None:
    """Have roslib offer what another page calls, and check what that got."""
    found = await in_node(folder, "offers.mjs", url)
    assert found["set"] == {"success": True, "message": "set to true"}
    assert found["later"] == {"success": True, "message": "later"}
    assert found["counted"] == {"sequence": [0, 1, 1]}
    assert found["fed"] == [[0]]
    assert found["failed"]
    assert found["cancelled"] in ("result", "ended")


async def roslibpy_offers(port: int) -> None:
    """Have roslibpy offer what another script calls, and check what that got."""
    script = str(_HERE / "offers.py")
    found = await run(sys.executable, "-W", "ignore", script, "127.0.0.1", str(port))
    assert found["set"] == {"success": True, "message": "set to True"}


async def roslibpy(port: int, facts: dict[str, Any]) -> dict[str, Any]:
    """Run the script."""
    script = str(_HERE / "script.py")
    return await run(
        sys.executable, "-W", "ignore", script, "127.0.0.1", str(port), json.dumps(facts)
    )


async def test_roslib_does_all_it_can(tmp_path: Path) -> None:
    async with site("anonymous = false\n", ROVER) as gateway:
        found = await roslib(tmp_path, gateway.url + "/rosbridge", OPERATOR, ROVER_FACTS)
    assert found["odom_type"] == "nav_msgs/msg/Odometry"
    assert found["cmd_vel_type"] == "geometry_msgs/msg/Twist"
    assert found["nodes"] == ["/rover"]
    assert found["topic_type"] == "nav_msgs/msg/Odometry"
    assert found["service_type"] == "std_srvs/srv/Trigger"
    assert found["for_type"] == ["/odom"]
    assert "/navigate_to_pose" in found["actions"]
    assert set(found["details"]) >= {"header", "pose", "twist"}
    assert found["raw"] > 20
    assert found["speed"] > 0.1
    assert found["stopped"]
    assert -1.0 <= found["png"] <= 1.0
    assert -1.0 <= found["cbor"] <= 1.0
    assert found["cbor-raw"] > 700
    assert found["covariance"] == "Float64Array 36"
    assert found["fragments"]
    assert found["trigger"]["success"] is True
    assert "no service" in found["missing"]
    assert found["param"] == 0.8
    assert found["feedback"] > 0
    assert found["cancelled"]


async def test_roslibpy_does_all_it_can() -> None:
    async with site(OPEN, ROVER, status="error") as gateway:
        found = await roslibpy(port_of(gateway), ROVER_FACTS)
    assert found["topics"]
    assert found["services"]
    assert found["type"] == "nav_msgs/msg/Odometry"
    assert found["service_type"] == "std_srvs/srv/Trigger"
    assert "nav_msgs/msg/Odometry" in found["details"]
    assert found["speed"] > 0.1
    assert found["trigger"]["success"] is True
    assert found["param"] == 0.8
    assert found["status"] == "SUCCEEDED"
    assert found["feedback"] > 0
    assert found["connected"]


async def test_roslibpy_offers_what_others_call() -> None:
    offers = backend("offered", use="clients")
    async with site(OPEN, ROVER, offers, kinds=(CLIENTS,)) as gateway:
        await roslibpy_offers(port_of(gateway))


def port_of(gateway: Site) -> int:
    assert gateway.port
    return int(gateway.port)
