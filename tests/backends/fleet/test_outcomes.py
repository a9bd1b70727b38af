"""What a hub tells of commands and stops whose outcome the robot's gateway knows better, or nobody."""

from __future__ import annotations

import asyncio
from contextlib import AsyncExitStack
from typing import Any

import pytest

pytest.importorskip("zenoh")

from backends.fleet.cart import Cart
from backends.fleet.rig import appears, hub_at, robot_at, serving
from configuration import backend, configuration, key, listener
from ports import free_port
from rcp_client import connect
from rcp_fleet.backend import FleetBackend
from rcp_fleet.gateway import followed
from rcp_gateway.testing import ADMIN, OPERATOR, Client, Served, eventually, scripted
from rcp_kernel.spi import Progress

pytestmark = pytest.mark.anyio
_BOUND = 60.0  # s, on any machine
_ADMIN = key("root", ADMIN, role="admin")
_GO = "/tenant/alpha/action/r1/go"
_ESTOP = "/system/estop"


async def _hub(stack: AsyncExitStack, port: int) -> tuple[FleetBackend, Client]:
    """Return the backend and a client of a hub that may do everything at its robots."""
    text = hub_at(port).replace(f'token = "{OPERATOR}"', f'token = "{ADMIN}"') + _ADMIN
    hub: Served = await stack.enter_async_context(serving(text))
    client = hub.client(ADMIN)
    stack.push_async_callback(client.close)
    fleet: Any = hub.supervisor.backend
    return fleet, client


async def _cart(stack: AsyncExitStack, port: int) -> tuple[Served, Cart]:
    text = robot_at(port, backend("cart"), "r1") + _ADMIN
    served = await stack.enter_async_context(serving(text, scripted(Cart)))
    cart: Any = served.life.backend
    return served, cart


async def test_what_failed_at_the_robot_is_not_rejected_at_the_hub() -> None:
    port = free_port()

    async def cut(_value: Any, _progress: Progress) -> None:
        raise ConnectionResetError("the bus is gone")  # the robot had the command by then

    async with AsyncExitStack() as stack:
        _, client = await _hub(stack, port)
        _, cart = await _cart(stack, port)
        await appears(client, _GO)
        cart.behaviours["action/go"] = cut
        reply = await client.request("execute", _GO, body=1.0, within=_BOUND)
        assert (reply["status"], reply["error"]["code"]) == ("failed", "adapter_unavailable"), reply
        assert not reply["error"]["retryable"]


async def test_a_stop_is_sent_although_the_one_before_it_is_unanswered() -> None:
    port = free_port()
    async with AsyncExitStack() as stack:
        _, client = await _hub(stack, port)
        served, cart = await _cart(stack, port)
        await appears(client, _GO)
        cart.obeys = False
        cart.moving.add("actuator/drive")
        first = await client.request("execute", _ESTOP, body={"scope": "fleet/r1"}, deadline=0.5)
        assert first["error"]["code"] == "device_timeout", first
        there = served.client(ADMIN)
        stack.push_async_callback(there.close)
        reset = await there.request("execute", _ESTOP, body={"reset": True})
        assert reset["status"] == "completed", reset

        async def free() -> bool:
            found = await client.request("read", _ESTOP)
            return not found["body"]["robots"]

        await eventually(free, "the hub has heard of the reset", _BOUND)
        cart.obeys = True
        second = await client.request("execute", _ESTOP, body={"scope": "fleet/r1"}, deadline=2.0)
        assert second["status"] == "completed", second
        assert not cart.moving


async def test_a_cancel_as_the_session_is_closed_does_not_hold_up_the_hub() -> None:
    web = free_port()
    text = (configuration(backend("cart")) + _ADMIN).replace(configuration(), listener(web), 1)
    async with AsyncExitStack() as stack:
        served = await stack.enter_async_context(serving(text, scripted(Cart)))
        cart: Any = served.life.backend
        client = connect(f"http://127.0.0.1:{web}", token=ADMIN)
        await client.channel.open()
        doing = asyncio.ensure_future(followed(client.start("/tenant/alpha/action/go", 1.0)))
        await asyncio.wait_for(cart.started.get(), _BOUND)
        await client.channel.close()
        doing.cancel()  # before the task has heard of it
        await asyncio.wait([doing], timeout=_BOUND)
        assert doing.cancelled()


async def test_a_stop_at_a_robot_that_comes_back_with_an_earlier_time_is_shown() -> None:
    """As of one without a clock of its own, which goes on where it was switched off."""
    port = free_port()
    async with AsyncExitStack() as stack:
        fleet, client = await _hub(stack, port)
        async with AsyncExitStack() as robot:
            await _cart(robot, port)
            await appears(client, _GO)
            fleet.gateways["r1"].stops._time += 3_600_000_000_000  # noqa: SLF001 - its clock was ahead
        served, _ = await _cart(stack, port)
        there = served.client(ADMIN)
        stack.push_async_callback(there.close)

        async def latched() -> bool:
            await there.request("execute", _ESTOP, body={})
            return bool((await client.request("read", _ESTOP))["body"]["robots"])

        await eventually(latched, "the hub shows the stop", _BOUND)
