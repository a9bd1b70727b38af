"""Stops across the link: of many robots, of those that are away, frozen, or stopped by others too."""

from __future__ import annotations

import asyncio
import os
import signal
import sys
from contextlib import AsyncExitStack, suppress
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("zenoh")

from backends.fleet.cart import Cart
from backends.fleet.rig import SIM, appears, hub_at, process_of, robot_at, serving
from configuration import backend, configuration, key, listener, table
from ports import free_port
from rcp_client import ConnectionLost, connect
from rcp_gateway.testing import ADMIN, OPERATOR, Client, Served, eventually, scripted
from transports.cable import Cable

pytestmark = pytest.mark.anyio
_BOUND = 60.0  # s, on any machine
_ADMIN = key("root", ADMIN, role="admin")
_ROBOT = backend("cart")
_FAR = {"position": {"x": 5.0, "y": 0.0}}


def _hub(port: int, name: str = "h1") -> str:
    """Return a hub that may do everything at its robots."""
    text = hub_at(port, name, router=name == "h1")
    return text.replace(f'token = "{OPERATOR}"', f'token = "{ADMIN}"') + _ADMIN


async def _estop(client: Client, **body: Any) -> dict[str, Any]:
    fields = {"deadline": 1.0} if body.pop("soon", False) else {"deadline": _BOUND}
    return await client.request("execute", "/system/estop", body=body, within=_BOUND, **fields)


async def _state(client: Client) -> dict[str, str]:
    """Return how far each latched robot's stop is."""
    told = (await client.request("read", "/system/estop"))["body"]["robots"]
    return {name: one["state"] for name, one in told.items()}


async def _confirmed(client: Client, *names: str) -> None:
    async def confirmed() -> bool:
        found = await _state(client)
        return all(found.get(name) == "confirmed" for name in names)

    await eventually(confirmed, f"{names} are confirmed at rest", _BOUND)


async def _carts(stack: AsyncExitStack, port: int, *names: str) -> dict[str, Cart]:
    """Run a gateway for each of some robots."""
    made: dict[str, Cart] = {}
    for name in names:
        text = robot_at(port, _ROBOT, name) + _ADMIN
        served = await stack.enter_async_context(serving(text, scripted(Cart)))
        cart: Any = served.life.backend
        made[name] = cart
    return made


async def _client(stack: AsyncExitStack, hub: Served, *names: str) -> Client:
    client = hub.client(ADMIN)
    stack.push_async_callback(client.close)
    for name in names:
        await appears(client, f"/tenant/alpha/actuator/{name}/drive")
    return client


async def test_a_stop_of_one_robot_or_tenant_stops_no_other() -> None:
    port = free_port()
    async with AsyncExitStack() as stack:
        other = backend("others", tenant="beta", use="fleet", hub="h1b", token=ADMIN)
        other += f'connect = ["tcp/127.0.0.1:{port}"]\n'
        hub = await stack.enter_async_context(serving(_hub(port) + other))
        carts = await _carts(stack, port, "r1", "r2")
        beta = robot_at(port, backend("cart", tenant="beta"), "b1") + _ADMIN
        beta = beta.replace('tenant = "alpha"', 'tenant = "beta"')
        served = await stack.enter_async_context(serving(beta, scripted(Cart)))
        far: Any = served.life.backend
        client = await _client(stack, hub, "r1", "r2")
        await appears(client, "/tenant/beta/actuator/b1/drive")
        assert (await _estop(client, scope="fleet/r1"))["status"] == "completed"
        assert [cart.halts > 0 for cart in (*carts.values(), far)] == [True, False, False]
        assert (await _estop(client, scope="/tenant/alpha"))["status"] == "completed"
        assert [cart.halts > 0 for cart in (*carts.values(), far)] == [True, True, False]
        written = await client.request("write", "/tenant/beta/actuator/b1/drive", body=0.1)
        assert written["status"] == "completed", written


async def test_of_fifty_robots_three_that_are_away_are_named_and_stopped_on_return() -> None:
    port, names = free_port(), [f"r{number}" for number in range(50)]
    away = names[:3]
    async with AsyncExitStack() as stack:
        hub = await stack.enter_async_context(serving(_hub(port)))
        cable = await stack.enter_async_context(Cable(port).laid())
        carts = await _carts(stack, cable.port, *away)
        carts |= await _carts(stack, port, *names[3:])
        client = await _client(stack, hub, *names)
        for cart in carts.values():
            cart.moving.add("actuator/drive")
        cable.part()
        unit = hub.supervisor.unit

        async def lost() -> bool:
            return all(unit(name).state == "down" for name in away)

        await eventually(lost, "three are away", _BOUND)
        reply = await client.request(
            "execute", "/system/estop", body={}, deadline=20.0, within=_BOUND
        )
        assert reply["error"]["code"] == "device_timeout", reply
        assert set(reply["error"]["details"]["robots"]) == {f"fleet/{name}" for name in away}
        states = await _state(client)
        late = {name for name, state in states.items() if state != "confirmed"}
        assert late == {f"fleet/{name}" for name in away}
        assert {name for name, cart in carts.items() if cart.moving} == set(away)
        cable.mend()
        await _confirmed(client, *(f"fleet/{name}" for name in names))
        assert not any(cart.moving for cart in carts.values())


async def test_a_robot_that_returns_is_stopped_before_its_command_goes_on() -> None:
    port = free_port()
    async with AsyncExitStack() as stack:
        hub = await stack.enter_async_context(serving(_hub(port)))
        cable = await stack.enter_async_context(Cable(port).laid())
        cart = (await _carts(stack, cable.port, "r7"))["r7"]
        client = await _client(stack, hub, "r7")
        path = "/tenant/alpha/action/r7/go"
        id_ = await client.send(type="execute", path=path, body=1.0)
        await cart.started.get()
        cable.part()

        async def lost() -> bool:
            return hub.supervisor.unit("r7").state == "down"

        await eventually(lost, "it is away", _BOUND)
        assert cart.moving  # an action goes on without the link, as the robot has it
        reply = await _estop(client, soon=True)
        assert reply["error"]["code"] == "device_timeout", reply
        final = await client.final(id_, _BOUND)
        assert final["status"] != "completed", final
        cable.mend()
        await _confirmed(client, "fleet/r7")
        assert not cart.moving
        refused = await client.request("execute", path, body=1.0)
        assert refused["error"]["code"] == "estop_active", refused
        assert len(cart.ran) == 1


async def test_a_reset_at_a_robot_that_is_away_does_not_undo_a_later_stop_of_the_hub() -> None:
    port = free_port()
    async with AsyncExitStack() as stack:
        hub = await stack.enter_async_context(serving(_hub(port)))
        cable = await stack.enter_async_context(Cable(port).laid())
        text = robot_at(cable.port, _ROBOT) + _ADMIN
        served = await stack.enter_async_context(serving(text, scripted(Cart)))
        cart: Any = served.life.backend
        client = await _client(stack, hub, "r7")
        local = served.client(ADMIN)
        stack.push_async_callback(local.close)
        assert (await _estop(local))["status"] == "completed"
        await _confirmed(client, "fleet/r7")
        cable.part()
        unit = hub.supervisor.unit("r7")

        async def lost() -> bool:
            return unit.state == "down"

        await eventually(lost, "it is away", _BOUND)
        assert (await _estop(local, reset=True))["status"] == "completed"
        await local.send(type="execute", path="/tenant/alpha/action/go", body=1.0)
        await cart.started.get()
        reply = await _estop(client, soon=True)
        assert reply["error"]["code"] == "device_timeout", reply
        cable.mend()
        await _confirmed(client, "fleet/r7")
        assert unit.latch is not None
        assert unit.latch.shown is None  # it is the hub's own
        assert not cart.moving
        assert await _state(local) == {"cart": "confirmed"}
        assert (await _estop(local, reset=True))["status"] == "completed"  # and a later one does

        async def released() -> bool:
            return unit.latch is None

        await eventually(released, "the hub has learnt of the reset", _BOUND)


async def test_a_cancel_reaches_a_robot_that_was_away_and_is_not_told_before() -> None:
    port = free_port()
    async with AsyncExitStack() as stack:
        hub = await stack.enter_async_context(serving(_hub(port)))
        cable = await stack.enter_async_context(Cable(port).laid())
        cart = (await _carts(stack, cable.port, "r7"))["r7"]
        client = await _client(stack, hub, "r7")
        path = "/tenant/alpha/action/r7/go"
        id_ = await client.send(type="execute", path=path, body=1.0)
        await cart.started.get()
        cable.part()

        async def lost() -> bool:
            return hub.supervisor.unit("r7").state == "down"

        await eventually(lost, "it is away", _BOUND)
        await client.request("cancel", path)
        final = await client.final(id_, _BOUND)
        assert final["error"]["code"] == "deadline_exceeded", final
        assert "may still be moving" in final["error"]["remedy"]
        assert cart.stopped.empty()
        cable.mend()
        assert await asyncio.wait_for(cart.stopped.get(), _BOUND) == "action/go"


async def test_a_cut_link_lets_a_velocity_lapse_and_ends_what_is_tied_to_its_client() -> None:
    port = free_port()
    async with AsyncExitStack() as stack:
        hub = await stack.enter_async_context(serving(_hub(port)))
        cable = await stack.enter_async_context(Cable(port).laid())
        cart = (await _carts(stack, cable.port, "r7"))["r7"]
        client = await _client(stack, hub, "r7")
        go = await client.send(type="execute", path="/tenant/alpha/action/r7/go", body=1.0)
        tied = await client.send(type="execute", path="/tenant/alpha/action/r7/tied", body=2.0)
        for _ in range(2):
            await cart.started.get()
        written = await client.request("write", "/tenant/alpha/actuator/r7/drive", body=0.5)
        assert written["status"] == "completed", written
        cable.part()
        assert await asyncio.wait_for(cart.stopped.get(), _BOUND) == "action/tied"

        async def lapsed() -> bool:
            return cart.writes[-1] == ("actuator/drive", 0.0)

        await eventually(lapsed, "the robot's dead-man has acted", _BOUND)
        assert cart.moving == {"action/go"}
        cable.mend()
        cart.release.set()
        assert (await client.final(go, _BOUND))["status"] == "completed"
        assert (await client.final(tied, _BOUND))["status"] == "cancelled"
        assert [name for name, _ in cart.ran] == ["action/go", "action/tied"]


async def test_a_robot_that_refuses_the_reset_stays_latched_here_too() -> None:
    port = free_port()
    async with AsyncExitStack() as stack:
        hub = await stack.enter_async_context(serving(hub_at(port) + _ADMIN))
        served = await stack.enter_async_context(serving(robot_at(port, _ROBOT), scripted(Cart)))
        client = await _client(stack, hub, "r7")
        assert (await _estop(client, reason="smoke"))["status"] == "completed"
        refused = await _estop(client, reset=True)  # an operator at the robot, who may not
        assert refused["error"]["code"] == "device_rejected", refused
        assert "may not reset" in refused["error"]["message"]
        await _confirmed(client, "fleet/r7")
        local = served.client(OPERATOR)
        assert await _state(local) == {"cart": "confirmed"}
        await local.close()


async def test_a_hub_that_was_closed_takes_up_its_command_and_nothing_is_done_twice(
    tmp_path: Path,
) -> None:
    port = free_port()
    text = _hub(port) + table("store", path=str(tmp_path / "hub.db"))
    async with AsyncExitStack() as stack:
        first = AsyncExitStack()
        await stack.enter_async_context(first)
        hub = await first.enter_async_context(serving(text))
        cart = (await _carts(stack, port, "r7"))["r7"]
        client = await _client(first, hub, "r7")
        id_ = await client.send(type="execute", path="/tenant/alpha/action/r7/go", body=1.0)
        await cart.started.get()
        accepted = await client.until(lambda m: m.get("id") == id_ and "command" in m)
        await first.aclose()
        assert (cart.halts, cart.stopped.empty()) == (0, True)
        assert cart.moving == {"action/go"}
        hub = await stack.enter_async_context(serving(text))
        client = await _client(stack, hub, "r7")
        cart.release.set()

        async def completed() -> bool:
            (found,) = (await client.request("read", "/system/commands"))["body"]
            assert found["command"] == accepted["command"]
            return found["status"] == "completed" and found["body"] == 1.0

        await eventually(completed, "the hub has the robot's final reply", _BOUND)
        assert cart.ran == [("action/go", 1.0)]


async def test_a_hub_that_was_killed_takes_up_its_command_too(tmp_path: Path) -> None:
    port, web = free_port(), free_port()
    kept = table("store", path=str(tmp_path / "hub.db"))
    text = _hub(port)
    serving_web = text.replace(configuration(), listener(web), 1)
    async with AsyncExitStack() as stack:
        cart = (await _carts(stack, port, "r7"))["r7"]
        async with process_of(tmp_path / "hub.toml", serving_web + kept) as process:
            path = "/tenant/alpha/action/r7/go"
            person = connect(f"http://127.0.0.1:{web}", token=ADMIN, patience=0)
            while not person.connected:
                with suppress(ConnectionLost):
                    await person.channel.open()
                await asyncio.sleep(0.05)
            while not await person.discover(path):  # noqa: ASYNC110 - of another process
                await asyncio.sleep(0.05)
            sent = asyncio.create_task(person.execute(path, 1.0))
            await asyncio.wait_for(cart.started.get(), _BOUND)
            process.kill()
            with pytest.raises(ConnectionLost):
                await sent
            await person.channel.close()
        hub = await stack.enter_async_context(serving(text + kept))
        client = await _client(stack, hub, "r7")
        assert (cart.halts, cart.stopped.empty(), cart.moving) == (0, True, {"action/go"})
        cart.release.set()

        async def completed() -> bool:
            (found,) = (await client.request("read", "/system/commands"))["body"]
            return found["status"] == "completed" and found["body"] == 1.0

        await eventually(completed, "the hub has the robot's final reply", _BOUND)
        assert cart.ran == [("action/go", 1.0)]


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGSTOP")
async def test_a_frozen_robot_is_named_and_stopped_when_it_goes_on(tmp_path: Path) -> None:
    port = free_port()
    async with AsyncExitStack() as stack:
        hub = await stack.enter_async_context(serving(_hub(port)))
        await _carts(stack, port, "r1")
        robot = robot_at(port, SIM) + _ADMIN
        process = await stack.enter_async_context(process_of(tmp_path / "r7.toml", robot))
        client = await _client(stack, hub, "r1")
        path = "/tenant/alpha/action/r7/move_to"
        await appears(client, path)
        await client.send(type="execute", path=path, body=_FAR)
        os.kill(process.pid, signal.SIGSTOP)
        reply = await _estop(client, soon=True)
        assert reply["error"]["code"] == "device_timeout", reply
        assert set(reply["error"]["details"]["robots"]) == {"fleet/r7"}
        assert (await _state(client))["fleet/r1"] == "confirmed"
        os.kill(process.pid, signal.SIGCONT)
        await _confirmed(client, "fleet/r1", "fleet/r7")
