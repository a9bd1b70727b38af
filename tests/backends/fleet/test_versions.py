"""A hub and a robot's gateway of different versions: each does without what the other lacks."""

from __future__ import annotations

from typing import Any

import pytest

pytest.importorskip("zenoh")

from backends.fleet.rig import SIM, appears, free_port, hub_at, robot_at, serving
from configuration import configuration, key, role, rule, table
from rcp_kernel.testing import ADMIN, OPERATOR, Client, eventually

pytestmark = pytest.mark.anyio
_POSE, _LINK = "/tenant/alpha/sensor/r7/pose", "/tenant/alpha/sensor/r7/link"
_MOVE = "/tenant/alpha/action/r7/move_to"
_BOUND = 60.0  # s, on any machine


def _early(port: int) -> str:
    """Return the configuration of a gateway that has, for its hub, only what the first ones had."""
    zenoh = table(
        "transports.zenoh", gateway="r7", tenant="alpha", connect=[f"tcp/127.0.0.1:{port}"]
    )
    own = rule("execute read subscribe", "/system/estop")
    early = role("early", rule("read write execute subscribe", "/tenant/**"), own, reset=True)
    return configuration(zenoh, SIM, early, key("hub", OPERATOR, role="early"))


async def _lacks(client: Client, *paths: str) -> None:
    found: list[Any] = []

    async def told() -> bool:
        link = (await client.request("read", _LINK))["body"]
        found[:] = [link["state"], link.get("lacks", [])]
        return found == ["ready", list(paths)]

    await eventually(told, f"the link lacks {paths}", _BOUND)


async def test_a_gateway_without_what_later_ones_offer_is_used_and_what_it_lacks_is_named() -> None:
    port = free_port()
    async with serving(hub_at(port) + key("root", ADMIN, role="admin")) as hub:
        client = hub.client(ADMIN)
        async with serving(_early(port)):
            await appears(client, _POSE)
            await _lacks(client, "/system/robots", "/system/status", "/system/tree")
            assert (await client.request("read", _POSE, body={"fresh": True}))["body"]
            goal = {"position": {"x": 0.1, "y": 0.0}}
            assert (await client.request("execute", _MOVE, body=goal))["status"] == "completed"
            id_ = await client.subscribe(_POSE)
            assert (await client.update(id_))["path"] == _POSE
            stopped = await client.request("execute", "/system/estop", body={}, within=_BOUND)
            assert stopped["status"] == "completed"
            freed = await client.request("execute", "/system/estop", body={"reset": True})
            assert freed["status"] == "completed"
        async with serving(robot_at(port)):  # it is replaced by one that has them
            await _lacks(client)
            shown = (await client.request("read", "/system/robots"))["body"]
            assert [one["path"] for one in shown] == ["/tenant/alpha/r7"]
        await client.close()
