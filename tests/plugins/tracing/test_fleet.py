"""A trace passes a hub: the robot's gateway has it, below the hub's command."""

from __future__ import annotations

import pytest

pytest.importorskip("zenoh")

from backends.fleet.rig import appears, hub_at, robot_at, serving
from ports import free_port
from rcp_gateway.testing import OPERATOR
from rcp_protocol.trace import trace_of

TRACE = "4bf92f3577b34da6a3ce929d0e0e4736"
PATH = "/tenant/alpha/service/r7/clear_faults"


async def test_a_hub_passes_a_trace_on_to_the_robot() -> None:
    port = free_port()
    async with serving(hub_at(port)) as hub, serving(robot_at(port)) as robot:
        client, own = hub.client(OPERATOR), robot.client(OPERATOR)
        await appears(client, PATH)
        parent = f"00-{TRACE}-00f067aa0ba902b7-01"
        reply = await client.request("execute", path=PATH, **{"x-traceparent": parent})
        assert reply["status"] == "completed", reply
        assert reply["x-traceparent"] == parent
        listed = await own.request("read", path="/system/commands")
        await client.close()
        await own.close()
    (sent,) = [trace_of(one) for one in listed["body"] if "x-traceparent" in one]
    assert sent is not None
    assert sent.id == TRACE
