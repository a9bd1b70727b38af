"""A gateway that is frozen or killed in flight: who stops the vehicle, and what the next one does."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import AsyncGenerator, Callable, Iterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from backends.mavlink.flying import airborne, speed, twin
from backends.mavlink.lone_gateway import BOUND, LoneGateway, lone_gateway
from backends.mavlink.relay import SET_MODE, commander, relay
from rcp_mavlink_sim import Twin, Vehicle
from rcp_mavlink_sim.modes import Mode
from timing import Load, measured_load

AT_REST = 0.5  # m/s
SETTLED = 1.0  # s
STAYS = 2.0  # s that something is watched not to happen
HEIGHT = 20.0  # m
GUARDED = 5.0  # s in which a guarded vehicle is at rest, of which it brakes for some three; a busy machine has more
FAILSAFE = 6.0  # s in which one is at rest over ground that its failsafe lands after two seconds
BRAKE = 17
UNGUARDED = "guard = false"
pytestmark = [pytest.mark.paired, pytest.mark.real_time]


@asynccontextmanager
async def in_the_air(height: float = HEIGHT, **options: Any) -> AsyncGenerator[Twin]:
    """Have a copter in the air, in real time, on the loop of the test: it flies on whatever happens."""
    async with twin(speed=1.0, **options) as running:
        airborne(running.vehicle, height)
        yield running


async def until(holds: Callable[[], object], what: str, within: float = BOUND) -> float:
    """Wait for the vehicle's truth; return the seconds that it took."""
    began = time.monotonic()
    try:
        async with asyncio.timeout(within):
            while not holds():  # noqa: ASYNC110 - simulated time passes on this loop
                await asyncio.sleep(0.01)
    except TimeoutError:
        raise AssertionError(f"not within {within} s: {what}") from None
    return time.monotonic() - began


async def rest(vehicle: Vehicle, within: float = BOUND, *, level: bool = False) -> float:
    """Wait until it is at rest, and not only where it swings back; return the seconds to then."""
    began = still = time.monotonic()
    while time.monotonic() < still + SETTLED:
        moves = math.hypot(vehicle.body.vn, vehicle.body.ve) if level else speed(vehicle)
        if moves >= AT_REST:
            still = time.monotonic()
        assert still < began + within, f"it moves at {moves:.2f} m/s after {within} s"
        await asyncio.sleep(0.01)
    return still - began


async def moving(gateway: LoneGateway, vehicle: Vehicle, height: float = HEIGHT) -> str:
    """Send it to a far goal, and see it fly; return the command."""
    await gateway.poll(_is_ready(gateway), bool)
    id_ = await gateway.start("action/move_to", {"north": 3000.0, "altitude": height})

    async def flies() -> bool:
        found = await gateway.command(id_)
        assert found["status"] in ("accepted", "pending", "in_progress"), found
        return speed(vehicle) > 8.0

    await gateway.poll(flies, bool)
    return id_


def _is_ready(gateway: LoneGateway) -> Callable[[], Any]:
    async def look() -> bool:
        reply = await gateway.http.get("/context/tenant/alpha/sensor/landed")
        other = await gateway.http.get("/context/tenant/alpha/sensor/position/global")
        home = await gateway.http.get("/context/tenant/alpha/sensor/home", params={"fresh": "true"})
        return reply.status_code == other.status_code == home.status_code == 200

    return look


async def stays(vehicle: Vehicle, seconds: float = STAYS) -> None:
    """Watch that it stays at rest."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        assert speed(vehicle) < AT_REST
        await asyncio.sleep(0.02)


async def goes_on(vehicle: Vehicle, seconds: float = STAYS) -> None:
    """Watch that it flies on to its goal."""
    before, end = vehicle.body.n, time.monotonic() + seconds
    while time.monotonic() < end:
        assert speed(vehicle) > 3.0
        assert vehicle.flight.mode is Mode.GUIDED
        await asyncio.sleep(0.02)
    assert vehicle.body.n > before + 3


@pytest.fixture
def load() -> Iterator[Load]:
    """What else the machine does meanwhile."""
    with measured_load() as load:
        yield load


def gone(gateway: LoneGateway, how: str) -> None:
    """Freeze or kill it, and do not wait for that: its guard holds its standard error for a while."""
    if how == "frozen":
        gateway.freeze()
    else:
        gateway.process.kill()


@pytest.mark.parametrize("how", ["frozen", "killed"])
async def test_a_guarded_vehicle_comes_to_rest_without_its_gateway(
    how: str, load: Load, tmp_path: Path
) -> None:
    async with in_the_air() as running:
        vehicle, port = running.vehicle, running.ports[0][1]
        async with lone_gateway(tmp_path, port, safety="guard_bound = 2.0") as gateway:
            id_ = await moving(gateway, vehicle)
            await gateway.guarded()
            gone(gateway, how)
            told = await until(lambda: vehicle.flight.mode is Mode.BRAKE, "it is told")
            rests = told + await rest(vehicle)
            print(f"guard, {how}: told after {told:.2f} s, at rest after {rests:.2f} s")  # noqa: T201
            assert rests < load.allows(GUARDED)
            await stays(vehicle)
            if how == "frozen":
                gateway.thaw()
                ended = await gateway.ended(id_)
                assert ended["status"] in ("cancelled", "failed"), ended
                await stays(vehicle)
                assert vehicle.flight.mode is Mode.BRAKE


@pytest.mark.parametrize("how", ["frozen", "killed"])
async def test_a_vehicle_without_a_guard_is_landed_by_the_failsafe_that_the_gateway_has_set(
    how: str, load: Load, tmp_path: Path
) -> None:
    async with in_the_air(5.0, parameters={"DISARM_DELAY": 0.0, "FS_GCS_TIMEOUT": 2.0}) as running:
        vehicle, port = running.vehicle, running.ports[0][1]
        async with lone_gateway(tmp_path, port, safety=UNGUARDED, watchdog="set") as gateway:
            await until(lambda: vehicle.params["FS_GCS_ENABLE"] == 5, "the failsafe is set")
            id_ = await moving(gateway, vehicle, 5.0)
            gone(gateway, how)
            began = time.monotonic()
            told = await until(lambda: vehicle.flight.mode is Mode.LAND, "it lands")
            rests = told + await rest(vehicle, level=True)
            await until(lambda: vehicle.body.landed and not vehicle.armed, "it stands")
            stands = time.monotonic() - began
            print(  # noqa: T201
                f"failsafe, {how}: lands after {told:.2f} s, at rest over ground after {rests:.2f} s,"
                f" disarmed after {stands:.2f} s from 5 m"
            )
            assert rests < load.allows(FAILSAFE)
            if how == "frozen":
                gateway.thaw()
                ended = await gateway.ended(id_)
                assert ended["status"] == "failed", ended
            await stays(vehicle)
            assert not vehicle.armed


@pytest.mark.parametrize(("options", "mode"), [(0.0, Mode.LAND), (16.0, Mode.BRAKE)])
async def test_the_guard_does_not_overrule_the_failsafe_of_the_vehicle(
    options: float, mode: Mode, tmp_path: Path
) -> None:
    """It stops it at once, and the failsafe, which acts a single time, lands it later.

    An ArduCopter takes BRAKE for a mode of a pilot, in which its usual FS_OPTIONS of 16 have it stay.
    """
    parameters = {
        "DISARM_DELAY": 0.0,
        "FS_GCS_ENABLE": 5.0,
        "FS_GCS_TIMEOUT": 3.0,
        "FS_OPTIONS": options,
    }
    async with in_the_air(5.0, parameters=parameters) as running:
        vehicle, port = running.vehicle, running.ports[0][1]
        async with lone_gateway(tmp_path, port, safety="guard_bound = 6.0") as gateway:
            await moving(gateway, vehicle, 5.0)
            await gateway.guarded()
            gateway.freeze()
            await until(lambda: vehicle.flight.mode is Mode.BRAKE, "the guard stops it")
            await until(lambda: vehicle.failsafes.station_lost, "the failsafe acts")
            assert vehicle.flight.mode is mode
            if mode is Mode.BRAKE:
                await rest(vehicle)
                await stays(vehicle)
            while mode is Mode.LAND and not vehicle.body.landed:
                assert vehicle.flight.mode is Mode.LAND
                await asyncio.sleep(0.02)


@pytest.mark.parametrize("policy", ["hold", "continue"])
async def test_what_nobody_stopped_is_told_what_its_policy_says_by_the_next_gateway(
    policy: str, tmp_path: Path
) -> None:
    async with in_the_air() as running:
        vehicle, port = running.vehicle, running.ports[0][1]
        options: dict[str, Any] = {"safety": UNGUARDED, "watchdog": "off", "on_loss": policy}
        async with lone_gateway(tmp_path, port, **options) as gateway:
            id_ = await moving(gateway, vehicle)
            await gateway.kill()
        await goes_on(vehicle, 3.0)  # as the real one
        async with lone_gateway(tmp_path, port, **options) as gateway:
            found = await gateway.poll(
                lambda: gateway.command(id_), lambda c: "on_loss" in str(c.get("error"))
            )
            assert found["status"] == "failed"
            assert found["error"]["details"]["on_loss"] == policy
            assert "gateway stopped" in found["error"]["message"]
            if policy == "hold":
                rests = await rest(vehicle)
                print(f"restarted: at rest {rests:.2f} s after it was told of")  # noqa: T201
                await stays(vehicle)
                assert vehicle.flight.mode is Mode.BRAKE
            else:
                await gateway.poll(_is_ready(gateway), bool)
                await goes_on(vehicle, 3.0)


async def test_a_latch_outlives_the_gateway_and_the_stop_is_the_first_that_the_next_one_sends(
    tmp_path: Path,
) -> None:
    async with in_the_air() as running, relay(running.ports[0]) as link:
        vehicle = running.vehicle
        async with lone_gateway(tmp_path, link.port, safety=UNGUARDED) as gateway:
            await moving(gateway, vehicle)
            reply = await gateway.estop()
            assert reply["status"] == "completed", reply
            assert speed(vehicle) < AT_REST
            await gateway.kill()
        async with commander(running.ports[0]) as other:
            other.fly(3000.0, HEIGHT)
            await until(lambda: speed(vehicle) > 3.0, "somebody else moves it")
        del link.sent[:]
        async with lone_gateway(tmp_path, link.port, safety=UNGUARDED) as gateway:
            await until(lambda: link.sent, "something is sent")
            first = link.sent[0]
            assert first.get_type() == "COMMAND_LONG", first
            assert (first.command, first.param2) == (SET_MODE, BRAKE)
            state = await gateway.poll(gateway.stopped, lambda s: s["state"] == "confirmed")
            assert state["detail"] is None, state
            assert speed(vehicle) < AT_REST
            refused = await gateway.http.post(
                "/context/tenant/alpha/action/move_to", params={"wait": "5"}, json={"north": 9.0}
            )
            assert refused.json()["error"]["code"] == "estop_active"
            await stays(vehicle)
