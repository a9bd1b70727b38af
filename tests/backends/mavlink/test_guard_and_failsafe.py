"""Who stops a vehicle when the gateway does not: the guard, by a plan, and the failsafe."""

from __future__ import annotations

import asyncio
import time
from typing import Any

import pytest
from pymavlink import mavutil

from backends.mavlink.flying import agrees, airborne, on_the_ground, speed, twin
from backends.mavlink.relay import commander
from backends.mavlink.stopping import AT_REST, BRAKE, GUIDED, KIND, LAND, Stopped, flying, until
from backends.mavlink.twins import twin_process
from rcp_gateway.testing import eventually
from rcp_gateway.testing._serve import OPERATOR, serve_backend
from rcp_mavlink.signing import key_of
from rcp_mavlink_sim.modes import Mode


async def test_what_the_guard_sends_stops_it_without_the_gateway() -> None:
    async with flying() as found, commander(found.twin.ports[0]) as guard:
        await found.moving()
        plans = found.served.life.host.plans
        await until(lambda: plans, "a plan is given once it is armed")
        (plan,) = plans.values()
        assert plan.sender == "udp"
        assert plan.data["to"] == ["127.0.0.1", found.relay.port]
        found.relay.cut = True
        frames = [bytes.fromhex(frame) for frame in plan.data["frames"]]
        began = time.monotonic()
        while speed(found.vehicle) > AT_REST and time.monotonic() - began < 10:
            for frame in frames:
                guard.write(frame)
            await asyncio.sleep(plan.period)
        assert found.vehicle.flight.mode is Mode.BRAKE
        assert len({frame[7:10] for frame in frames}) == 2, "a command, and SET_MODE"


async def test_the_guard_has_no_plan_for_what_stands_disarmed_and_keeps_a_landing_up() -> None:
    async with flying(estop="land") as found:
        on_the_ground(found.vehicle)
        await agrees(found.served.life.backend, found.vehicle)
        plans = found.served.life.host.plans
        await until(lambda: not plans, "there is nothing to guard")
        await found.moving(30.0)
        await until(lambda: plans, "there is")
        holding = next(iter(plans.values())).data["frames"]
        await found.estop(deadline=0.5)
        await until(
            lambda: plans and next(iter(plans.values())).data["frames"] != holding,
            "the landing is what it keeps up",
        )


async def test_a_signed_link_has_no_plan_and_says_so() -> None:
    key = "a passphrase"
    async with twin(key=key_of(key)) as running:
        airborne(running.vehicle)
        link = f"udpout:127.0.0.1:{running.ports[0][1]}"
        async with serve_backend(KIND, {"links": [link], "key": key, "params": []}) as served:
            await until(lambda: bool(served.lives), "it is heard")
            await agrees(served.life.backend, running.vehicle)
            assert not served.life.host.plans
            (guard,) = [w for w in served.life.backend.watchdogs() if "guard" in w.mechanism]
            assert guard.within is None
            assert "signed" in guard.mechanism


async def watchdogs(found: Stopped) -> list[Any]:
    await until(found.robot.parameters.complete.is_set, "the parameters are listed")
    await until(found.robot.watchdogs.verified.is_set, "they are looked at")
    return [w for w in found.served.life.backend.watchdogs() if "guard" not in w.mechanism]


async def test_a_failsafe_that_is_off_is_told_and_left_alone() -> None:
    async with flying() as found:
        station, guided = await watchdogs(found)
        assert (station.within, station.verified) == (None, True)
        assert "FS_GCS_ENABLE=0" in station.mechanism
        assert (guided.within, guided.verified) == (3.0, True)
        assert found.vehicle.params["FS_GCS_ENABLE"] == 0


async def test_a_failsafe_is_set_where_that_is_asked_for_and_read_back() -> None:
    async with flying(watchdog="set") as found:
        station, _ = await watchdogs(found)
        assert found.vehicle.params["FS_GCS_ENABLE"] == 5
        assert (station.within, station.verified) == (6.0, True)


async def test_a_failsafe_that_somebody_chose_is_not_changed() -> None:
    async with flying({"parameters": {"FS_GCS_ENABLE": 1.0}}, watchdog="set") as found:
        station, _ = await watchdogs(found)
        assert found.vehicle.params["FS_GCS_ENABLE"] == 1
        assert station.within == 6.0


async def test_a_failsafe_that_heeds_another_station_is_none() -> None:
    parameters = {"FS_GCS_ENABLE": 5.0, "MAV_GCS_SYSID": 250.0}
    async with flying({"parameters": parameters}) as found:
        station, _ = await watchdogs(found)
        assert station.within is None
        assert "MAV_GCS_SYSID=250" in station.mechanism


@pytest.mark.parametrize(("kind", "mode"), [("tcp", LAND), ("udp", BRAKE)])
def test_a_gateway_whose_loop_stands_still_is_replaced_by_the_failsafe_or_the_guard(
    kind: str, mode: int
) -> None:
    """Over TCP there is no guard: no heartbeats come, and the failsafe lands it."""
    options = ("--warmup", "0", "--param", "FS_GCS_ENABLE=5", "--param", "FS_GCS_TIMEOUT=2")
    with twin_process("udpin:127.0.0.1:0", "tcpin:127.0.0.1:0", options=options) as process:
        links = {
            "udp": f"udpout:127.0.0.1:{process.ports['udpin']}",
            "tcp": f"tcp:127.0.0.1:{process.ports['tcpin']}",
        }
        own = links.pop(kind)
        (others,) = links.values()
        asyncio.run(_frozen_loop(own, others, mode))


async def _frozen_loop(link: str, others: str, mode: int) -> None:
    options = {"links": [link], "params": []}
    async with serve_backend(KIND, options, guard_after=0.6) as served:
        await until(lambda: bool(served.lives), "it is heard", 20.0)
        client = served.client(OPERATOR)

        async def ready() -> bool:
            reply = await client.request(
                "execute", "/tenant/t/action/set_mode", body={"mode": "GUIDED"}
            )
            arm = await client.request("execute", "/tenant/t/action/arm")
            return reply["status"] == arm["status"] == "completed"

        await eventually(ready, "it is armed", 20.0)
        rise = {"altitude": 8.0}
        reply = await client.request("execute", "/tenant/t/action/takeoff", body=rise, within=60.0)
        assert reply["status"] == "completed", reply
        other: Any = mavutil.mavlink_connection(others, source_system=254)
        other.mav.heartbeat_send(6, 8, 0, 0, 4)  # over UDP it has to call
        modes: list[int] = []

        def look() -> None:
            """See the mode while the loop of the gateway stands still: this runs in its thread."""
            end = time.monotonic() + 6
            while time.monotonic() < end and modes[-1:] != [mode]:
                beat = other.recv_match(type="HEARTBEAT", blocking=True, timeout=1)
                if beat is not None:
                    modes.append(beat.custom_mode)

        look()  # blocks the loop on purpose
        other.close()
        assert modes[0] == GUIDED
        assert modes[-1] == mode, modes
