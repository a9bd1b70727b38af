"""Where the twin was kinder than the real one: as flown with an ArduCopter, and as its source reads."""

from __future__ import annotations

import math
from typing import Any

import pytest

from backends.mavlink_sim.station import Station
from backends.mavlink_sim.test_twin import item, upload
from rcp_mavlink_sim.modes import Mode
from rcp_mavlink_sim.wire import mav

OK, DENIED, UNSUPPORTED, FAILED = 0, 2, 3, 4
STABILIZE, ALT_HOLD, AUTO, GUIDED, LOITER, RTL, LAND, BRAKE = 0, 2, 3, 4, 5, 6, 9, 17
SPEED, YAW, TERMINATE = 178, 115, 185
REAL32 = 9
HEARTBEAT = mav.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)


def reposition(station: Station, north: float, *, speed: float = -1, yaw: float = 0) -> int:
    lat, lon, _ = station.vehicle.origin
    place = (round((lat + north / 111_320) * 1e7), round(lon * 1e7), 10)
    heard = station.send(
        mav.MAVLink_command_int_message(1, 1, 6, 192, 0, 0, speed, 1, 0, yaw, *place)
    )
    return next(m.result for m in heard if m.get_type() == "COMMAND_ACK")


def fastest(station: Station, seconds: float) -> float:
    most = 0.0
    for _ in range(round(seconds / 0.1)):
        station.pass_time(0.1)
        body = station.vehicle.body
        most = max(most, math.hypot(body.vn, body.ve))
    return most


def ready(kind: str, mode: Mode = Mode.GUIDED) -> Station:
    station = Station(vehicle=kind)
    station.pass_time(1.2)
    assert station.mode(station.vehicle.kind.number(mode)) == OK
    assert station.command(400, 1) == OK
    return station


# Going to a place


def test_a_copter_reads_neither_speed_nor_yaw_of_a_reposition() -> None:
    station = Station()
    station.fly()
    assert reposition(station, 200.0, speed=2.0, yaw=math.pi / 2) == OK
    assert fastest(station, 10) > 9
    assert abs(station.vehicle.body.yaw) < 0.1


def test_a_speed_lasts_until_it_does_something_else_in_guided() -> None:
    station = Station()
    station.fly()
    assert station.command(SPEED, 1, 2.0) == OK
    assert reposition(station, 400.0) == OK  # from taking off to a place: the speed is lost
    assert fastest(station, 10) > 9
    assert station.command(SPEED, 1, 2.0) == OK
    station.pass_time(6)
    assert reposition(station, 600.0) == OK
    assert fastest(station, 5) == pytest.approx(2.0, abs=0.2)
    station.send(mav.MAVLink_param_set_message(1, 1, b"RTL_ALT", 2000, 6))
    assert fastest(station, 5) == pytest.approx(2.0, abs=0.2)
    assert station.mode(BRAKE) == OK
    assert station.command(SPEED, 1, 2.0) == FAILED
    assert station.command(SPEED, 1, 0.0) == DENIED


def test_a_copter_turns_to_where_it_goes_and_what_it_was_told_before_is_lost() -> None:
    station = Station(heading=90.0)
    station.fly()
    assert station.command(YAW, 180) == OK
    assert reposition(station, 100.0) == OK
    station.pass_time(5)
    assert abs(station.vehicle.body.yaw) < 0.1
    assert station.command(YAW, 180) == OK
    station.pass_time(5)
    assert abs(abs(station.vehicle.body.yaw) - math.pi) < 0.1
    assert station.command(YAW, -90) == FAILED
    assert station.command(YAW, 270) == OK


def test_a_rover_has_a_speed_only_on_its_way_to_a_place() -> None:
    station = ready("rover")
    assert station.command(SPEED, 1, 1.0) == FAILED
    assert reposition(station, 100.0, speed=1.0) == FAILED
    assert reposition(station, 100.0) == OK
    assert station.command(SPEED, 1, 1.0) == OK
    assert fastest(station, 8) == pytest.approx(1.0, abs=0.1)
    assert reposition(station, 120.0, speed=1.5) == OK
    assert fastest(station, 8) == pytest.approx(1.5, abs=0.1)
    assert station.command(YAW, 90) == UNSUPPORTED


def test_a_plane_has_an_airspeed_between_its_bounds_and_no_heading() -> None:
    station = ready("plane", Mode.TAKEOFF)
    station.until(lambda: -station.vehicle.body.d > 40, 60)
    assert station.command(SPEED, 0, 18.0) == FAILED
    assert station.mode(station.vehicle.kind.number(Mode.GUIDED)) == OK
    assert station.command(SPEED, 0, 5.0) == FAILED
    assert station.command(SPEED, 0, 18.0) == OK
    assert station.texts == ["Set airspeed 18 m/s"]
    station.pass_time(20)
    assert station.vehicle.body.airspeed == pytest.approx(18, abs=1)
    assert station.command(YAW, 90) == UNSUPPORTED


# Set-points


def attitude(station: Station, *, yaw: float = 0.0, pitch: float = 0.0, **more: Any) -> None:
    half = (yaw / 2, pitch / 2)
    cy, sy, cp, sp = math.cos(half[0]), math.sin(half[0]), math.cos(half[1]), math.sin(half[1])
    q = [part * more.get("length", 1.0) for part in (cp * cy, -sp * sy, sp * cy, cp * sy)]
    station.send(
        mav.MAVLink_set_attitude_target_message(
            0, 1, 1, more.get("mask", 7), q, 0, 0, 0, more.get("thrust", 0.5)
        )
    )


def test_the_yaw_of_an_attitude_is_absolute_and_thrust_is_a_rate_of_climb() -> None:
    station = Station(heading=90.0)
    station.fly()
    for _ in range(5):
        attitude(station, pitch=-0.2)
        station.pass_time(1)
    assert abs(station.vehicle.body.yaw) < 0.1
    assert -station.vehicle.body.d == pytest.approx(10, abs=1.5)
    for _ in range(4):
        attitude(station, thrust=1.0)
        station.pass_time(1)
    assert station.vehicle.body.vd == pytest.approx(-2.5, abs=0.3)


@pytest.mark.parametrize("wrong", [{"mask": 0b011}, {"mask": 64 | 7}, {"length": 1.1}])
def test_an_attitude_that_is_none_changes_nothing(wrong: dict[str, Any]) -> None:
    station = Station()
    station.fly()
    for _ in range(3):
        attitude(station, pitch=-0.3, **wrong)
        station.pass_time(1)
    assert fastest(station, 1) < 0.3


def test_an_attitude_that_is_not_repeated_leaves_it_level_and_drifting() -> None:
    station = Station(wind=(4.0, 0.0))
    station.fly()
    for _ in range(4):
        attitude(station, pitch=-0.3)
        station.pass_time(1)
    station.pass_time(40)
    body = station.vehicle.body
    assert abs(body.pitch) < 0.02
    assert body.vn == pytest.approx(4.0, abs=0.5)  # with the wind: it holds no place
    assert station.mode(BRAKE) == OK
    station.pass_time(6)
    assert math.hypot(body.vn, body.ve) < 0.2


# Parameters and plans


def test_an_integer_set_to_the_default_it_has_is_told_as_a_real_number() -> None:
    station = Station()

    def written(value: float) -> tuple[float, int]:
        (told,) = station.send(mav.MAVLink_param_set_message(1, 1, b"RTL_ALT", value, 6))
        return told.param_value, told.param_type

    assert written(1500) == (1500, REAL32)
    read = station.send(mav.MAVLink_param_request_read_message(1, 1, b"RTL_ALT", -1))[0]
    assert (read.param_value, read.param_type) == (1500, 6)
    assert written(1800) == (1800, 6)
    assert written(1500) == (1500, 6)  # stored now, and told with its type for good
    assert written(1500) == (1500, 6)


def test_a_fence_comes_back_in_the_absolute_frame() -> None:
    station = Station()
    lat, lon, _ = station.vehicle.origin
    corners = [
        item(n, 5001, p1=3, frame=frame, lat=lat + n * 1e-3, lon=lon + n % 2 * 1e-3, alt=7, kind=1)
        for n, frame in enumerate((3, 6, 3))
    ]
    assert upload(station, corners, 1) == 0
    back = [station.send(mav.MAVLink_mission_request_int_message(1, 1, n, 1))[0] for n in range(3)]
    assert [(m.frame, m.z, m.param1) for m in back] == [(0, 0, 3)] * 3
    assert [m.x for m in back] == [m.x for m in corners]


def test_a_crossed_fence_says_which_and_nothing_of_a_failsafe() -> None:
    for action, mode in ((1, Mode.RTL), (2, Mode.LAND), (4, Mode.BRAKE)):
        given = {"FENCE_RADIUS": 30, "FENCE_ENABLE": 1, "FENCE_ACTION": action}
        station = Station(parameters=given)
        station.fly()
        station.vehicle.flight.aim((80.0, 0.0), -10.0)
        station.until(lambda s=station, m=mode: s.vehicle.flight.mode is m)
        assert station.texts[-1] == "Circle fence breached"


# Without a position, without a ground station


def test_without_a_position_brake_is_refused_and_land_and_alt_hold_are_not() -> None:
    station = Station(parameters={"FS_EKF_ACTION": 0})
    station.fly()
    station.vehicle.params.set("SIM_GPS1_ENABLE", 0)
    station.pass_time(3)
    assert station.vehicle.flight.mode is Mode.GUIDED
    for mode in (BRAKE, LOITER, RTL):
        assert station.mode(mode) == FAILED
        assert station.texts[-1].endswith("failed: requires position")
    assert station.mode(ALT_HOLD) == OK
    assert station.mode(LAND) == OK
    station.until(lambda: not station.vehicle.armed, 60)
    assert station.mode(GUIDED) == OK
    assert station.command(400, 1) == FAILED
    assert station.texts == ["Arm: Need Position Estimate"]


def test_without_a_position_telemetry_says_the_last_place_and_no_speed() -> None:
    station = Station(parameters={"FS_EKF_ACTION": 0}, wind=(6.0, 0.0))
    station.fly()
    station.command(mav.MAV_CMD_SET_MESSAGE_INTERVAL, 33, 100_000)
    station.pass_time(1)
    before = station.last("GLOBAL_POSITION_INT")
    station.vehicle.params.set("SIM_GPS1_ENABLE", 0)
    station.pass_time(1)
    station.mode(ALT_HOLD)
    station.pass_time(20)
    assert station.vehicle.body.vn > 3
    after = station.last("GLOBAL_POSITION_INT")
    assert (after.vx, after.vy) == (0, 0)
    assert abs(after.lat - before.lat) < 100
    assert after.time_boot_ms > before.time_boot_ms


@pytest.mark.parametrize(
    ("given", "mode", "then"),
    [
        ({"FS_GCS_ENABLE": 0}, GUIDED, Mode.GUIDED),
        ({"FS_GCS_ENABLE": 1}, GUIDED, Mode.RTL),
        ({"FS_GCS_ENABLE": 5}, GUIDED, Mode.LAND),
        ({"FS_GCS_ENABLE": 7}, GUIDED, Mode.BRAKE),
        ({"FS_GCS_ENABLE": 1}, BRAKE, Mode.BRAKE),
        ({"FS_GCS_ENABLE": 1, "FS_OPTIONS": 0}, BRAKE, Mode.RTL),
        ({"FS_GCS_ENABLE": 1}, LAND, Mode.RTL),
        ({"FS_GCS_ENABLE": 1, "FS_OPTIONS": 8}, LAND, Mode.LAND),
    ],
)
def test_without_its_ground_station_it_does_what_its_parameters_say(
    given: dict[str, float], mode: int, then: Mode
) -> None:
    station = Station(parameters=given)
    station.fly(40.0)
    station.send(HEARTBEAT)
    assert station.mode(mode) == OK
    station.pass_time(7)
    assert station.vehicle.flight.mode is then


def test_without_its_ground_station_it_flies_on_to_its_last_place() -> None:
    station = Station()
    station.send(HEARTBEAT)
    station.fly()
    assert reposition(station, 150.0) == OK
    station.vehicle.faults.uplink_cut = True
    station.until(lambda: abs(station.vehicle.body.n - 150) < 1, 60)


# Ending it


def test_a_copter_that_is_terminated_or_disarmed_by_force_falls() -> None:
    for end in ((TERMINATE, 1), (400, 0, 21196)):
        station = Station()
        station.fly(20)
        assert station.command(TERMINATE, 0) == FAILED
        assert station.command(400, 0) == FAILED
        assert station.command(*end) == OK
        assert not station.vehicle.armed
        station.until(lambda s=station: s.vehicle.body.landed, 5)
        assert station.vehicle.body.impact > 10


@pytest.mark.parametrize("kind", ["plane", "rover", "boat"])
def test_others_are_not_terminated(kind: str) -> None:
    station = ready(kind)
    assert station.command(TERMINATE, 1) == FAILED
    assert station.texts == ["AFS not enabled, can't terminate the vehicle"]
    assert station.vehicle.armed


# What tests break


def test_a_link_is_cut_in_each_direction() -> None:
    station = Station()
    station.fly()
    faults = station.vehicle.faults
    faults.uplink_cut = True
    assert (
        station.send(mav.MAVLink_command_long_message(1, 1, 176, 0, 1, LAND, 0, 0, 0, 0, 0)) == []
    )
    assert station.vehicle.flight.mode is Mode.GUIDED
    station.pass_time(2)
    assert station.last("HEARTBEAT")
    faults.uplink_cut, faults.downlink_cut = False, True
    assert (
        station.send(mav.MAVLink_command_long_message(1, 1, 176, 0, 1, LAND, 0, 0, 0, 0, 0)) == []
    )
    station.pass_time(2)
    assert station.heard == []
    assert station.vehicle.flight.mode is Mode.LAND


def test_an_autopilot_that_hangs_answers_nothing_and_its_body_goes_on() -> None:
    station = Station(parameters={"FS_GCS_ENABLE": 1})
    station.fly(50)
    assert reposition(station, 500.0) == OK
    station.send(HEARTBEAT)
    station.pass_time(4)
    station.vehicle.faults.frozen = True
    where = station.vehicle.body.n
    assert station.send(HEARTBEAT) == []
    station.pass_time(3)
    assert station.heard == []
    assert station.vehicle.body.n > where + 15
    station.vehicle.faults.frozen = False
    station.pass_time(3)
    assert station.heard
    assert station.vehicle.flight.mode is Mode.RTL  # nobody was heard for too long meanwhile


@pytest.mark.parametrize(("how", "ages"), [("silent", None), ("stale", 0)])
def test_telemetry_stands_still_while_heartbeats_go_on(how: Any, ages: int | None) -> None:
    station = Station()
    station.fly()
    station.command(mav.MAV_CMD_SET_MESSAGE_INTERVAL, 33, 100_000)
    assert reposition(station, 200.0) == OK
    station.pass_time(2)
    before = station.last("GLOBAL_POSITION_INT")
    station.vehicle.faults.telemetry = how
    station.send(HEARTBEAT)
    station.pass_time(3)
    assert station.last("HEARTBEAT")
    received = [m for m in station.heard if m.get_type() == "GLOBAL_POSITION_INT"]
    if ages is None:
        assert received == []
    else:
        assert {m.time_boot_ms - before.time_boot_ms for m in received} == {ages}
        assert {m.lat for m in received} == {before.lat}
    station.vehicle.faults.telemetry = "live"
    station.pass_time(1)
    assert station.last("GLOBAL_POSITION_INT").time_boot_ms > before.time_boot_ms


def test_without_power_it_falls_and_still_counts_as_armed() -> None:
    station = Station()
    station.fly(20)
    station.vehicle.faults.powerless = True
    station.until(lambda: station.vehicle.body.landed, 5)
    assert station.vehicle.body.impact > 10
    assert station.vehicle.armed
