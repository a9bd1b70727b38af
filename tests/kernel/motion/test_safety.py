"""Whatever happens to the client or the link, what moves comes to rest."""

from __future__ import annotations

import time

import pytest

from kernel.world import BOUND, Client, World
from rcp_gateway.testing import SteppedClock
from rcp_kernel.types import LinearVelocity, Twist

pytestmark = pytest.mark.anyio
DRIVE = "/tenant/alpha/actuator/drive"
FORWARD = Twist(LinearVelocity(1.0))


async def drive(client: Client, **fields: object) -> dict[str, object]:
    return await client.ask(type="write", path=DRIVE, body={"linear": {"x": 1.0}}, **fields)


async def at_rest(world: World, client: Client) -> None:
    """Wait until the gateway has published the safe value as the one in force."""
    id_ = client.send(type="subscribe", path=DRIVE)
    await client.until(
        lambda m: m["type"] == "update" and m["id"] == id_ and m["body"]["linear"]["x"] == 0
    )


async def test_a_velocity_that_nobody_renews_lapses_to_the_safe_value(world: World) -> None:
    client = world.client()
    await drive(client)
    started = time.monotonic()
    await at_rest(world, client)
    assert time.monotonic() - started < BOUND
    assert world.robot.writes == [("actuator/drive", FORWARD), ("actuator/drive", Twist())]


async def test_the_safe_value_is_repeated_until_the_device_takes_it(world: World) -> None:
    client = world.client()
    await drive(client, valid_for=0.02)
    world.robot.fail_writes = 3
    await at_rest(world, client)
    assert world.robot.fail_writes == 0


async def test_a_robot_whose_link_is_down_is_stopped_when_it_is_back(world: World) -> None:
    client = world.client()
    await drive(client, valid_for=0.05)
    world.robot.host.report("out of range", down=True)
    gone = await client.ask(type="read", path="/sensor/level")
    assert gone["error"]["code"] == "adapter_unavailable"
    await client.ask(type="subscribe", path=DRIVE)
    while world.server.gateway.deadman.expired == 0:
        await client.ask(type="ping")
    assert world.robot.writes == [("actuator/drive", FORWARD)]
    world.robot.host.report(None)
    await at_rest(world, client)
    assert world.robot.writes[-1] == ("actuator/drive", Twist())


async def test_a_renewed_velocity_stands(world: World) -> None:
    client = world.client()
    for _ in range(5):
        await drive(client)
    await at_rest(world, client)
    assert [value for _, value in world.robot.writes] == [FORWARD] * 5 + [Twist()]


async def test_a_command_from_the_past_is_refused(world: World, stepped: SteppedClock) -> None:
    sent = time.time()
    stepped.advance(2)
    old = await drive(world.client(), timestamp=sent)
    assert old["error"]["code"] == "stale_command"
    assert world.robot.writes == []
    assert (await drive(world.client(), timestamp=stepped.now() / 1e9))["status"] == "completed"


async def test_valid_for_needs_a_path_with_a_safe_value(world: World) -> None:
    reply = await world.client().ask(type="write", path="/param/limit", body=1.0, valid_for=1.0)
    assert reply["error"]["code"] == "bad_request"


async def test_an_estop_halts_latches_and_only_an_admin_resets_it(world: World) -> None:
    watcher, operator, admin = world.client(None), world.client(), world.client("admin-admin-admin")
    id_ = operator.send(type="execute", path="/action/go", body=1)
    await world.robot.started.get()
    world.robot.fail_halts = 2
    stopped = await watcher.ask(type="execute", path="/system/estop", body={"reason": "smoke"})
    assert stopped["body"]["active"] is True
    assert world.robot.halts == 3
    assert (await operator.final(id_))["status"] == "cancelled"
    refused = await drive(operator)
    assert refused["error"]["code"] == "estop_active"
    assert "smoke" in str(refused["message"])
    again = await operator.ask(type="execute", path="/action/go", body=1)
    assert again["error"]["code"] == "estop_active"
    reset = {"type": "execute", "path": "/system/estop", "body": {"reset": True}}
    assert (await operator.ask(**reset))["error"]["code"] == "forbidden"
    assert (await admin.ask(**reset))["body"]["active"] is False
    assert world.robot.writes == []
    assert (await drive(operator))["status"] == "completed"


async def test_an_estop_is_past_the_limit_on_requests_in_flight(world: World) -> None:
    client = world.client()
    client.connection.session.inflight.update({f"x{i}": None for i in range(5000)})
    assert (await client.ask(type="execute", path="/action/go", body=1))["error"][
        "code"
    ] == "queue_full"
    assert (await client.ask(type="execute", path="/system/estop"))["status"] == "completed"


async def test_closing_the_gateway_halts_the_robot_first() -> None:
    from kernel.world import world_of

    async with world_of() as world:
        robot = world.robot
    assert robot.halts >= 1
