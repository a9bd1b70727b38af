"""What MAVSDK does with a twin, in a process of its own: `python mavsdk_flights.py FLIGHT PORT FOLDER`.

MAVSDK is foreign code that blocks threads which nothing can interrupt. If it hangs or crashes, that
ends this process alone.
"""

from __future__ import annotations

import asyncio
import faulthandler
import math
import os
import sys
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

from mavsdk import ComponentType
from mavsdk.asyncio import Configuration, Mavsdk
from mavsdk.asyncio.plugins.action import ActionAsync
from mavsdk.asyncio.plugins.ftp import FtpAsync
from mavsdk.asyncio.plugins.geofence import GeofenceAsync
from mavsdk.asyncio.plugins.gimbal import GimbalAsync
from mavsdk.asyncio.plugins.log_files import LogFilesAsync
from mavsdk.asyncio.plugins.manual_control import ManualControlAsync
from mavsdk.asyncio.plugins.mission_raw import MissionRawAsync
from mavsdk.asyncio.plugins.param import ParamAsync
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync
from mavsdk.plugins.action import ActionError
from mavsdk.plugins.geofence import Circle, FenceType, GeofenceData, Point, Polygon
from mavsdk.plugins.gimbal import ControlMode, GimbalMode, SendMode
from mavsdk.plugins.mission_raw import MissionItem, MissionRawError

BOUND = 120.0  # s for a flight, after which it is told where each thread stands
LAT, LON = -35.3632621, 149.1652374


async def until(stream: Any, holds: Callable[[Any], bool], seconds: float = 60.0) -> Any:
    async with asyncio.timeout(seconds):
        async for value in stream:
            if holds(value):
                return value
    raise AssertionError("the stream ended")


async def arms_takes_off_goes_returns_and_lands(system: Any, _folder: Path) -> None:
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


async def reads_and_sets_parameters(system: Any, _folder: Path) -> None:
    param = ParamAsync(system)
    assert await param.get_param_float("WPNAV_SPEED") == 1000
    await param.set_param_float("WPNAV_SPEED", 750.0)
    assert await param.get_param_float("WPNAV_SPEED") == 750
    await param.set_param_int("RTL_ALT", 2500)
    assert await param.get_param_int("RTL_ALT") == 2500
    everything = await param.get_all_params()
    assert len(everything.int_params) + len(everything.float_params) > 400


async def uploads_a_mission_and_reads_it_back(system: Any, _folder: Path) -> None:
    missions = MissionRawAsync(system)
    items = [await _item(n, lat) for n, lat in enumerate((-35.36, -35.361, -35.362))]
    await _uploaded(missions, items)
    back = await missions.download_mission()
    assert [item.frame for item in back] == [0, 3, 3]
    assert [item.x for item in back[1:]] == [item.x for item in items[1:]]


async def _uploaded(missions: Any, items: list[Any]) -> None:
    """Upload a mission; MAVSDK gives up after two seconds, which a busy machine may take."""
    for left in reversed(range(10)):
        try:
            await missions.upload_mission(items)
        except MissionRawError as error:
            if not left or "TIMEOUT" not in str(error):
                raise
        else:
            return


async def _item(number: int, lat: float) -> Any:
    return MissionItem(
        number, 6, 16, int(number == 0), 1, 0.0, 0.0, 0.0, 0.0, round(lat * 1e7),
        round(149.165 * 1e7), 20.0, 0,
    )  # fmt: skip


async def flies_a_mission_and_downloads_its_log(system: Any, folder: Path) -> None:
    action, telemetry, missions = (
        ActionAsync(system), TelemetryAsync(system), MissionRawAsync(system),
    )  # fmt: skip
    await telemetry.set_rate_health(10.0)
    await until(
        telemetry.subscribe_health(), lambda h: h.is_global_position_ok and h.is_home_position_ok
    )
    items = [
        _command(0, 16, 0, LAT, LON, 0.0),
        _command(1, 22, 3, 0.0, 0.0, 8.0),
        _command(2, 16, 3, LAT + 1e-4, LON, 10.0),
        _command(3, 20, 3, 0.0, 0.0, 0.0),
    ]
    await _uploaded(missions, items)
    await ParamAsync(system).set_param_int("RTL_LOIT_TIME", 0)
    await action.arm()
    await missions.start_mission()
    await until(missions.subscribe_mission_progress(), lambda p: p.current >= 2)
    await until(telemetry.subscribe_armed(), lambda armed: not armed, 60.0)

    logs = LogFilesAsync(system)
    (entry,) = await logs.get_entries()
    path = folder / "flight.log"
    async for _ in logs.download_log_file(entry, str(path)):
        pass
    assert path.stat().st_size == entry.size_bytes > 1000


async def keeps_files_and_fences(system: Any, folder: Path) -> None:
    files, fences = FtpAsync(system), GeofenceAsync(system)
    script = folder / "own.lua"
    script.write_bytes(os.urandom(3000))
    async for _ in files.upload(str(script), "/APM/scripts"):
        pass
    assert await files.are_files_identical(str(script), "/APM/scripts/own.lua")
    for burst in (False, True):
        place = folder / str(burst)
        place.mkdir()
        async for _ in files.download("/APM/scripts/own.lua", str(place), burst):
            pass
        assert (place / "own.lua").read_bytes() == script.read_bytes()
    await files.rename("/APM/scripts/own.lua", "/APM/other.lua")
    await files.create_directory("/APM/mine")
    listed = await files.list_directory("/APM")
    assert [entry.name for entry in listed.entries] == ["LOGS", "mine", "other.lua", "scripts"]
    await files.remove_file("/APM/other.lua")
    await files.remove_directory("/APM/mine")

    corners = [Point(LAT + a * 1e-3, LON + b * 1e-3) for a, b in ((-1, -1), (-1, 1), (1, 1))]
    polygon = Polygon(corners, FenceType.INCLUSION)
    circle = Circle(Point(LAT, LON), 50.0, FenceType.EXCLUSION)
    await fences.upload_geofence(GeofenceData([polygon], [circle]))
    back = await fences.download_geofence()
    assert [len(one.points) for one in back.polygons] == [3]
    assert [one.radius for one in back.circles] == [50.0]


async def is_flown_by_hand(system: Any, _folder: Path) -> None:
    action, telemetry, sticks = (
        ActionAsync(system), TelemetryAsync(system), ManualControlAsync(system),
    )  # fmt: skip
    await telemetry.set_rate_health(10.0)
    await telemetry.set_rate_position(20.0)
    await until(telemetry.subscribe_health(), lambda h: h.is_home_position_ok)
    await ParamAsync(system).set_param_int("MAV_GCS_SYSID", 245)  # MAVSDK's own
    await action.arm()
    await action.takeoff()
    await until(telemetry.subscribe_position(), lambda p: p.relative_altitude_m > 2)

    async def push() -> None:
        while True:
            await sticks.set_manual_control_input(0.8, 0.0, 0.5, 0.0)
            await asyncio.sleep(0.02)

    pushing = asyncio.create_task(push())
    try:
        await asyncio.sleep(0.1)  # it must have sent some before it may begin
        await sticks.start_position_control()
        await until(telemetry.subscribe_position(), lambda p: p.latitude_deg > LAT + 1e-4)
    finally:
        pushing.cancel()


async def finds_and_turns_the_gimbal(system: Any, _folder: Path) -> None:
    gimbal = GimbalAsync(system)
    found = await until(gimbal.subscribe_gimbal_list(), lambda known: bool(known.gimbals))
    number = found.gimbals[0].gimbal_id
    await gimbal.take_control(number, ControlMode.PRIMARY)
    await gimbal.set_angles(number, 0.0, -40.0, 20.0, GimbalMode.YAW_FOLLOW, SendMode.ONCE)


async def flies_once_it_may(system: Any, _folder: Path) -> None:
    """Try to arm until nobody else has control; tell of each refusal on a line."""
    action, telemetry = ActionAsync(system), TelemetryAsync(system)
    await telemetry.set_rate_health(10.0)
    await telemetry.set_rate_position(20.0)
    await until(telemetry.subscribe_health(), lambda h: h.is_home_position_ok)
    while True:
        try:
            await action.arm()
        except ActionError as error:
            sys.stdout.write(f"refused {error}\n")
            sys.stdout.flush()
            await asyncio.sleep(0.3)
        else:
            break
    await action.set_takeoff_altitude(5.0)
    await action.takeoff()
    await until(telemetry.subscribe_position(), lambda p: p.relative_altitude_m > 4.0)
    sys.stdout.write("flies\n")
    sys.stdout.flush()
    await until(telemetry.subscribe_in_air(), lambda flies: not flies, 100.0)


def _command(seq: int, command: int, frame: int, lat: float, lon: float, height: float) -> Any:
    place = (round(lat * 1e7), round(lon * 1e7), height)
    heading = math.nan if command in (16, 22) else 0.0
    return MissionItem(
        seq, frame, command, int(seq == 0), 1, 0.0, 0.0, 0.0, heading, *place, 0
    )  # fmt: skip


async def main(flight: str, port: str, folder: str) -> None:
    """Fly, and end the process without asking MAVSDK, whose threads may never come to an end."""
    failed = 1
    try:
        mavsdk = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
        await mavsdk.add_any_connection(f"udpout://127.0.0.1:{port}")
        found = await mavsdk.first_autopilot(timeout_s=30.0)
        assert found is not None, "no autopilot was found"
        await globals()[flight](found, Path(folder))
        failed = 0
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        os._exit(failed)


if __name__ == "__main__":
    faulthandler.enable()
    faulthandler.dump_traceback_later(BOUND, exit=True)
    asyncio.run(main(*sys.argv[1:]))
