"""Servers and clients of actions that are used no more, while something arrives for them."""

from __future__ import annotations

import asyncio
import os
import sys
import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest

from backends.ros2.robot import BOUND, Robot, fresh_domain
from rcp_kernel.errors import DeviceTimeout
from rcp_ros2.action_clients import ActionClients
from rcp_ros2.config import Ros2Config
from rcp_ros2.graph import GraphWatch
from rcp_ros2.offer_servers import OfferNode
from rcp_ros2.ros import open_ros

pytestmark = pytest.mark.anyio
_TURNS = 3


async def test_the_process_survives_the_withdrawal_of_offers_that_are_in_use() -> None:
    here = Path(__file__)
    path = os.pathsep.join(filter(None, (str(here.parents[2]), os.environ.get("PYTHONPATH"))))
    process = await asyncio.create_subprocess_exec(
        sys.executable,
        str(here.with_name("withdrawing.py")),
        str(fresh_domain()),
        str(_TURNS),
        env=os.environ | {"PYTHONPATH": path},
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
    )
    try:
        said, errors = await asyncio.wait_for(process.communicate(), BOUND)
    finally:
        if process.returncode is None:
            process.kill()
    assert process.returncode == 0, errors.decode()[-2000:]
    assert said.endswith(b"whole")


async def test_the_client_of_an_action_lives_as_long_as_the_node() -> None:
    from test_msgs.action import Fibonacci, NestedMessage

    config = msgspec.convert({"domain_id": fresh_domain()}, Ros2Config)
    async with open_ros(config, Robot()) as ros:
        clients = ActionClients(ros)
        first = await ros.call(clients.of, Fibonacci, "/one")
        assert await ros.call(clients.of, Fibonacci, "/one") is first
        assert await ros.call(clients.of, Fibonacci, "/two") is not first
        other = await ros.call(clients.of, NestedMessage, "/one")
        assert other is not first
        assert await ros.call(clients.of, NestedMessage, "/one") is other
        assert await ros.call(clients.of, Fibonacci, "/one") is first
        for one in (first, other):  # whatever arrives for it, it is there
            assert not await ros.call(one.server_is_ready)


def _serving(domain: int, action: Any) -> tuple[Any, Any]:
    """Serve an action in a context of its own; return the server and its node."""
    import rclpy
    from rclpy.action.server import ActionServer
    from rclpy.context import Context

    context = Context()
    rclpy.init(context=context, domain_id=domain)
    node = rclpy.create_node("arm", context=context, enable_rosout=False)
    return ActionServer(node, action, "/one", lambda _goal: action.Result()), node


async def test_an_action_has_the_type_of_its_server_whatever_the_gateway_called_before() -> None:
    from test_msgs.action import Fibonacci, NestedMessage

    domain = fresh_domain()
    config = msgspec.convert({"domain_id": domain, "poll": 0.1}, Ros2Config)
    types: list[str | None] = []
    async with open_ros(config, Robot()) as ros, asyncio.timeout(BOUND):
        clients = ActionClients(ros)
        ros.on_close.append(clients.release)
        watch = GraphWatch(
            ros, lambda _: True, lambda graph: types.append(graph.actions.get("/one"))
        )
        await ros.call(watch.start)
        for action in (NestedMessage, Fibonacci, NestedMessage):
            server, node = await asyncio.to_thread(_serving, domain, action)
            try:
                client = await ros.call(clients.of, action, "/one")
                while not await ros.call(client.server_is_ready):  # noqa: ASYNC110
                    await asyncio.sleep(0.02)
                while types[-1:] != [f"test_msgs/action/{action.__name__}"]:  # noqa: ASYNC110
                    await asyncio.sleep(0.02)
            finally:
                server.destroy()
                node.destroy_node()
                node.context.try_shutdown()


class Served:
    """A server that says what becomes of it."""

    def __init__(self) -> None:
        self.told: list[str] = []
        self.over = threading.Event()

    def create(self, node: object) -> None:
        self.told.append("create")

    def destroy(self, node: object) -> None:
        self.told.append("destroy")
        self.over.set()


async def test_offers_whose_thread_is_stuck_do_not_hold_up_the_robot(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    config = msgspec.convert({"domain_id": fresh_domain()}, Ros2Config)
    host = Robot()
    async with open_ros(config, host) as ros, asyncio.timeout(BOUND):
        node = OfferNode(SimpleNamespace(ros=ros, host=host))  # type: ignore[arg-type]
        ros.on_close.append(node.close)
        stuck, free = asyncio.Event(), threading.Event()
        loop = asyncio.get_running_loop()
        try:
            first, late, never = Served(), Served(), Served()
            await node.add(first, lambda: None)
            node.run(lambda: (loop.call_soon_threadsafe(stuck.set), free.wait(BOUND)))
            await stuck.wait()
            adding = asyncio.ensure_future(node.add(late, lambda: None))
            await ros.call(lambda: None)  # by which a stop is sent
            ros.post(node.remove, first)
            await ros.call(lambda: None)
            assert (late.told, first.told) == ([], ["create"])
            monkeypatch.setattr("rcp_ros2.offer_servers._MAKE", 0.01)
            with pytest.raises(DeviceTimeout, match="did not create"):
                await node.add(never, lambda: None)
            ros.post(node.remove, never)
            await ros.call(lambda: None)
        finally:
            free.set()
        await adding
        for removed in (first, never):
            assert await asyncio.to_thread(removed.over.wait, BOUND)
            assert removed.told == ["create", "destroy"]  # what came late is not left over
        assert late.told == ["create"]
    assert late.told == ["create", "destroy"]
