"""A stop is confirmed by measurement, repeated until then, and kept in force while it is latched."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from datetime import datetime
from pathlib import Path

import pytest

from kernel.safety.scripted import (
    ADMIN,
    DRIVE,
    FAST,
    GO,
    Scripted,
    estop,
    scripted,
    scripted_world,
    shows,
    state_of,
    until_sent,
)
from kernel.world import BOUND, Client, World, kept_in, settled
from rcp_gateway.testing import SteppedClock
from rcp_kernel.clock import Clock
from rcp_kernel.spi import MotionState

pytestmark = pytest.mark.anyio
MOVING = MotionState(at_rest=False, detail="it moves at 2 m/s")
SHORT = 0.2  # s for an answer that can only be that it is not confirmed


@pytest.fixture
async def world(gateway_clock: Clock) -> AsyncGenerator[World]:
    async with scripted_world(clock=gateway_clock) as made:
        yield made


async def test_a_stop_is_completed_only_when_the_robot_is_measured_to_be_at_rest(
    world: World,
) -> None:
    robot, admin = scripted(world), world.client(ADMIN)
    robot.state = MOVING
    stop = admin.send(type="execute", path="/system/estop", body={"reason": "smoke"})
    told = await shows(world.client(ADMIN), lambda r: r["detail"] is not None)
    assert (told["state"], told["detail"], told["confirmed"]) == ("commanded", MOVING.detail, None)
    assert not [m for m in admin.inbox if m.get("id") == stop]
    robot.state = MotionState(at_rest=True)
    answer = await admin.final(stop)
    assert answer["status"] == "completed"
    state = answer["body"]["robots"]["r1"]
    assert (state["state"], state["detail"], state["alarm"]) == ("confirmed", None, False)
    times = [datetime.fromisoformat(state[s]) for s in ("requested", "commanded", "confirmed")]
    assert times == sorted(times)


async def test_a_robot_that_goes_on_is_named_and_the_stop_is_repeated(world: World) -> None:
    robot, admin = scripted(world), world.client(ADMIN)
    robot.state = MOVING
    answer = await estop(admin, deadline=SHORT)
    assert (answer["status"], answer["error"]["code"]) == ("failed", "device_timeout")
    assert "r1 (it moves at 2 m/s)" in answer["error"]["message"]
    assert answer["error"]["details"]["robots"]["r1"]["state"] == "commanded"
    halts = robot.halts
    await until_sent(robot, "halt", halts + 2)
    write = await admin.ask(type="write", path=DRIVE, body=FAST)
    assert write["error"]["code"] == "estop_active"


async def test_a_robot_that_cannot_be_reached_is_not_confirmed_until_it_can(world: World) -> None:
    robot, admin = scripted(world), world.client(ADMIN)
    robot.lost = "the link is cut"
    answer = await estop(admin, deadline=SHORT)
    assert answer["error"]["code"] == "device_timeout"
    assert answer["error"]["details"]["robots"]["r1"]["state"] == "requested"
    assert "the link is cut" in answer["error"]["message"]
    robot.lost = ""
    robot.host.link_restored()
    assert robot.sent == ["hold_stop"], "the stop is not what reached it first"
    assert (await shows(admin, lambda r: r["state"] == "confirmed"))["detail"] is None
    assert "halt" in robot.sent


async def test_a_link_that_is_down_gets_the_stop_from_within_the_call_that_restores_it(
    world: World,
) -> None:
    robot, admin = scripted(world), world.client(ADMIN)
    robot.lost = "the link is cut"
    robot.host.report("the link is cut", down=True)
    answer = await estop(admin, deadline=SHORT)
    assert answer["error"]["details"]["robots"]["r1"]["state"] == "requested"
    robot.lost = ""
    robot.host.link_restored()
    assert robot.sent == ["hold_stop"]
    robot.host.report(None)
    await shows(admin, lambda r: r["state"] == "confirmed")


async def test_a_confirmed_robot_whose_link_is_lost_is_confirmed_no_longer(world: World) -> None:
    robot, admin = scripted(world), world.client(ADMIN)
    assert (await estop(admin))["status"] == "completed"
    robot.lost = "the link is cut"
    state = await shows(admin, lambda r: r["state"] != "confirmed")
    assert (state["detail"], state["alarm"]) == ("the link is cut", False)
    robot.lost = ""
    await shows(admin, lambda r: r["state"] == "confirmed")


async def test_a_robot_that_moves_again_under_a_latch_is_stopped_again_with_an_alarm(
    world: World, tmp_path: Path
) -> None:
    robot, admin = scripted(world), world.client(ADMIN)
    audit = admin.send(type="subscribe", path="/system/audit", body={"initial": False})
    assert (await estop(admin))["status"] == "completed"
    halts = robot.halts
    robot.state = MOVING
    state = await shows(world.client(ADMIN), lambda r: r["alarm"])
    assert state["state"] == "commanded"
    await until_sent(robot, "halt", halts + 1)
    robot.state = MotionState(at_rest=True)
    state = await shows(world.client(ADMIN), lambda r: r["state"] == "confirmed")
    assert state["alarm"], "the alarm is over before anybody reset it"
    found: list[str] = []
    while found[-2:] != ["moves_again", "confirmed"]:
        record = (await admin.update(audit))["body"]
        if record["what"] == "stop":
            assert record["robot"] == "r1"
            found.append(record["outcome"])
    assert world.server.gateway.stops.alarms == 1
    assert (await estop(admin, reset=True))["status"] == "completed"


async def periods(client: Client, stepped: SteppedClock, seconds: float) -> None:
    """Let so long pass a few times, longer than what is repeated waits."""
    for _ in range(5):
        stepped.advance(seconds)
        await client.ask(type="ping")


async def test_a_latched_stop_is_asserted_again_and_again_and_no_longer_after_the_reset(
    world: World, stepped: SteppedClock
) -> None:
    robot, admin = scripted(world), world.client(ADMIN)
    await estop(admin)
    await until_sent(robot, "hold_stop", 5)
    await estop(admin, reset=True)
    robot.sent.clear()
    write = await admin.ask(type="write", path=DRIVE, body=FAST, valid_for=600)
    assert write["status"] == "completed"
    await periods(admin, stepped, 0.5)
    assert robot.sent == ["write 1"]


class OwnGateway(Scripted):
    """Has a gateway that asserts its stop itself."""

    has_gateways = True


@pytest.mark.parametrize(
    ("make", "least", "most"), [(Scripted, 25, 31), (OwnGateway, 2, 4)], ids=["here", "gateway"]
)
async def test_a_robot_whose_own_gateway_asserts_its_stop_is_reminded_once_a_second(
    gateway_clock: Clock, stepped: SteppedClock, make: type[Scripted], least: int, most: int
) -> None:
    async with scripted_world(make=make, clock=gateway_clock) as world:
        robot, admin = scripted(world), world.client(ADMIN)
        await estop(admin)
        robot.sent.clear()
        for _ in range(30):
            stepped.advance(0.1)
            await admin.ask(type="ping")
        assert least <= robot.sent.count("hold_stop") <= most


async def test_a_reset_ends_the_halts_of_a_robot_that_was_never_confirmed(
    world: World, stepped: SteppedClock
) -> None:
    robot, admin = scripted(world), world.client(ADMIN)
    robot.state = MOVING
    await estop(admin, deadline=SHORT)
    await estop(admin, reset=True)
    controller = world.server.gateway.stops
    (supervisor,) = world.server.supervisors
    assert controller.of(supervisor.whole) is None
    write = await admin.ask(type="write", path=DRIVE, body=FAST, valid_for=600)
    assert write["status"] == "completed"
    robot.sent.clear()
    await periods(admin, stepped, 2.0)
    assert robot.sent == []


async def test_a_robot_without_an_open_backend_is_not_confirmed(world: World) -> None:
    robot, admin = scripted(world), world.client(ADMIN)
    robot.host.report("switched off", down=True)
    answer = await estop(admin, deadline=SHORT)
    assert answer["error"]["code"] == "device_timeout"
    assert "switched off" in answer["error"]["message"]


async def test_a_backend_that_measures_nothing_is_confirmed_by_its_halt(world: World) -> None:
    robot, admin = scripted(world), world.client(ADMIN)
    robot.state = None
    assert (await estop(admin))["status"] == "completed"
    await until_sent(robot, "hold_stop", 2)
    assert (await state_of(admin))["state"] == "confirmed"


async def test_the_clean_up_of_a_cancelled_action_cannot_follow_the_halt(world: World) -> None:
    robot, admin = scripted(world), world.client(ADMIN)
    go = admin.send(type="execute", path=GO, body=1)
    async with asyncio.timeout(BOUND):
        await robot.started.get()
    assert (await estop(admin))["status"] == "completed"
    final = await admin.final(go)
    assert (final["status"], final["error"]["code"]) == ("cancelled", "cancelled")
    assert "emergency stop" in final["error"]["message"]
    await until_sent(robot, "halt", 2)  # once more after the action had ended
    assert "its own hold" not in robot.sent
    cancelled = admin.send(type="execute", path=GO, body=1)
    assert (await admin.final(cancelled))["error"]["code"] == "estop_active"


async def test_a_cancel_without_a_stop_is_not_fenced_off(world: World) -> None:
    robot, admin = scripted(world), world.client(ADMIN)
    go = admin.send(type="execute", path=GO, body=1)
    async with asyncio.timeout(BOUND):
        await robot.started.get()
    await admin.ask(type="cancel", path=GO)
    assert (await admin.final(go))["status"] == "cancelled"
    assert robot.sent[-1] == "its own hold"


async def test_a_dead_man_that_a_fenced_write_has_set_still_stops_its_robot(world: World) -> None:
    robot, admin = scripted(world), world.client(ADMIN)
    await estop(admin)
    await estop(admin, reset=True)
    robot.sent.clear()
    await admin.ask(type="write", path=DRIVE, body=FAST, valid_for=0.05)
    await until_sent(robot, "write 0")


@pytest.mark.parametrize("name", ["enable", "dock"])
async def test_under_a_latch_nothing_that_moves_or_energises_runs(world: World, name: str) -> None:
    robot, admin = scripted(world), world.client(ADMIN)
    path = f"/tenant/alpha/service/r1/{name}"
    await estop(admin)
    assert (await admin.ask(type="execute", path=path))["error"]["code"] == "estop_active"
    echo = await admin.ask(type="execute", path="/tenant/alpha/service/r1/echo", body="here")
    assert echo["status"] == "completed"
    assert f"execute service/{name}" not in robot.sent


async def test_a_latched_robot_is_stopped_when_the_gateway_starts_again(tmp_path: Path) -> None:
    store = tmp_path / "rcp.db"
    async with scripted_world(store=store) as world:
        await estop(world.client(ADMIN), reason="smoke")
        await settled(world.server.gateway.store)
    async with scripted_world(store=store) as world:
        robot, admin = scripted(world), world.client(ADMIN)
        await shows(admin, lambda r: r["state"] == "confirmed")
        assert robot.sent[0] == "hold_stop"
        assert (await state_of(admin))["reason"] == "smoke"
    assert kept_in(store)
