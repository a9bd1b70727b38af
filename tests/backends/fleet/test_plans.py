"""Plans of a hub whose steps span robots: each step is its own robot's, and done once."""

from __future__ import annotations

from collections.abc import AsyncGenerator
from contextlib import AsyncExitStack, asynccontextmanager
from typing import Any

import pytest

pytest.importorskip("zenoh")

from backends.fleet.cart import Cart
from backends.fleet.rig import appears, hub_at, robot_at, serving
from configuration import backend
from ports import free_port
from rcp_gateway.testing import OPERATOR, Client, eventually, scripted
from transports.cable import Cable

pytestmark = pytest.mark.anyio
_BOUND = 60.0  # s, on any machine
_NAMES = ("r1", "r2")


class _Pair:
    """A hub with two robots, the second behind a cable."""

    def __init__(self, client: Client, carts: dict[str, Cart], cable: Cable) -> None:
        self.client, self.carts, self.cable = client, carts, cable

    async def start(self, *steps: dict[str, Any]) -> str:
        """Send a plan; return its id."""
        envelope = {"type": "execute", "path": "/system/plans", "body": {"steps": list(steps)}}
        return await self.client.send(envelope)

    async def runs(self, *names: str) -> None:
        """Wait until these robots execute something."""

        async def running() -> bool:
            return all(self.carts[name].ran for name in names)

        await eventually(running, f"{names} go", _BOUND)


@asynccontextmanager
async def _pair() -> AsyncGenerator[_Pair]:
    port = free_port()
    async with AsyncExitStack() as stack:
        enter = stack.enter_async_context
        hub = await enter(serving(hub_at(port)))
        cable = await enter(Cable(port).laid())
        carts: dict[str, Any] = {}
        for name, end in zip(_NAMES, (port, cable.port), strict=True):
            text = robot_at(end, backend("cart"), gateway=name)
            served = await enter(serving(text, scripted(Cart)))
            carts[name] = served.life.backend
        client = hub.client(OPERATOR)
        stack.push_async_callback(client.close)
        for name in _NAMES:
            await appears(client, f"/tenant/alpha/action/{name}/go")
        yield _Pair(client, carts, cable)


def _go(robot: str, metres: float, action: str = "go") -> dict[str, Any]:
    path = f"/tenant/alpha/action/{robot}/{action}"
    return {"id": f"{robot}-{metres:g}", "do": "execute", "path": path, "value": metres}


def _together(*steps: dict[str, Any]) -> dict[str, Any]:
    return {"do": "parallel", "steps": list(steps)}


async def test_a_plan_commands_two_robots_at_once_and_then_one_of_them() -> None:
    async with _pair() as pair:
        id_ = await pair.start(_together(_go("r1", 1.0), _go("r2", 2.0)), _go("r1", 3.0, "line"))
        await pair.runs("r1", "r2")
        for cart in pair.carts.values():
            cart.release.set()
        done = await pair.client.final(id_, _BOUND)
        assert done["status"] == "completed", done
        assert [value for _, value in pair.carts["r1"].ran] == [1.0, 3.0]
        assert [value for _, value in pair.carts["r2"].ran] == [2.0]


async def test_a_stop_of_one_robot_ends_the_plan_at_both() -> None:
    async with _pair() as pair:
        id_ = await pair.start(_together(_go("r1", 1.0), _go("r2", 2.0)))
        await pair.runs("r1", "r2")
        stop = {"type": "execute", "path": "/system/estop", "body": {"scope": "/tenant/alpha/r2"}}
        await pair.client.send(stop)
        done = await pair.client.final(id_, _BOUND)
        assert done["status"] == "cancelled", done
        states = {one["step"]: one["state"] for one in done["body"]["steps"]}
        assert (states["r1-1"], states["r2-2"]) == ("cancelled", "cancelled"), states
        assert not any(cart.moving for cart in pair.carts.values())


async def test_a_plan_outlives_a_cut_to_one_of_its_robots_and_does_nothing_twice() -> None:
    async with _pair() as pair:
        id_ = await pair.start(_together(_go("r1", 1.0), _go("r2", 2.0)), _go("r2", 3.0, "line"))
        await pair.runs("r1", "r2")
        pair.cable.cut()
        for cart in pair.carts.values():
            cart.release.set()
        done = await pair.client.final(id_, _BOUND)
        assert done["status"] == "completed", done
        assert [value for _, value in pair.carts["r1"].ran] == [1.0]
        assert [value for _, value in pair.carts["r2"].ran] == [2.0, 3.0]
