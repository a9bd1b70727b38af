"""What a copter with PX4 does otherwise than one with ArduPilot."""

from __future__ import annotations

import math
import struct
from typing import Any

import pytest

from backends.mavlink_sim.station import Station
from rcp_mavlink_sim.modes import Mode
from rcp_mavlink_sim.px4.flight import HOLD
from rcp_mavlink_sim.wire import mav

ACCEPTED, REJECTED, UNSUPPORTED = 0, 1, 3
NAN = math.nan
OFFBOARD, MISSION = (6, 0), (4, 4)


def ready(**options: Any) -> Station:
    station = Station(vehicle="px4", **options)
    station.pass_time(1.5)
    return station


def mode(station: Station, main: int, sub: int) -> int:
    return station.command(176, 1, main, sub)


def aloft(**options: Any) -> Station:
    station = ready(**options)
    assert station.command(400, 1) == ACCEPTED
    sea = station.vehicle.origin[2]
    assert station.command(22, NAN, 0, 0, NAN, NAN, NAN, sea + 15.0) == ACCEPTED
    station.until(lambda: station.vehicle.flight.mode is HOLD)
    return station


def velocity(station: Station, *parts: float, mask: int = 0) -> None:
    x, y, z = (NAN, NAN, NAN)
    station.send(
        mav.MAVLink_set_position_target_local_ned_message(
            0, 1, 1, 1, mask, x, y, z, *parts, NAN, NAN, NAN, NAN, NAN
        )
    )


def stream(station: Station, seconds: float, *parts: float) -> None:
    for _ in range(round(seconds / 0.1)):
        velocity(station, *parts)
        station.pass_time(0.1)


def test_a_take_off_counts_from_the_sea_and_ends_in_hold() -> None:
    station = aloft()
    assert -station.vehicle.body.d == pytest.approx(15.0, abs=0.6)
    assert station.command(400, 0) == REJECTED
    assert "Disarming denied: not landed" in station.texts


def test_it_follows_the_course_of_a_target_above_home_and_no_other_vehicle() -> None:
    station = aloft(parameters={"FLW_TGT_HT": 12.0, "FLW_TGT_DST": 10.0, "FLW_TGT_FA": 180.0})
    vehicle = station.vehicle
    lat, lon = (round(angle * 1e7) for angle in vehicle.origin[:2])
    assert mode(station, 4, 8) == ACCEPTED
    station.mav.srcSystem = 9
    for _ in range(20):
        station.send(
            mav.MAVLink_global_position_int_message(0, lat + 3000, lon, 0, 0, 0, 0, 0, 65535)
        )
        station.pass_time(0.2)
    assert vehicle.body.n == pytest.approx(0.0, abs=0.5)
    station.mav.srcSystem = 255
    sea, zero = vehicle.origin[2] + 50.0, (0.0, 0.0, 0.0)
    for step in range(100):  # to the east, whatever its attitude says
        message = mav.MAVLink_follow_target_message(
            0, 1 | 2 | 8, lat, lon + round(step * 0.2 * 90 / math.cos(lat / 1e7 * math.pi / 180)),
            sea, (0.0, 1.0, 0.0), zero, (1.0, 0.0, 0.0, 0.0), zero, zero, 0,
        )  # fmt: skip
        station.send(message)
        station.pass_time(0.2)
    assert -vehicle.body.d == pytest.approx(12.0, abs=1.0)
    assert vehicle.body.n == pytest.approx(0.0, abs=1.0)
    assert vehicle.body.e == pytest.approx(20.0 - 10.0, abs=2.5), "it is behind its course"


def test_a_gimbal_turns_for_who_controls_it() -> None:
    station = ready()
    assert station.command(1000, -20.0, 0.0, NAN, NAN, 0, 0, 1) == 2, "denied"
    assert station.command(1001, 255, 190, -1, -1, 0, 0, 1) == ACCEPTED
    assert station.command(1000, -20.0, 0.0, NAN, NAN, 0, 0, 1) == ACCEPTED


def test_offboard_needs_set_points_before_and_all_the_time() -> None:
    station = aloft()
    vehicle = station.vehicle
    assert mode(station, *OFFBOARD) == REJECTED
    assert "Switching to mode 'Offboard' is currently not available"[:50] in station.texts
    for _ in range(4):  # one a second is too slow
        velocity(station, 1.0, 0.0, 0.0)
        station.pass_time(1.0)
    velocity(station, 1.0, 0.0, 0.0)
    assert mode(station, *OFFBOARD) == REJECTED
    stream(station, 1.0, 2.0, 0.0, 0.0)
    assert mode(station, *OFFBOARD) == ACCEPTED
    stream(station, 3.0, 2.0, 0.0, 0.0)
    assert vehicle.body.vn == pytest.approx(2.0, abs=0.4), "NaN is what is not set"
    station.pass_time(1.5)
    assert vehicle.flight.mode is Mode.LOITER, "COM_OBL_RC_ACT 0 is the position mode"
    assert "Failsafe activated: No offboard signal" in station.texts


def test_a_place_is_gone_to_by_either_command_and_nowhere_is_where_it_is() -> None:
    station = aloft()
    vehicle = station.vehicle
    lat, lon, sea = vehicle.origin
    north = lat + 20 / 111_319.49
    assert station.command(192, 3.0, 0, 0, NAN, north, lon, sea + 15) == UNSUPPORTED
    assert station.command(192, 3.0, 1, 0, 1.0, north, lon, sea + 15) == ACCEPTED
    fastest = 0.0
    while vehicle.body.n < 19:
        station.pass_time(0.1)
        fastest = max(fastest, vehicle.body.vn)
    assert fastest < 3.6, "it takes the speed with the target"
    assert vehicle.body.yaw == pytest.approx(1.0, abs=0.1)
    assert station.reposition(lat + 1e-2, lon, 15.0, flags=1) == ACCEPTED
    station.pass_time(3)
    assert station.command(192, -1, 1, 0, NAN, NAN, NAN, NAN) == ACCEPTED
    station.pass_time(6)
    assert abs(vehicle.body.vn) < 0.3


def test_a_parameter_keeps_its_type_and_an_integer_is_in_the_bits() -> None:
    station = ready()
    number = struct.unpack("<f", struct.pack("<i", -7))[0]
    name = b"COM_FLTMODE1"
    told = station.send(mav.MAVLink_param_set_message(1, 1, name, number, 6))
    assert struct.unpack("<i", struct.pack("<f", told[-1].param_value))[0] == -7
    assert station.vehicle.params["COM_FLTMODE1"] == -7
    assert not station.send(mav.MAVLink_param_set_message(1, 1, name, 3.0, 9)), "another type"
    assert not station.send(mav.MAVLink_param_set_message(1, 1, b"WPNAV_SPEED", 3.0, 9))
    assert station.vehicle.params["COM_FLTMODE1"] == -7
    listed = station.send(mav.MAVLink_param_request_list_message(1, 1))
    assert listed[0].param_id == "_HASH_CHECK"


def test_a_mission_has_no_home_and_no_heights_above_the_ground() -> None:
    station = aloft()

    def sent(frame: int, seq: int = 0) -> list[Any]:
        lat, lon, _ = station.vehicle.origin
        place = (round(lat * 1e7) + 2000, round(lon * 1e7), 15.0)
        return station.send(
            mav.MAVLink_mission_item_int_message(
                1, 1, seq, frame, 16, 0, 1, 0, 0, 0, NAN, *place, 0
            )
        )

    count = mav.MAVLink_mission_count_message(1, 1, 1, 0)
    assert station.send(count)[-1].get_type() == "MISSION_REQUEST_INT"
    assert sent(11)[-1].type == mav.MAV_MISSION_UNSUPPORTED_FRAME
    assert mode(station, *MISSION) == REJECTED
    station.send(count)
    assert sent(6)[-1].type == mav.MAV_MISSION_ACCEPTED
    assert station.send(mav.MAVLink_mission_request_list_message(1, 1, 0))[-1].count == 1
    back = station.send(mav.MAVLink_mission_request_int_message(1, 1, 0, 0))[-1]
    assert (back.frame, back.z) == (6, 15.0)
    assert mode(station, *MISSION) == ACCEPTED
    station.until(lambda: station.vehicle.flight.mode is HOLD)
    assert station.last("MISSION_ITEM_REACHED").seq == 0
    assert station.command(512, 42) == ACCEPTED
    current = station.last("MISSION_CURRENT")
    assert (current.seq, current.total, current.mission_state) == (0, 1, 5)


def test_what_only_an_ardupilot_has_it_does_not() -> None:
    station = ready()
    for command in (115, 193, 42424):  # CONDITION_YAW, DO_PAUSE_CONTINUE, a compass calibration
        assert station.command(command, 0) == UNSUPPORTED
    for message in (136, 168, 193):  # TERRAIN_REPORT, WIND, EKF_STATUS_REPORT
        assert station.command(512, message) != ACCEPTED
    station.pass_time(3)
    sent = {m.get_type() for m in station.heard}
    assert {"ATTITUDE", "GLOBAL_POSITION_INT", "HOME_POSITION"} <= sent, "it asks for no request"
