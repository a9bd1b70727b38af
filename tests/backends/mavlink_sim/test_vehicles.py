"""The twin is a plane, a rover or a boat too, each with its own modes and ways to move."""

from __future__ import annotations

import math
from typing import Any

import pytest

from backends.mavlink_sim.station import Station
from backends.mavlink_sim.test_twin import item, upload
from rcp_mavlink.flightmodes import family
from rcp_mavlink_sim.kinds import KINDS
from rcp_mavlink_sim.modes import Mode
from rcp_mavlink_sim.wire import mav

OK, FAILED = 0, 4
PX4_WORDS = {
    Mode.GUIDED: "HOLD", Mode.AUTO: "MISSION", Mode.LOITER: "POSCTL", Mode.ALT_HOLD: "ALTCTL",
    Mode.STABILIZE: "STABILIZED", Mode.CIRCLE: "ORBIT",
}  # fmt: skip


def ready(kind: str, **options: Any) -> Station:
    station = Station(vehicle=kind, **options)
    station.pass_time(1.2)
    return station


def enter(station: Station, mode: Mode) -> int:
    return station.mode(station.vehicle.kind.number(mode))


@pytest.mark.parametrize("kind", list(KINDS))
def test_modes_have_the_numbers_that_the_gateway_knows(kind: str) -> None:
    station = ready(kind)
    station.pass_time(1.5)
    beat = station.last("HEARTBEAT")
    known = family(beat.autopilot, beat.type)
    modes = KINDS[kind].modes
    words = PX4_WORDS if kind == "px4" else {}
    names = {number: words.get(mode, mode.name) for number, mode in modes.items()}
    assert names.items() <= known.modes.items()
    assert beat.custom_mode == KINDS[kind].number(KINDS[kind].first)


@pytest.mark.parametrize("kind", ["rover", "boat"])
def test_on_the_ground_it_goes_to_a_place_and_home(kind: str) -> None:
    station = ready(kind, wind=(2.0, -2.0))
    vehicle = station.vehicle
    assert enter(station, Mode.GUIDED) == OK
    assert station.command(400, 1) == OK
    lat, lon, _ = vehicle.origin
    assert station.reposition(lat + 2e-4, lon + 1e-4, 0) == OK
    station.until(lambda: vehicle.pilot.at_place(2.0), 60)
    assert vehicle.body.d == 0
    assert enter(station, Mode.RTL) == OK
    station.until(lambda: math.hypot(vehicle.body.n, vehicle.body.e) < 3, 60)
    station.pass_time(5)
    assert math.hypot(vehicle.body.n, vehicle.body.e) < 4
    assert station.command(400, 0) == OK


def test_a_boat_drifts_with_the_wind_where_a_rover_stands() -> None:
    ways = []
    for kind in ("rover", "boat"):
        station = ready(kind, wind=(8.0, 0.0))
        station.pass_time(20)
        ways.append(station.vehicle.body.n)
    assert ways[0] == 0
    assert ways[1] > 3


def test_a_rover_is_driven_by_velocity_and_stops_when_it_is_not() -> None:
    station = ready("rover")
    enter(station, Mode.GUIDED)
    station.command(400, 1)
    for _ in range(4):
        station.send(
            mav.MAVLink_set_position_target_local_ned_message(
                0, 1, 1, 8, 0x05C7, 0, 0, 0, 1.5, 0, 0, 0, 0, 0, 0, 0.4
            )
        )
        station.pass_time(1)
    body = station.vehicle.body
    assert (body.speed, body.r) == pytest.approx((1.5, 0.4), abs=0.05)
    station.pass_time(8)
    assert abs(body.speed) < 0.1


def test_a_plane_runs_climbs_and_circles_a_place() -> None:
    station = ready("plane")
    vehicle = station.vehicle
    assert station.command(22, 0, 0, 0, 0, 0, 0, 20) == FAILED
    assert enter(station, Mode.TAKEOFF) == OK
    assert station.command(400, 1) == OK
    station.until(lambda: not vehicle.body.landed, 10)
    assert vehicle.body.n > 10
    station.until(lambda: -vehicle.body.d > 46, 30)
    assert station.command(400, 0) == FAILED
    enter(station, Mode.GUIDED)
    lat, lon, _ = vehicle.origin
    assert station.reposition(lat + 4e-3, lon, 80) == OK
    station.until(lambda: vehicle.pilot.at_place(5.0), 60)
    station.pass_time(20)
    assert vehicle.pilot.away() == pytest.approx(60, abs=3)
    assert vehicle.body.d == pytest.approx(-80, abs=1)
    assert vehicle.body.airspeed == pytest.approx(22, abs=1)


def test_a_plane_flies_a_mission_and_lands_on_its_wheels() -> None:
    station = ready("plane", wind=(0.0, 3.0))
    vehicle = station.vehicle
    lat, lon, _ = vehicle.origin
    items = [
        item(0, 16, frame=0, lat=1, lon=2),
        item(1, 22, alt=40),
        item(2, 16, lat=lat + 4e-3, lon=lon, alt=60),
        item(3, 16, lat=lat + 4e-3, lon=lon + 4e-3, alt=60),
        item(4, 21, lat=lat, lon=lon),
    ]
    assert upload(station, items) == 0
    assert enter(station, Mode.AUTO) == OK
    assert station.command(400, 1) == OK
    station.until(lambda: not vehicle.armed, 400)
    assert math.hypot(vehicle.body.n, vehicle.body.e) < 120
    assert vehicle.body.impact < 1.0
    assert "Mission: 4 Land" in station.texts


def test_a_plane_too_slow_sinks() -> None:
    station = ready("plane")
    body = station.vehicle.body
    body.landed, body.d, body.airspeed = False, -100.0, 9.0
    body.want_path, body.want_power = 0.1, 0.0
    for _ in range(1000):
        body.step(0.005)
    assert body.d > -97


def test_a_plane_goes_home_without_its_station_by_its_own_parameters() -> None:
    station = ready("plane", parameters={"FS_GCS_ENABL": 1})
    station.send(mav.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
    enter(station, Mode.TAKEOFF)
    station.command(400, 1)
    station.until(lambda: station.vehicle.flight.mode is Mode.RTL, 30)
    assert "GCS Failsafe" in station.texts
