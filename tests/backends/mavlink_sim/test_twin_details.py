"""Files, sticks, noise and failsafes of the twin are those of the real one."""

from __future__ import annotations

import math
import statistics
import struct
from typing import Any

import pytest

from backends.mavlink_sim.station import Station
from backends.mavlink_sim.test_twin import item, upload
from rcp_mavlink_sim.modes import Mode
from rcp_mavlink_sim.wire import mav

ACK, NAK = 128, 129
END, OPEN, READ, LIST, CREATE, WRITE, REMOVE, BURST = 1, 4, 5, 3, 6, 7, 8, 15
NOT_FOUND, EOF = 10, 6
GUIDED, LOITER, ALT_HOLD, STABILIZE = 4, 5, 2, 0
IGNORED = 65535


class Files:
    """Requests of MAVLink FTP, counted up."""

    def __init__(self, station: Station) -> None:
        self.station = station
        self.number = 0

    def send(
        self, opcode: int, data: bytes = b"", *, offset: int = 0, size: int | None = None
    ) -> list[Any]:
        self.number += 2
        length = len(data) if size is None else size
        head = struct.pack("<HBBBBBxI", self.number, 0, opcode, length, 0, 0, offset)
        payload = list((head + data).ljust(251, b"\0"))
        heard = self.station.send(mav.MAVLink_file_transfer_protocol_message(0, 1, 1, payload))
        return [m for m in heard if m.get_type() == "FILE_TRANSFER_PROTOCOL"]

    def ask(self, opcode: int, data: bytes = b"", **more: Any) -> tuple[int, bytes]:
        return self.read(self.send(opcode, data, **more)[0])

    @staticmethod
    def read(message: Any) -> tuple[int, bytes]:
        payload = bytes(message.payload)
        return payload[3], payload[12 : 12 + payload[4]]


def test_a_file_that_was_written_is_listed_read_and_removed() -> None:
    files = Files(Station())
    assert files.ask(CREATE, b"/APM/scripts/a.lua") == (ACK, b"")
    content = bytes(range(200)) * 3
    for at in range(0, len(content), 200):
        assert files.ask(WRITE, content[at : at + 200], offset=at) == (ACK, b"")
    assert files.ask(END)[0] == ACK
    assert files.ask(LIST, b"APM/scripts") == (ACK, b"Fa.lua\t600\0")
    assert files.ask(OPEN, b"APM/scripts/a.lua") == (ACK, struct.pack("<I", 600))
    assert files.ask(READ, offset=590, size=100) == (ACK, content[590:])
    assert files.ask(READ, offset=600, size=100) == (NAK, bytes([EOF]))
    files.ask(END)
    assert files.ask(REMOVE, b"APM/scripts/a.lua") == (ACK, b"")
    assert files.ask(OPEN, b"APM/scripts/a.lua") == (NAK, bytes([NOT_FOUND]))


def test_a_burst_brings_the_parameters_whole() -> None:
    station = Station()
    files = Files(station)
    (size,) = struct.unpack("<I", files.ask(OPEN, b"@PARAM/param.pck")[1])
    files.send(BURST, size=239)
    station.pass_time(2)
    replies = [m for m in station.heard if m.get_type() == "FILE_TRANSFER_PROTOCOL"]
    parts = [Files.read(m) for m in replies]
    assert parts[-1] == (NAK, bytes([EOF]))
    data = b"".join(part for opcode, part in parts if opcode == ACK)
    assert len(data) == size
    assert struct.unpack("<HHH", data[:6]) == (0x671B, *[len(station.vehicle.params)] * 2)


def test_a_request_that_is_sent_again_is_not_done_again() -> None:
    files = Files(Station())
    files.ask(CREATE, b"APM/x")
    first = files.ask(REMOVE, b"APM/x")
    files.number -= 2
    assert files.ask(REMOVE, b"APM/x") == first == (ACK, b"")
    assert files.ask(REMOVE, b"APM/x") == (NAK, bytes([NOT_FOUND]))


@pytest.mark.parametrize("payload", [b"", b"\xff" * 251, bytes(range(251))])
def test_requests_of_nonsense_are_refused(payload: bytes) -> None:
    station = Station()
    padded = list(payload.ljust(251, b"\0"))
    station.send(mav.MAVLink_file_transfer_protocol_message(0, 1, 1, padded))
    assert Files(station).ask(LIST)[0] == ACK


def override(station: Station, *pulses: int) -> None:
    channels = [*pulses, *([IGNORED] * (8 - len(pulses)))]
    station.send(mav.MAVLink_rc_channels_override_message(1, 1, *channels))


def test_it_is_flown_by_hand_in_loiter_and_holds_when_let_go() -> None:
    station = Station()
    station.fly()
    station.mode(LOITER)
    body = station.vehicle.body
    for _ in range(8):
        override(station, 1500, 1300, 1700, 1500)
        station.pass_time(0.5)
    assert body.vn > 2
    assert -body.d > 11
    height = -body.d
    station.pass_time(10)
    assert math.hypot(body.vn, body.ve) < 0.2
    assert -body.d < height + 5  # it climbs on until the sticks count as let go


def test_manual_control_takes_it_off_in_alt_hold() -> None:
    station = Station()
    station.pass_time(1.2)
    station.mode(ALT_HOLD)
    assert station.command(400, 1) == 0
    for _ in range(10):
        station.send(mav.MAVLink_manual_control_message(1, 0, 0, 800, 0, 0))
        station.pass_time(0.5)
    assert -station.vehicle.body.d > 3


def test_sticks_of_another_ground_station_move_nothing() -> None:
    station = Station()
    station.fly()
    station.mode(LOITER)
    station.mav.srcSystem = 99
    override(station, 1900, 1100, 1900)
    station.pass_time(2)
    assert math.hypot(station.vehicle.body.vn, station.vehicle.body.ve) < 0.2


def test_sensors_are_noisy_by_a_seed() -> None:
    def pressures(**options: Any) -> list[float]:
        station = Station(**options)
        station.command(mav.MAV_CMD_SET_MESSAGE_INTERVAL, 29, 50_000)
        station.pass_time(5)
        return [m.press_abs for m in station.heard if m.get_type() == "SCALED_PRESSURE"]

    first, again, other, quiet = (
        pressures(seed=1), pressures(seed=1), pressures(seed=2), pressures(noise=0.0),
    )  # fmt: skip
    assert first == again != other
    assert 0.005 < statistics.pstdev(first) < 0.1
    assert statistics.pstdev(quiet) == 0


def test_without_gps_it_lands_and_says_why() -> None:
    station = Station()
    station.fly()
    station.vehicle.params.set("SIM_GPS1_ENABLE", 0)
    station.until(lambda: station.vehicle.flight.mode is Mode.LAND, 10)
    assert "EKF Failsafe" in station.texts
    station.until(lambda: not station.vehicle.armed, 60)


def test_without_its_transmitter_it_comes_home() -> None:
    station = Station()
    station.fly()
    station.vehicle.params.set("SIM_RC_FAIL", 1)
    station.until(lambda: station.vehicle.flight.mode is Mode.RTL, 10)
    assert "Radio Failsafe" in station.texts
    station.command(mav.MAV_CMD_SET_MESSAGE_INTERVAL, 1, 100_000)
    station.pass_time(1)
    status, beat = station.last("SYS_STATUS"), station.last("HEARTBEAT")
    assert not status.onboard_control_sensors_health & mav.MAV_SYS_STATUS_SENSOR_RC_RECEIVER
    assert beat.system_status == mav.MAV_STATE_CRITICAL


def test_an_almost_empty_battery_lands_it_whatever_it_does() -> None:
    given = {"BATT_FS_LOW_ACT": 2, "BATT_FS_CRT_ACT": 1, "BATT_CRT_VOLT": 10.2}
    station = Station(capacity=100.0, parameters=given)
    station.fly(20)
    station.until(lambda: station.vehicle.flight.mode is Mode.LAND, 200)
    assert any(text.startswith("Battery 1 is critical") for text in station.texts)


def test_it_returns_to_a_rally_point_that_is_nearer_than_home() -> None:
    station = Station()
    station.fly()
    lat, lon, _ = station.vehicle.origin
    assert upload(station, [item(0, 5100, frame=3, lat=lat + 4e-4, lon=lon, kind=2)], 2) == 0
    station.reposition(lat + 5e-4, lon, 10)
    station.until(lambda: station.vehicle.pilot.at_place(1.0), 60)
    station.command(20)
    station.until(lambda: not station.vehicle.armed, 120)
    assert station.vehicle.body.n == pytest.approx(44.5, abs=2)


def test_status_says_what_is_used_and_what_is_well() -> None:
    station = Station()
    station.pass_time(1.5)
    station.command(mav.MAV_CMD_REQUEST_MESSAGE, 1)
    before = station.last("SYS_STATUS")
    motors, fence = mav.MAV_SYS_STATUS_SENSOR_MOTOR_OUTPUTS, mav.MAV_SYS_STATUS_GEOFENCE
    assert not before.onboard_control_sensors_enabled & (motors | fence)
    station.vehicle.params.set("FENCE_ENABLE", 1)
    station.fly()
    station.command(mav.MAV_CMD_REQUEST_MESSAGE, 1)
    after = station.last("SYS_STATUS")
    assert after.onboard_control_sensors_enabled & motors
    assert after.onboard_control_sensors_enabled & fence
    station.command(mav.MAV_CMD_REQUEST_MESSAGE, 0)
    flags = station.last("HEARTBEAT").base_mode
    assert flags & mav.MAV_MODE_FLAG_GUIDED_ENABLED
    assert flags & mav.MAV_MODE_FLAG_SAFETY_ARMED


def test_its_gimbal_is_managed_and_takes_its_time() -> None:
    station = Station()
    station.pass_time(1.5)
    assert station.command(512, mav.MAVLINK_MSG_ID_GIMBAL_MANAGER_INFORMATION) == 0
    manager = station.last("GIMBAL_MANAGER_INFORMATION")
    assert math.degrees(manager.pitch_min) == pytest.approx(-90)
    assert station.command(1001, -2, -2, -1, -1) == 0
    assert station.vehicle.mount.control == (255, 190)
    assert station.command(1000, -45, 30) == 0
    pitches = []
    for _ in range(30):
        station.pass_time(0.05)
        pitches.append(station.vehicle.mount.pitch)
    assert sum(-45 < pitch < 0 for pitch in pitches) > 2
    assert pitches[-1] == -45
    station.command(512, mav.MAVLINK_MSG_ID_GIMBAL_DEVICE_ATTITUDE_STATUS)
    w, _, y, _ = station.last("GIMBAL_DEVICE_ATTITUDE_STATUS").q
    assert w > 0
    assert y < -0.3


def test_a_picture_is_told_of() -> None:
    station = Station()
    station.pass_time(1.5)
    assert station.command(2000, 0, 0, 1, 1) == 0
    assert station.last("CAMERA_FEEDBACK").img_idx == 1
    assert station.command(512, mav.MAVLINK_MSG_ID_CAMERA_CAPTURE_STATUS) == 0
    assert station.last("CAMERA_CAPTURE_STATUS").image_count == 1


def test_a_mission_with_numbers_that_are_none_is_refused() -> None:
    station = Station()
    nan = math.nan
    assert upload(station, [item(0, 16), item(1, 22, alt=nan)]) == mav.MAV_MISSION_INVALID_PARAM7
    assert upload(station, [item(0, 16), item(1, 16, p1=nan)]) == mav.MAV_MISSION_INVALID_PARAM1
    far = item(1, 16, lat=120)
    assert upload(station, [item(0, 16), far]) == mav.MAV_MISSION_INVALID_PARAM5_X


def test_its_only_id_is_the_long_one_as_of_ardupilot() -> None:
    station = Station()
    station.command(mav.MAV_CMD_REQUEST_MESSAGE, mav.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
    version = station.last("AUTOPILOT_VERSION")
    assert (version.vendor_id, version.product_id, version.uid) == (0, 0, 0)
    assert any(version.uid2)
