"""MAVSDK, a client of others, flies the twin unchanged."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from typing import Any

import pytest
from mavsdk import ComponentType
from mavsdk.asyncio import Configuration, Mavsdk
from mavsdk.asyncio.plugins.action import ActionAsync
from mavsdk.asyncio.plugins.mission_raw import MissionRawAsync
from mavsdk.asyncio.plugins.param import ParamAsync
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync

from backends.mavlink.twins import twin_process

SPEED = "8"


@pytest.fixture
async def system() -> AsyncIterator[Any]:
    with twin_process("udpin:127.0.0.1:0", options=("--speed", SPEED, "--warmup", "20")) as twin:
        configuration = Configuration.create_with_component_type(ComponentType.GROUND_STATION)
        async with Mavsdk(configuration) as mavsdk:
            await mavsdk.add_any_connection(f"udpout://127.0.0.1:{twin.ports['udpin']}")
            found = await mavsdk.first_autopilot(timeout_s=10.0)
            assert found is not None
            yield found


async def until(stream: Any, holds: Callable[[Any], bool], seconds: float = 30.0) -> Any:
    async with asyncio.timeout(seconds):
        async for value in stream:
            if holds(value):
                return value
    raise AssertionError("the stream ended")


async def test_it_arms_takes_off_goes_returns_and_lands(system: Any) -> None:
    action, telemetry = ActionAsync(system), TelemetryAsync(system)
    await telemetry.set_rate_position(20.0)
    await telemetry.set_rate_in_air(20.0)
    await telemetry.set_rate_gps_info(5.0)
    await telemetry.set_rate_home(2.0)
    await telemetry.set_rate_health(10.0)
    await until(
        telemetry.subscribe_health(), lambda h: h.is_global_position_ok and h.is_home_position_ok
    )
    home = await until(telemetry.subscribe_position(), lambda p: abs(p.latitude_deg) > 1)

    await action.set_takeoff_altitude(12.0)
    await action.arm()
    await until(telemetry.subscribe_armed(), lambda armed: armed)
    await action.takeoff()
    await until(telemetry.subscribe_position(), lambda p: p.relative_altitude_m > 11.5)

    north = home.latitude_deg + 3e-4
    await action.goto_location(north, home.longitude_deg, home.absolute_altitude_m + 20, 0.0)
    await until(telemetry.subscribe_position(), lambda p: abs(p.latitude_deg - north) < 1e-5)

    await action.return_to_launch()
    await until(
        telemetry.subscribe_position(), lambda p: abs(p.latitude_deg - home.latitude_deg) < 1e-5
    )
    await action.land()
    await until(telemetry.subscribe_in_air(), lambda flies: not flies)
    await until(telemetry.subscribe_armed(), lambda armed: not armed)


async def test_it_reads_and_sets_parameters(system: Any) -> None:
    param = ParamAsync(system)
    assert await param.get_param_float("WPNAV_SPEED") == 1000
    await param.set_param_float("WPNAV_SPEED", 750.0)
    assert await param.get_param_float("WPNAV_SPEED") == 750
    await param.set_param_int("RTL_ALT", 2500)
    assert await param.get_param_int("RTL_ALT") == 2500
    everything = await param.get_all_params()
    assert len(everything.int_params) + len(everything.float_params) > 400


async def test_it_uploads_a_mission_and_reads_it_back(system: Any) -> None:
    missions = MissionRawAsync(system)
    items = [await _item(n, lat) for n, lat in enumerate((-35.36, -35.361, -35.362))]
    await missions.upload_mission(items)
    back = await missions.download_mission()
    assert [item.frame for item in back] == [0, 3, 3]
    assert [item.x for item in back[1:]] == [item.x for item in items[1:]]


async def _item(number: int, lat: float) -> Any:
    from mavsdk.asyncio.plugins.mission_raw import MissionItem

    return MissionItem(
        number, 6, 16, int(number == 0), 1, 0.0, 0.0, 0.0, 0.0, round(lat * 1e7),
        round(149.165 * 1e7), 20.0, 0,
    )  # fmt: skip
