"""A stop holds: against whoever moves it, by each means, until the reset."""

from __future__ import annotations

import asyncio

import pytest

from backends.mavlink.flying import agrees, airborne, on_the_ground, speed
from backends.mavlink.puppet import station
from backends.mavlink.relay import HEARTBEAT, SET_MODE, commander
from backends.mavlink.stopping import AT_REST, BRAKE, LAND, Stubborn, flying, until
from rcp_gateway.testing import eventually
from rcp_mavlink_sim.modes import Mode

SOON = 2  # heartbeats: one may be on its way


async def test_somebody_else_who_moves_it_under_the_latch_is_overruled_each_time() -> None:
    async with flying() as found, commander(found.twin.ports[0]) as other:
        await found.moving()
        assert (await found.estop())["status"] == "completed"
        for _ in range(3):
            told, shown = len(found.relay.commands(SET_MODE)), 0

            def count(number: int, told: int = told) -> bool:
                """Count what shows the gateway the other's mode before it has told it again."""
                nonlocal shown
                overruled = len(found.relay.commands(SET_MODE)) > told
                shown += number == HEARTBEAT and guided() and not overruled
                return True

            def guided() -> bool:
                return found.vehicle.flight.mode is Mode.GUIDED

            found.relay.down = count
            other.fly(3000.0, 40.0)  # it may be taken back before anybody looks
            await until(lambda n=told: len(found.relay.commands(SET_MODE)) > n, "it is told again")
            await until(lambda: found.vehicle.flight.mode is Mode.BRAKE, "it is taken back")
            await until(lambda: speed(found.vehicle) < AT_REST, "it is at rest again")
            # How far it came until the first of its heartbeats says so is the machine's affair.
            assert shown <= SOON, f"{shown} heartbeats showed GUIDED before it was told again"
        await found.confirmed()
        await found.stays()


async def test_somebody_else_who_arms_it_on_the_ground_under_the_latch_gets_it_disarmed() -> None:
    async with flying({"parameters": {"DISARM_DELAY": 0.0}}) as found, commander(found.twin.ports[0]) as other:  # fmt: skip
        on_the_ground(found.vehicle)
        await agrees(found.served.life.backend, found.vehicle)
        assert (await found.estop())["status"] == "completed"
        del found.relay.sent[:]
        other.arm()
        await until(lambda: found.vehicle.armed, "it is armed")
        await until(lambda: not found.vehicle.armed, "it is disarmed again", 4.0)
        assert not found.relay.commands(SET_MODE), "a mode would outlast the stop"


async def test_a_vehicle_at_rest_is_not_flooded() -> None:
    async with flying() as found:
        await found.moving()
        assert (await found.estop())["status"] == "completed"
        del found.relay.sent[:]
        await asyncio.sleep(3.0)  # a window in which hardly anything may be sent
        assert len(found.relay.sent) <= 8


async def test_a_stop_that_lands_lands_also_with_an_action_under_way() -> None:
    async with flying(estop="land") as found:
        id_ = await found.moving(12.0)
        stop = asyncio.ensure_future(found.estop(deadline=30.0))
        final = await found.client.final(id_)
        assert final["status"] in ("cancelled", "failed")
        await until(lambda: found.vehicle.flight.mode is Mode.LAND, "it lands")
        while not found.vehicle.body.landed:
            assert found.vehicle.flight.mode is Mode.LAND
            assert not stop.done(), "it is not at rest before it stands"
            await asyncio.sleep(0.02)
        reply = await stop
        assert reply["status"] == "completed", reply
        assert not found.vehicle.armed


async def test_the_hold_of_a_cancelled_action_never_follows_the_stop() -> None:
    async with flying(estop="land") as found:
        await found.moving(30.0)
        del found.relay.sent[:]
        await found.estop(deadline=1.0)
        modes = {m.param2 for m in found.relay.commands(SET_MODE)}
        assert modes == {LAND}


async def test_without_a_position_it_levels_and_then_lands() -> None:
    async with flying({"speed": 1.0}) as found:
        airborne(found.vehicle, 6.0)
        await agrees(found.served.life.backend, found.vehicle)
        found.vehicle.params.set("FS_EKF_ACTION", 0.0)  # no failsafe of its own
        found.vehicle.params.set("SIM_GPS1_ENABLE", 0.0)
        stop = asyncio.ensure_future(found.estop(deadline=40.0))
        await until(lambda: found.vehicle.flight.mode is Mode.ALT_HOLD, "it levels")
        refused = [m.param2 for m in found.relay.commands(SET_MODE)]
        assert refused[0] == BRAKE
        await until(lambda: found.vehicle.flight.mode is Mode.LAND, "it lands", 8.0)
        reply = await stop
        assert reply["status"] == "completed", reply
        assert found.vehicle.body.landed
        assert not found.vehicle.armed


async def test_a_forced_disarm_is_confirmed_by_the_heartbeat() -> None:
    async with flying(estop="disarm") as found:
        await found.moving(12.0)
        assert (await found.estop())["status"] == "completed"
        assert not found.vehicle.armed


async def test_a_reset_ends_a_landing_that_is_under_way() -> None:
    async with flying(estop="land") as found:
        await found.moving(60.0)
        await found.estop(deadline=0.5)
        await found.reset()
        reply = await found.client.request(
            "execute", "/tenant/t/action/set_mode", body={"mode": "GUIDED"}
        )
        assert reply["status"] == "completed", reply
        del found.relay.sent[:]
        await asyncio.sleep(1.0)  # a window in which nothing may be sent
        assert not found.relay.commands(SET_MODE)
        assert found.vehicle.flight.mode is Mode.GUIDED


async def test_a_failsafe_that_lands_it_under_the_latch_is_left_to() -> None:
    async with flying() as found:
        await found.moving(12.0)
        assert (await found.estop())["status"] == "completed"
        found.vehicle.failsafes.act("Battery", return_home=False)
        while not found.vehicle.body.landed:
            assert found.vehicle.flight.mode is Mode.LAND
            await asyncio.sleep(0.02)
        await until(lambda: not found.vehicle.armed, "it is disarmed on the ground")
        await found.confirmed()
        assert (await found.state())["alarm"]


async def test_what_is_refused_is_followed_by_the_next_step_in_the_configured_order() -> None:
    puppet = Stubborn(BRAKE, 5, 16, 2)
    async with station(puppet, estop_fallback=["land", "level"]) as found:
        await until(lambda: found.robot.vehicle.landed is False, "it is in the air")
        path = "/system/estop"
        reply = await found.client.request("execute", path, deadline=2.0)
        assert reply["status"] == "failed", reply
        assert puppet.mode == LAND
        told = list(dict.fromkeys(m.param2 for m in puppet.commands(SET_MODE)))
        assert told == [BRAKE, 5, 16, LAND], "ALT_HOLD comes after LAND here"
        state = await found.client.request("read", path)
        (robot,) = state["body"]["robots"].values()
        assert "BRAKE: refused (Mode change failed)" in robot["detail"]
        puppet.landed, puppet.velocity = 1, (0.0, 0.0, 0.0)

        async def confirmed() -> bool:
            state = await found.client.request("read", path)
            (robot,) = state["body"]["robots"].values()
            return robot["state"] == "confirmed"

        await eventually(confirmed, "it stands")


@pytest.mark.parametrize("terminate", [False, True])
async def test_the_flight_is_terminated_only_where_that_is_configured(terminate: bool) -> None:  # noqa: FBT001 - a parameter of the test
    puppet = Stubborn(BRAKE, 5, 16, 2, LAND)
    async with station(puppet, estop_terminate=terminate) as found:
        await until(lambda: found.robot.vehicle.landed is False, "it is in the air")
        reply = await found.client.request("execute", "/system/estop", deadline=4.0)
        assert bool(puppet.commands(185)) is terminate
        assert puppet.armed is not terminate
        assert reply["status"] == ("completed" if terminate else "failed"), reply


async def test_one_that_is_in_its_mode_and_still_moves_goes_on_to_land() -> None:
    puppet = Stubborn()
    async with station(puppet, estop_timeout=1.0) as found:
        await until(lambda: found.robot.vehicle.landed is False, "it is in the air")
        await found.client.request("execute", "/system/estop", deadline=3.0)
        await until(lambda: puppet.mode == LAND, "it lands")
        assert 2 not in [m.param2 for m in puppet.commands(SET_MODE)], "level would only drift"


async def test_a_hold_brings_it_to_rest_and_latches_nothing() -> None:
    async with flying(estop="land") as found:
        id_ = await found.moving()
        reply = await found.client.request("execute", "/tenant/t/service/hold", within=60.0)
        assert reply["status"] == "completed", reply
        assert speed(found.vehicle) < AT_REST
        assert found.vehicle.flight.mode is Mode.BRAKE
        assert (await found.client.final(id_))["status"] == "cancelled"
        await found.moving()
