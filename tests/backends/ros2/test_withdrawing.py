"""Servers and clients of actions that are used no more, while something arrives for them."""

from __future__ import annotations

import asyncio
import os
import sys
from pathlib import Path

import msgspec
import pytest

from backends.ros2.robot import BOUND, Robot, fresh_domain
from rcp_ros2.action_clients import ActionClients
from rcp_ros2.config import Ros2Config
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
        assert await ros.call(clients.of, NestedMessage, "/one") is None  # the first has to go
        assert await ros.call(clients.of, NestedMessage, "/one") is not first
