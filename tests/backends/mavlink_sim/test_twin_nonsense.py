"""Whatever a ground station sends, the twin answers and stays a vehicle."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from backends.mavlink_sim.station import Station
from rcp_mavlink_sim.commands import KNOWN
from rcp_mavlink_sim.kinds import KINDS
from rcp_mavlink_sim.modes import Mode
from rcp_mavlink_sim.plans import MISSION_COMMANDS
from rcp_mavlink_sim.wire import mav

_STATIONS: dict[str, Station] = {}
_TRIES = 80

numbers = st.floats(width=32) | st.sampled_from([0.0, 1.0, -1.0, math.nan, math.inf, 1e30, 4.0])
whole = st.integers(-(2**31), 2**31 - 1)
commands = st.sampled_from(sorted(KNOWN - {246})) | st.integers(0, 65535).filter(lambda n: n != 246)
kinds = st.sampled_from(sorted(KINDS))


def moving(kind: str) -> Station:
    """Return a vehicle on its way; one of each kind is used until it is no vehicle any more."""
    station = _STATIONS.get(kind) or Station(vehicle=kind)
    _STATIONS[kind] = station
    vehicle = station.vehicle
    station.pass_time(1.2)
    vehicle.params.set("FENCE_ENABLE", 0)
    vehicle.flight.set_mode(Mode.GUIDED)
    vehicle.arm(21196.0)
    if vehicle.kind.flies and vehicle.body.landed:
        vehicle.body.landed, vehicle.body.d, vehicle.body.vn = False, -30.0, 15.0
        vehicle.pilot.spinning = True
        vehicle.pilot.hold()
    return station


def check(station: Station) -> None:
    station.pass_time(1)
    b = station.vehicle.body
    values = (b.n, b.e, b.d, b.vn, b.ve, b.vd, b.roll, b.pitch, b.yaw, b.p, b.q, b.r)
    sound = all(map(math.isfinite, values)) and max(map(abs, values[3:6])) < 200
    if not sound:
        _STATIONS.clear()
    assert sound, values
    for number in (1, 30, 32, 33, 42, 62, 74, 85, 147, 162, 242):
        station.command(512, number)


@settings(max_examples=_TRIES)
@given(kind=kinds, number=commands, params=st.lists(numbers, min_size=7, max_size=7))
def test_every_command_is_acknowledged_once(kind: str, number: int, params: list[float]) -> None:
    station = moving(kind)
    heard = station.send(mav.MAVLink_command_long_message(1, 1, number, 0, *params))
    acks = [m for m in heard if m.get_type() == "COMMAND_ACK"]
    assert [m.command for m in acks] == [number]
    check(station)


@settings(max_examples=_TRIES)
@given(kind=kinds, number=commands, p=st.lists(numbers, min_size=5, max_size=5), x=whole, y=whole, frame=st.integers(0, 255))  # fmt: skip
def test_every_command_with_a_place_is_acknowledged_once(
    kind: str, number: int, p: list[float], x: int, y: int, frame: int
) -> None:
    station = moving(kind)
    heard = station.send(
        mav.MAVLink_command_int_message(1, 1, frame, number, 0, 0, *p[:4], x, y, p[4])
    )
    assert [m.command for m in heard if m.get_type() == "COMMAND_ACK"] == [number]
    check(station)


@settings(max_examples=_TRIES)
@given(kind=kinds, frame=st.integers(0, 21), mask=st.integers(0, 65535), v=st.lists(numbers, min_size=11, max_size=11))  # fmt: skip
def test_no_set_point_makes_it_leave_the_world(
    kind: str, frame: int, mask: int, v: list[float]
) -> None:
    station = moving(kind)
    station.send(mav.MAVLink_set_position_target_local_ned_message(0, 1, 1, frame, mask, *v))
    station.send(mav.MAVLink_set_attitude_target_message(0, 1, 1, 0, v[:4], *v[4:8]))
    check(station)


@settings(max_examples=_TRIES)
@given(
    kind=kinds,
    given_=st.lists(
        st.tuples(
            st.sampled_from(sorted(MISSION_COMMANDS)), st.integers(0, 21),
            st.tuples(numbers, numbers, numbers, numbers), whole, whole, numbers,
        ),
        min_size=1, max_size=4,
    ),
)  # fmt: skip
def test_no_mission_makes_it_leave_the_world(kind: str, given_: list[Any]) -> None:
    station = moving(kind)
    items = [(16, 0, (0.0,) * 4, 0, 0, 0.0), *given_]
    station.send(mav.MAVLink_mission_count_message(1, 1, len(items), 0))
    for seq, (command, frame, params, x, y, z) in enumerate(items):
        station.send(
            mav.MAVLink_mission_item_int_message(
                1, 1, seq, frame, command, 0, 1, *params, x, y, z, 0
            )
        )
    station.send(mav.MAVLink_mission_clear_all_message(1, 1, 1))
    station.vehicle.flight.set_mode(Mode.AUTO)
    station.pass_time(2)
    station.send(mav.MAVLink_mission_request_list_message(1, 1, 0))
    for seq in range(len(items)):
        station.send(mav.MAVLink_mission_request_int_message(1, 1, seq, 0))
    check(station)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e38])
def test_no_parameter_makes_it_leave_the_world(value: float) -> None:
    for kind in KINDS:
        station = moving(kind)
        names = list(station.vehicle.params.listed())
        for name in names:
            station.send(mav.MAVLink_param_set_message(1, 1, name.encode(), value, 9))
        del _STATIONS[kind]
        check(station)
