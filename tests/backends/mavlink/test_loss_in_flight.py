"""What becomes of a flight when the robot, its position or its command is lost."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from backends.mavlink.flying import agrees, airborne, speed, twin
from backends.mavlink.relay import relay
from backends.mavlink.stopping import AT_REST, KIND, flying, until
from rcp_gateway.testing._serve import serve_backend
from rcp_kernel.errors import AdapterUnavailable
from rcp_kernel.tree.lost_command import BEFORE
from rcp_mavlink_sim.modes import Mode


@pytest.mark.parametrize(
    ("policy", "mode"),
    [("hold", Mode.BRAKE), ("continue", Mode.GUIDED), ("land", Mode.LAND), ("return", Mode.RTL)],
)
async def test_what_becomes_of_it_after_a_loss_is_its_policy(policy: str, mode: Mode) -> None:
    async with flying(on_loss=policy) as found:
        id_ = await found.moving()
        found.relay.cut = True
        final = await found.client.final(id_)
        assert final["error"]["details"]["on_loss"] == policy
        await until(lambda: found.robot.vehicle.lost, "it is lost")
        found.relay.cut = False
        await until(lambda: not found.robot.vehicle.lost, "it is heard again")
        if policy == "continue":
            await asyncio.sleep(1.0)
        await until(lambda: found.vehicle.flight.mode is mode, "it does what the policy says")


async def test_positions_that_stop_coming_end_a_flight_and_refuse_the_next() -> None:
    async with flying() as found:
        id_ = await found.moving()
        found.relay.down = lambda number: number != 33
        final = await found.client.final(id_)
        assert final["error"]["code"] == "device_timeout", final
        assert "no position" in final["message"]
        await until(lambda: speed(found.vehicle) < AT_REST, "it was told to hold")
        assert found.vehicle.flight.mode is Mode.BRAKE
        body = {"north": 0.0}
        again = await found.client.request("execute", "/tenant/t/action/move_to", body=body)
        assert again["error"]["code"] == "precondition_failed", again
        found.relay.down = lambda _: True
        await until(lambda: not found.robot.measurement.stale(), "positions come again")
        await found.moving()


async def test_a_velocity_is_not_sent_on_without_positions() -> None:
    async with flying() as found:
        airborne(found.vehicle, 40.0)
        await agrees(found.served.life.backend, found.vehicle)
        path = "/tenant/t/actuator/velocity"
        replies = []

        async def lead() -> None:
            while True:
                replies.append(await found.client.request("write", path, body={"x": 5.0}))
                await asyncio.sleep(0.2)

        leading = asyncio.ensure_future(lead())
        try:
            await until(lambda: speed(found.vehicle) > 3, "it is led")
            found.relay.down = lambda number: number != 33
            await until(lambda: speed(found.vehicle) < AT_REST, "it is stopped", 6.0)
            await until(lambda: replies[-1]["status"] != "completed", "the next one is refused")
            assert replies[-1]["error"]["code"] in ("precondition_failed", "mode_forbids")
        finally:
            leading.cancel()


async def test_a_vehicle_that_is_lost_does_not_keep_the_others_from_being_halted() -> None:
    async with (
        twin(speed=2.0) as first,
        twin(speed=2.0, system=2) as second,
        relay(second.ports[0]) as link,
    ):
        for running in (first, second):
            airborne(running.vehicle, 40.0)
            running.vehicle.flight.aim((3000.0, 0.0), -40.0)
        links = [f"udpout:127.0.0.1:{port}" for port in (first.ports[0][1], link.port)]
        table = {"links": links, "discover": True, "params": [], "silence": 1.5}
        async with serve_backend(KIND, table) as served:
            await until(lambda: served.lives and len(served.life.backend.robots) == 2, "both")
            backend: Any = served.life.backend
            link.cut = True
            await until(lambda: backend.robots["vehicle2"].vehicle.lost, "one is lost")
            with pytest.raises(AdapterUnavailable, match="vehicle 2") as told:
                await backend.halt()
            assert "vehicle 1" not in str(told.value)
            assert speed(first.vehicle) < AT_REST
            assert backend.motion("vehicle1").at_rest is True
            assert backend.motion("vehicle2").at_rest is None
            assert backend.motion(None).at_rest is None
            with pytest.raises(AdapterUnavailable):
                await backend.halt_robot("vehicle2")
            with pytest.raises(AdapterUnavailable):
                await backend.halt_robot("vehicle3")


async def test_a_cancel_that_does_not_reach_it_is_not_told_as_cancelled() -> None:
    async with flying() as found:
        id_ = await found.moving()
        found.relay.cut = True
        await found.client.request("cancel", "/tenant/t/action/move_to")
        final = await found.client.final(id_)
        assert final["status"] == "failed", final
        assert final["error"]["code"] in ("adapter_unavailable", "device_timeout")
        assert final["error"]["details"]["on_loss"] == "hold"
        await until(lambda: found.robot.vehicle.lost, "it is lost")
        found.relay.cut = False
        await until(lambda: speed(found.vehicle) < AT_REST, "it holds when it is heard again")


async def test_one_that_appears_after_the_start_gets_what_its_lost_command_left_behind() -> None:
    async with (
        twin(speed=2.0) as first,
        twin(speed=2.0, system=2) as second,
        relay(second.ports[0]) as link,
    ):
        airborne(second.vehicle, 40.0)
        second.vehicle.flight.aim((3000.0, 0.0), -40.0)
        link.cut = True
        links = [f"udpout:127.0.0.1:{port}" for port in (first.ports[0][1], link.port)]
        table = {"links": links, "discover": True, "params": [], "on_loss": "return"}
        async with serve_backend(KIND, table) as served:
            await until(lambda: bool(served.lives), "the first is heard")
            # As it is noted for a command that an earlier gateway has left behind.
            loss = served.supervisor.unit("vehicle2").loss
            loss.note("/tenant/t/action/vehicle2/move_to", BEFORE)
            link.cut = False
            await until(lambda: second.vehicle.flight.mode is Mode.RTL, "it returns")


async def test_a_return_that_is_refused_is_a_hold() -> None:
    async with flying(on_loss="return") as found:
        id_ = await found.moving()
        found.relay.cut = True
        await found.client.final(id_)
        await until(lambda: found.robot.vehicle.lost, "it is lost")
        found.vehicle.params.set("FS_EKF_ACTION", 0.0)
        found.vehicle.params.set("SIM_GPS1_ENABLE", 0.0)
        found.relay.cut = False
        await until(lambda: found.vehicle.flight.mode is Mode.ALT_HOLD, "it levels")
