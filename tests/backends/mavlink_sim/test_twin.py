"""The twin behaves as the real ArduCopter was seen to."""

from __future__ import annotations

import math
from typing import Any

import pytest

from backends.mavlink_sim.station import Station
from rcp_mavlink_sim.modes import Mode
from rcp_mavlink_sim.wire import mav

OK, DENIED, UNSUPPORTED, FAILED = 0, 2, 3, 4
GUIDED, AUTO, LOITER, RTL, LAND = 4, 3, 5, 6, 9


def item(
    seq: int,
    command: int,
    *,
    frame: int = 6,
    p1: float = 0,
    lat: float = 0,
    lon: float = 0,
    alt: float = 0,
    kind: int = 0,
) -> Any:
    place = (round(lat * 1e7), round(lon * 1e7), alt)
    return mav.MAVLink_mission_item_int_message(
        1, 1, seq, frame, command, 0, 1, p1, 0, 0, 0, *place, kind
    )


def upload(station: Station, items: list, kind: int = 0) -> int:
    answers = station.send(mav.MAVLink_mission_count_message(1, 1, len(items), kind))
    for one in items:
        assert [m.get_type() for m in answers if m.get_type() != "STATUSTEXT"] == [
            "MISSION_REQUEST"
        ]
        answers = station.send(one)
    return next(m.type for m in answers if m.get_type() == "MISSION_ACK")


@pytest.mark.parametrize(
    ("seconds", "why"),
    [
        (0.1, "Arm: Gyros inconsistent"),
        (3, "Arm: AHRS: waiting for home"),
        (7, "Arm: Need Position Estimate"),
    ],
)
def test_it_says_why_it_cannot_be_armed_early(seconds: float, why: str) -> None:
    station = Station(warmup=10.0)
    station.pass_time(seconds)
    station.mode(GUIDED)
    assert station.command(400, 1) == FAILED
    assert station.texts == [why]


def test_the_prearm_bit_is_up_too_early_in_stabilize() -> None:
    station = Station(warmup=10.0)
    station.pass_time(6)
    bits = []
    for mode in (0, GUIDED):
        station.mode(mode)
        station.command(mav.MAV_CMD_REQUEST_MESSAGE, 1)
        health = station.last("SYS_STATUS").onboard_control_sensors_health
        bits.append(bool(health & mav.MAV_SYS_STATUS_PREARM_CHECK))
    assert bits == [True, False]


def test_refusals_are_those_of_the_real_one() -> None:
    station = Station()
    station.pass_time(1.2)
    assert station.mode(99) == FAILED
    assert station.texts == ["No such mode 99"]
    station.mode(LAND)
    assert station.command(400, 1) == FAILED
    assert station.texts == ["Arm: LAND mode not armable"]
    assert station.mode(AUTO) == OK
    assert station.command(400, 1) == FAILED
    assert station.texts == ["Arm: Mode requires mission"]
    station.mode(GUIDED)
    assert station.command(22, 0, 0, 0, 0, 0, 0, 10) == FAILED
    assert station.texts == []
    assert station.command(31999) == UNSUPPORTED
    assert station.command(192, -1, 0, 0, 0, -35, 149, 20) == UNSUPPORTED
    assert station.command(400, 1) == OK
    assert station.command(400, 1) == OK


def test_in_the_air_it_refuses_to_be_disarmed_or_to_take_off_again() -> None:
    station = Station()
    station.fly()
    assert station.command(400, 0) == FAILED
    assert station.command(22, 0, 0, 0, 0, 0, 0, 20) == FAILED
    assert station.texts == []
    assert station.command(400, 0, 21196) == OK
    station.until(lambda: station.vehicle.body.landed, 10)


def test_nothing_but_heartbeats_comes_unasked() -> None:
    station = Station()
    station.pass_time(1.5)
    del station.heard[:]
    station.pass_time(4)
    assert {m.get_type() for m in station.heard} == {"HEARTBEAT"}
    assert station.command(mav.MAV_CMD_SET_MESSAGE_INTERVAL, 30, 100_000) == OK
    assert station.command(mav.MAV_CMD_SET_MESSAGE_INTERVAL, 9999, 100_000) == FAILED
    station.pass_time(2)
    assert 18 <= sum(m.get_type() == "ATTITUDE" for m in station.heard) <= 22
    station.command(mav.MAV_CMD_SET_MESSAGE_INTERVAL, 30, -1)
    station.pass_time(2)
    assert {m.get_type() for m in station.heard} <= {"HEARTBEAT", "COMMAND_ACK"}


def test_a_flight_out_and_back_ends_disarmed_at_home() -> None:
    station = Station(wind=(3.0, -2.0))
    station.fly(10)
    home = station.vehicle.home
    assert home is not None
    body = station.vehicle.body
    assert body.d == pytest.approx(-10, abs=0.5)
    assert station.reposition(home[0] + 3e-4, home[1], 20) == OK
    took = station.until(lambda: station.vehicle.pilot.at_place(0.5))
    assert 4 < took < 20
    assert abs(body.n - 33.4) < 1
    assert station.mode(RTL) == OK
    station.until(lambda: not station.vehicle.armed)
    assert math.hypot(body.n, body.e) < 1
    assert body.landed
    assert 0.2 < body.impact < 0.8


def test_a_velocity_is_flown_and_ends_by_itself() -> None:
    station = Station()
    station.fly()
    body = station.vehicle.body

    def push() -> None:
        station.send(
            mav.MAVLink_set_position_target_local_ned_message(
                0, 1, 1, 1, 0x0DC7, 0, 0, 0, 4.0, 0, 0, 0, 0, 0, 0, 0
            )
        )

    for _ in range(4):
        push()
        station.pass_time(1)
    assert body.vn == pytest.approx(4, abs=0.5)
    assert abs(body.d + 10) < 1
    station.pass_time(8)
    assert math.hypot(body.vn, body.ve) < 0.2


def test_parameters_keep_their_types_and_unknown_ones_have_no_answer() -> None:
    station = Station()
    assert station.send(mav.MAVLink_param_request_read_message(1, 1, b"NO_SUCH", -1)) == []
    assert station.send(mav.MAVLink_param_set_message(1, 1, b"NO_SUCH", 1.0, 9)) == []
    other = station.send(mav.MAVLink_param_set_message(1, 1, b"RTL_ALT", 1800.0, 9))
    assert (other[0].param_value, other[0].param_type) == (1800, 6)
    right = station.send(mav.MAVLink_param_set_message(1, 1, b"RTL_ALT", 2000.4, 6))
    assert (right[0].param_value, right[0].param_type) == (2000, 6)
    station.send(mav.MAVLink_param_request_list_message(1, 1))
    station.pass_time(3)
    values = [m for m in station.heard if m.get_type() == "PARAM_VALUE"]
    assert len({m.param_id for m in values}) == values[0].param_count > 400


def test_a_mission_comes_back_normalised_and_is_flown() -> None:
    station = Station()
    station.pass_time(1.2)
    lat, lon, _ = station.vehicle.origin
    items = [
        item(0, 16, frame=0, lat=1, lon=2),
        item(1, 22, alt=12),
        item(2, 16, lat=lat + 2e-4, lon=lon, alt=15),
        item(3, 16, lat=lat + 2e-4, lon=lon + 2e-4, alt=15, p1=1),
        item(4, 20),
    ]
    assert upload(station, items) == 0
    assert "Flight plan received" in station.texts
    assert station.send(mav.MAVLink_mission_request_list_message(1, 1))[0].count == 5
    back = [station.send(mav.MAVLink_mission_request_int_message(1, 1, seq))[0] for seq in range(5)]
    assert [m.frame for m in back] == [0, 3, 3, 3, 3]
    assert (back[0].x, back[0].y) == (round(lat * 1e7), round(lon * 1e7))
    assert back[2].x == items[2].x
    station.mode(GUIDED)
    assert station.command(400, 1) == OK
    assert station.command(300) == OK
    del station.heard[:]
    station.until(lambda: not station.vehicle.armed, 200)
    reached = [m.seq for m in station.heard if m.get_type() == "MISSION_ITEM_REACHED"]
    assert reached == [1, 2, 3]
    assert station.texts[:3] == ["Mission: 1 Takeoff", "Reached command #1", "Mission: 2 WP"]


def test_on_the_ground_a_mission_must_begin_with_a_take_off() -> None:
    station = Station()
    station.pass_time(1.2)
    lat, lon, _ = station.vehicle.origin
    assert upload(station, [item(0, 16), item(1, 178, p1=1), item(2, 16, lat=lat, lon=lon)]) == 0
    assert station.command(300) == FAILED
    station.mode(AUTO)
    assert station.command(400, 1) == FAILED
    assert station.texts == ["Arm: AUTO mode not armable"]
    station.mode(GUIDED)
    assert station.command(400, 1) == OK
    assert station.mode(AUTO) == FAILED
    assert station.texts == ["Auto: Missing Takeoff Cmd"]
    assert station.command(300, 1) == DENIED


def test_a_mission_with_an_item_it_does_not_know_is_refused() -> None:
    station = Station()
    assert upload(station, [item(0, 16), item(1, 2999)]) == mav.MAV_MISSION_UNSUPPORTED
    # An ArduPilot has stored what came before it: home.
    assert [one.command for one in station.vehicle.flight.mission.plan.items] == [16]


def test_outside_the_fence_it_comes_back_and_a_target_there_is_refused() -> None:
    station = Station(parameters={"FENCE_RADIUS": 30, "FENCE_ENABLE": 1})
    station.fly()
    lat, lon, _ = station.vehicle.origin
    assert station.reposition(lat + 1e-3, lon, 10) == FAILED
    station.vehicle.flight.aim((80.0, 0.0), -10.0)
    station.until(lambda: station.vehicle.flight.mode is Mode.RTL)
    assert "Circle fence breached" in station.texts


def test_an_uploaded_polygon_fences_in() -> None:
    station = Station(parameters={"FENCE_ENABLE": 1})
    lat, lon, _ = station.vehicle.origin
    corners = [(-1, -1), (-1, 1), (1, 1), (1, -1)]
    items = [
        item(n, 5001, p1=4, lat=lat + a * 2e-4, lon=lon + b * 2e-4, kind=1)
        for n, (a, b) in enumerate(corners)
    ]
    assert upload(station, items, 1) == 0
    station.fly()
    assert station.reposition(lat + 1e-4, lon, 10) == OK
    assert station.reposition(lat + 3e-4, lon, 10) == FAILED


def test_without_its_station_it_comes_home_only_if_it_is_told_to() -> None:
    for enabled, mode in ((0, Mode.GUIDED), (1, Mode.RTL)):
        station = Station(parameters={"FS_GCS_ENABLE": enabled})
        station.send(mav.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
        station.fly()
        station.pass_time(7)
        assert station.vehicle.flight.mode is mode


def test_an_empty_battery_brings_it_home() -> None:
    station = Station(capacity=120.0, parameters={"BATT_FS_LOW_ACT": 2})
    station.fly(5)
    station.until(lambda: station.vehicle.flight.mode is Mode.RTL, 200)
    assert station.vehicle.battery.voltage < 10.6


def test_idle_on_the_floor_it_disarms_itself() -> None:
    station = Station()
    station.pass_time(1.2)
    station.mode(GUIDED)
    station.command(400, 1)
    assert 9 < station.until(lambda: not station.vehicle.armed) < 12


def test_a_reboot_forgets_what_is_not_stored() -> None:
    station = Station()
    station.pass_time(2)
    station.send(mav.MAVLink_param_set_message(1, 1, b"RTL_ALT", 2000, 6))
    assert station.command(246, 1) == OK
    assert station.vehicle.time < 1
    assert station.vehicle.params["RTL_ALT"] == 2000


def test_a_log_of_the_flight_is_downloaded_whole() -> None:
    station = Station()
    station.fly()
    station.mode(LAND)
    station.until(lambda: not station.vehicle.armed)
    entry = station.send(mav.MAVLink_log_request_list_message(1, 1, 0, 0xFFFF))[0]
    station.send(mav.MAVLink_log_request_data_message(1, 1, entry.id, 0, entry.size))
    station.pass_time(3)
    pieces = [m for m in station.heard if m.get_type() == "LOG_DATA"]
    data = b"".join(bytes(m.data[: m.count]) for m in pieces)
    assert data == bytes(station.vehicle.log.logs[entry.id])
    assert len(data) > 2000


def test_garbage_and_foreign_addresses_change_nothing() -> None:
    station = Station()
    station.pass_time(1.2)
    station.peer.feed(bytes(range(256)) * 5)
    assert station.send(mav.MAVLink_command_long_message(77, 1, 176, 0, 1, 4, 0, 0, 0, 0, 0)) == []
    assert station.mode(GUIDED) == OK


def test_only_what_is_signed_with_its_key_is_taken() -> None:
    station = Station(key=b"k" * 32)
    station.pass_time(1.2)
    arm = mav.MAVLink_command_long_message(1, 1, 176, 0, 1, GUIDED, 0, 0, 0, 0, 0)
    assert station.send(arm) == []
    station.mav.signing.secret_key, station.mav.signing.sign_outgoing = b"k" * 32, True
    station.mav.signing.timestamp = 2**47
    assert any(m.get_type() == "COMMAND_ACK" for m in station.send(arm))
