"""A client that comes as soon as the port is open has the robot's data, however long discovery takes."""

from __future__ import annotations

import asyncio
import os
from pathlib import Path
from typing import Any

import pytest
from websockets.asyncio.client import ClientConnection, connect

from backends.ros2.robot import BOUND, Peer
from configuration import backend, key, listener, table
from rcp_gateway.testing import decode, encode, serve
from rcp_kernel.values import Encoding
from rcp_ros2 import rcp_backends
from serving import serving

pytestmark = pytest.mark.anyio

RESTARTS = int(os.environ.get("RCP_RESTARTS", "2"))
MAP = {
    "/sensor/odom": {"topic": "/odom", "type": "nav_msgs/msg/Odometry"},
    "/sensor/imu": {"topic": "/imu"},
    "/sensor/nowhere": {"topic": "/nowhere"},
    "/actuator/velocity": {"topic": "/cmd_vel", "type": "geometry_msgs/msg/Twist"},
    "/service/reset": {"service": "/reset", "type": "std_srvs/srv/Trigger"},
    "/action/fibonacci": {"action": "/fibonacci", "type": "test_msgs/action/Fibonacci"},
}
OPERATOR = key("operator", "operator-operator")
CONFIG = listener() + table("anonymous", role="operator")


def mapped(domain: int, **fields: Any) -> str:
    return backend("robot", use="ros2", domain_id=domain, map=MAP, **fields)


async def subscribe(socket: ClientConnection, path: str, number: int) -> dict[str, Any]:
    """Ask once; updates of other subscriptions may come before the answer."""
    ask = {"type": "subscribe", "id": f"s{number}", "path": f"/tenant/alpha{path}"}
    await socket.send(encode(ask, Encoding.JSON).decode())
    while True:
        found = decode(str(await socket.recv()).encode(), Encoding.JSON)
        if found["type"] == "subscribe":
            return found


async def test_what_is_asked_for_as_soon_as_the_port_is_open_comes(
    domain: int, peer: Peer, tmp_path: Path
) -> None:
    text = CONFIG + mapped(domain)
    for _ in range(RESTARTS):
        with serving(tmp_path / "rcp.toml", text) as url:
            async with asyncio.timeout(BOUND), connect(_ws(url), proxy=None) as socket:
                number = 0
                for path in ("/sensor/nowhere", "/sensor/imu", "/sensor/odom"):
                    while "error" in (reply := await subscribe(socket, path, number)):
                        assert reply["error"]["retryable"] is True, reply
                        assert reply["error"]["retry_after"] > 0, reply
                        number += 1
                        await asyncio.sleep(reply["error"]["retry_after"] / 4)
                    number += 1
                wanted = {"/tenant/alpha/sensor/imu", "/tenant/alpha/sensor/odom"}
                while wanted:
                    found = decode(str(await socket.recv()).encode(), Encoding.JSON)
                    if found["type"] == "update":
                        wanted.discard(found["path"])


async def test_what_is_mapped_with_its_type_is_there_when_the_backend_is_ready(
    domain: int, peer: Peer
) -> None:
    async with serve(mapped(domain) + OPERATOR, *rcp_backends()) as served:
        async with asyncio.timeout(BOUND):
            while served.supervisor.state != "ready":  # noqa: ASYNC110 - nothing tells of it
                await asyncio.sleep(0)
        there = served.supervisor.entries.keys()
        assert there >= {"sensor/odom", "actuator/velocity", "service/reset", "action/fibonacci"}
        client = served.client("operator-operator")
        reply = await client.request("subscribe", "/sensor/none")
        assert (reply["error"]["code"], reply["error"]["retryable"]) == (
            "adapter_unavailable",
            True,
        )
        await client.close()


async def test_what_was_looked_for_long_enough_is_unknown(domain: int, peer: Peer) -> None:
    text = mapped(domain, grace=0.5) + OPERATOR
    async with asyncio.timeout(BOUND), serve(text, *rcp_backends()) as served:
        client = served.client("operator-operator")
        while True:
            reply = await client.request("subscribe", "/sensor/none")
            if reply["error"]["code"] == "unknown_path":
                break
            assert reply["error"]["retryable"] is True, reply
            await asyncio.sleep(0.05)
        assert "sensor/nowhere" in served.supervisor.entries
        await client.close()


def _ws(url: str) -> str:
    return url.replace("http", "ws") + "/rcp/v1/ws"
