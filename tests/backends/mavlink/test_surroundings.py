"""What surrounds a flight: other aircraft, motors' speed controllers, corrections, counters, the remote control."""

from __future__ import annotations

import asyncio
import base64
import math
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from backends.mavlink.flying import armed, on_the_ground
from backends.mavlink.puppet import PX4, Puppet, station
from backends.mavlink.test_equipment import error
from backends.mavlink.test_gateway import Pilot, flying
from backends.mavlink.test_px4 import px4
from rcp_gateway.testing import eventually
from rcp_mavlink.corrections import pieces
from rcp_mavlink.dialect import dialect
from rcp_mavlink_sim.adsb import Sighting
from rcp_mavlink_sim.gnss_corrections import GnssCorrections

CALIBRATE = "/tenant/t/action/calibrate"
GO_ON = "service/calibrate/continue"


async def _is(value: bool) -> bool:  # noqa: FBT001 - the one thing that it is about
    return value


@pytest.fixture
async def pilot() -> AsyncIterator[Pilot]:
    async with flying(silence=10.0) as found:
        on_the_ground(found.vehicle)
        await found.ready()
        yield found


# Aircraft


async def test_aircraft_nearby_are_told_with_what_they_tell_of_themselves(pilot: Pilot) -> None:
    assert await pilot.read("sensor/traffic") == []
    liner = Sighting(0x4CA2D3, "RYR12AB", 47.1, 8.2, 3500.0, math.pi / 2, 120.0, -5.0, emitter=3)
    glider = Sighting(0x3D0001, "", 47.0, 8.0, 900.0, emitter=9, flags=0b0000_0011, squawk=0)
    pilot.vehicle.adsb.aircraft = [liner, glider]
    id_ = await pilot.client.subscribe("/tenant/t/sensor/traffic")
    while len(found := (await pilot.client.update(id_))["body"]) < 2:
        pass
    heard = {one["id"]: one for one in found}
    first = heard["4ca2d3"]
    assert first.pop("age") < 30.0
    assert first.pop("velocity") == pytest.approx({"x": 120.0, "y": 0.0, "z": -5.0}, abs=0.01)
    assert first == {
        "callsign": "RYR12AB", "kind": "large", "latitude": 47.1, "longitude": 8.2,
        "altitude": 3500.0, "altitude_by": "satellites", "squawk": "7000", "id": "4ca2d3",
    }  # fmt: skip
    second = heard["3d0001"]
    assert (second["kind"], second["altitude"]) == ("glider", 900.0)
    assert second["callsign"] is second["velocity"] is second["squawk"] is None


async def test_an_aircraft_that_was_heard_long_ago_is_left_out() -> None:
    puppet = Puppet()

    def tell() -> None:
        for address, ago in ((1, 2), (2, 31)):
            puppet.send(
                "ADSB_VEHICLE", address, 470000000, 80000000, 0, 100_000, 0, 0, 0, b"A", 1, ago, 1, 0
            )  # fmt: skip

    puppet.also.append(tell)
    async with station(puppet) as found:

        async def told() -> bool:
            return [one["id"] for one in await found.read("sensor/traffic")] == ["000001"]

        await eventually(told, "one of them is told")
        puppet.also.clear()


# Speed controllers


async def test_speed_controllers_tell_of_their_motors(pilot: Pilot) -> None:
    pilot.vehicle.params.set("SIM_ESC_TELEM", 0)
    silent = await pilot.client.request("read", "/tenant/t/sensor/escs")
    assert error(silent) in ("device_rejected", "device_timeout")
    pilot.vehicle.params.set("SIM_ESC_TELEM", 1)
    still = await pilot.read("sensor/escs")
    assert [one["motor"] for one in still] == [1, 2, 3, 4]
    assert {one["velocity"] for one in still} == {0.0}
    armed(pilot.vehicle)
    id_ = await pilot.client.subscribe("/tenant/t/sensor/escs")
    while (one := (await pilot.client.update(id_))["body"][0])["velocity"] == 0.0:
        pass
    assert one["velocity"] == pytest.approx(900 * math.tau / 60)
    assert one["voltage"] == pytest.approx(pilot.vehicle.battery.voltage, abs=0.5)
    assert (one["temperature"], one["errors"]) == (29.0, None)


ESCS = """<?xml version="1.0"?>
<mavlink>
  <include>common.xml</include>
  <messages>
    <message id="290" name="ESC_INFO">
      <description>ESC information for lower rate streaming.</description>
      <field type="uint8_t" name="index">Index of the first ESC in this message.</field>
      <field type="uint64_t" name="time_usec" units="us">Timestamp.</field>
      <field type="uint16_t" name="counter">Counter of data packets.</field>
      <field type="uint8_t" name="count">Total number of ESCs.</field>
      <field type="uint8_t" name="connection_type">Connection type.</field>
      <field type="uint8_t" name="info">Online and offline, a bit each.</field>
      <field type="uint16_t[4]" name="failure_flags">Failure flags.</field>
      <field type="uint32_t[4]" name="error_count">Number of errors since boot.</field>
      <field type="int16_t[4]" name="temperature" units="cdegC">INT16_MAX: unknown.</field>
    </message>
    <message id="291" name="ESC_STATUS">
      <description>ESC information for higher rate streaming.</description>
      <field type="uint8_t" name="index">Index of the first ESC in this message.</field>
      <field type="uint64_t" name="time_usec" units="us">Timestamp.</field>
      <field type="int32_t[4]" name="rpm" units="rpm">Motor speed.</field>
      <field type="float[4]" name="voltage" units="V">Voltage.</field>
      <field type="float[4]" name="current" units="A">Current.</field>
    </message>
  </messages>
</mavlink>
"""
"""As in MAVLink's own definitions; pymavlink 2.4.50 has neither."""


async def test_those_of_a_px4_that_are_offline_are_left_out(tmp_path: Path) -> None:
    path = tmp_path / "escs.xml"
    path.write_text(ESCS)
    puppet = Puppet(autopilot=PX4, mav=(await asyncio.to_thread(dialect, str(path))).module)
    puppet.results[512] = lambda _: 0

    def tell() -> None:
        for index, errors, heat in ((0, 7, 4100), (4, 9, 32767), (8, 0, 0)):  # a batch each
            info = (index, 0, 0, 9, 0, 0b1111_1101, [0] * 4, [errors, 0, 0, 0], [heat, 0, 0, 0])
            puppet.send("ESC_INFO", *info)
            puppet.send("ESC_STATUS", index, 0, [6000, 0, -6000, 0], [12.0] * 4, [3.0] * 4)

    puppet.also.append(tell)
    async with station(puppet, dialect=str(path)) as found:
        told = {one["motor"]: one for one in await found.read("sensor/escs")}
        assert sorted(told) == [1, 3, 4, 5, 6, 7, 8, 9]
        assert (told[1]["errors"], told[1]["temperature"]) == (7, 41.0)
        assert (told[5]["errors"], told[5]["temperature"]) == (9, None)
        assert told[3]["velocity"] == pytest.approx(-200 * math.pi)


class Controllers(Puppet):
    """The controllers of some groups of motors, as an ArduPilot tells of them."""

    def __init__(self, *firsts: int) -> None:
        super().__init__()
        self.firsts = firsts
        self.results[512] = lambda command: 0 if 11030 <= command.param1 <= 11044 else 3
        self.also.append(self._tell)

    def _tell(self) -> None:
        for first in self.firsts:
            each = [[20] * 4, [1200] * 4, [100] * 4, [5] * 4, [600] * 4, [1, 2, 3, 0]]
            self.send(f"ESC_TELEMETRY_{first}_TO_{first + 3}", *each)


async def test_motors_that_begin_with_the_fifth_are_told_too() -> None:
    async with station(Controllers(5)) as found:
        told = await found.read("sensor/escs")
        assert [one["motor"] for one in told] == [5, 6, 7]  # the eighth has never reported
        assert told[0]["velocity"] == pytest.approx(20 * math.pi)


async def test_controllers_that_fall_silent_are_left_out() -> None:
    puppet = Controllers(1, 5)
    async with station(puppet) as found:
        id_ = await found.client.subscribe("/tenant/t/sensor/escs")
        while len(told := (await found.client.update(id_))["body"]) < 6:
            pass
        puppet.firsts = (1,)
        while len(told) > 3:
            told = (await found.client.update(id_))["body"]
        assert [one["motor"] for one in told] == [1, 2, 3]


# Corrections


@pytest.mark.parametrize("length", [6, 179, 180, 181, 360, 539, 540, 719, 720])
def test_a_correction_arrives_whole(length: int) -> None:
    receiver = GnssCorrections()
    data = bytes(n % 251 for n in range(length))
    for flags, count, piece in pieces(data, 31):
        receiver.take(mav.MAVLink_gps_rtcm_data_message(flags, count, list(piece)))
    assert receiver.received == [data]


def test_a_correction_that_lost_a_piece_does_not_arrive() -> None:
    receiver, data = GnssCorrections(), bytes(400)
    whole = [list(pieces(data, sequence)) for sequence in (1, 2)]
    for flags, count, piece in (*whole[0][:1], *whole[0][2:], *whole[1]):
        receiver.take(mav.MAVLink_gps_rtcm_data_message(flags, count, list(piece)))
    assert receiver.received == [data]


async def test_corrections_reach_the_receiver_and_bad_ones_are_refused(pilot: Pilot) -> None:
    sent = [bytes([0xD3, 0, n]) + bytes(200) for n in range(3)]
    for data in sent:
        body = {"data": base64.b64encode(data).decode()}
        reply = await pilot.client.request(
            "write", "/tenant/t/actuator/gnss_corrections", body=body
        )
        assert reply["status"] == "completed", reply
    receiver = pilot.vehicle.corrections
    await eventually(lambda: _is(receiver.received == sent), "they arrive")
    body = {"data": base64.b64encode(bytes(721)).decode()}
    long = await pilot.client.request("write", "/tenant/t/actuator/gnss_corrections", body=body)
    assert error(long) in ("invalid_value", "out_of_range")


# Counters


async def test_it_tells_how_long_it_has_flown(pilot: Pilot) -> None:
    pilot.vehicle.params.set("STAT_FLTTIME", 3600)
    flown = await pilot.do("service/flight_statistics")
    assert flown["body"]["flight_time"] == 3600.0
    assert flown["body"]["boots"] == 2  # the table begins with one
    assert flown["body"]["flights"] is None


async def test_a_px4_counts_in_two_halves() -> None:
    async with px4() as (found, puppet):
        counted = {"LND_FLIGHT_T_HI": 1, "LND_FLIGHT_T_LO": -2, "COM_FLIGHT_UUID": 12}
        puppet.params |= {name: (float(value), 6) for name, value in counted.items()}
        found.robot.parameters.forget()  # the first list may have been whole already
        await found.robot.parameters.list()
        flown = await found.do("service/flight_statistics")
        assert flown["body"]["flight_time"] == pytest.approx((2**33 - 2) / 1e6)
        assert (flown["body"]["flights"], flown["body"]["boots"]) == (12, None)


# The remote control


async def asked(pilot: Pilot, id_: str, step: str) -> None:
    while True:
        reply = await pilot.client.reply(id_, 30.0)
        assert reply["status"] in ("accepted", "in_progress"), reply
        if (reply.get("body") or {}).get("position") == step:
            return


async def seen(pilot: Pilot, channel: int, pulse: int) -> None:
    """Wait until the gateway has received a pulse."""
    vehicle = pilot.served.life.backend.robots[""].vehicle

    async def known() -> bool:
        frame: Any = vehicle.latest.get("RC_CHANNELS")
        return frame is not None and frame.fields()[f"chan{channel}_raw"] == pulse

    await eventually(known, "the pulse is seen")


async def moved(pilot: Pilot, *channels: int) -> None:
    """Move sticks to both of their ends and back."""
    pulses = pilot.vehicle.sticks.pulses
    for channel in channels:
        for pulse in (1050, 1950, 1500):
            pulses[channel - 1] = pulse
            await seen(pilot, channel, pulse)


async def test_a_remote_control_is_calibrated_while_its_sticks_are_moved(pilot: Pilot) -> None:
    params = pilot.vehicle.params
    id_ = await pilot.client.send(type="execute", path=CALIBRATE, body={"what": "radio"})
    await asked(pilot, id_, "middle")
    assert (await pilot.do(GO_ON))["body"]["position"] == "middle"
    await asked(pilot, id_, "ends")
    await moved(pilot, 1, 2, 3, 4, 7)
    assert params["RC1_MIN"] == 1100, "nothing is written before"
    await pilot.do(GO_ON)
    final = await pilot.client.final(id_, 30.0)
    assert final["status"] == "completed", final
    assert len(final["body"]["texts"]) == 15
    for channel in (1, 2, 3, 4, 7):
        assert (params[f"RC{channel}_MIN"], params[f"RC{channel}_MAX"]) == (1050, 1950)
    assert (params["RC1_TRIM"], params["RC3_TRIM"]) == (1500, 1050)
    assert params["RC5_MIN"] == 1100, "it was not moved"


async def test_one_that_completes_with_a_stick_held_says_that_it_cannot_be_armed(
    pilot: Pilot,
) -> None:
    id_ = await pilot.client.send(type="execute", path=CALIBRATE, body={"what": "radio"})
    await asked(pilot, id_, "middle")
    await pilot.do(GO_ON)
    await asked(pilot, id_, "ends")
    await moved(pilot, 1, 2, 3, 4)
    pilot.vehicle.sticks.pulses[3] = 1940
    await seen(pilot, 4, 1940)
    await pilot.do(GO_ON)
    final = await pilot.client.final(id_, 30.0)
    assert final["status"] == "completed", final
    assert "refuses to arm until its sticks are let go" in final["body"]["texts"][-1]
    assert pilot.vehicle.calibrations.radio


async def test_a_rover_has_two_sticks_and_its_throttle_rests_in_the_middle() -> None:
    async with flying({"vehicle": "rover"}, silence=10.0) as pilot:
        params = pilot.vehicle.params
        id_ = await pilot.client.send(type="execute", path=CALIBRATE, body={"what": "radio"})
        await asked(pilot, id_, "middle")
        await pilot.do(GO_ON)
        await asked(pilot, id_, "ends")
        await moved(pilot, 1, 3)
        await pilot.do(GO_ON)
        final = await pilot.client.final(id_, 30.0)
        assert final["status"] == "completed", final
        assert (params["RC3_MIN"], params["RC3_MAX"], params["RC3_TRIM"]) == (1050, 1950, 1500)
        assert len(final["body"]["texts"]) == 6, "and it can be armed"


@pytest.mark.parametrize("why", ["still", "armed", "cancelled"])
async def test_a_calibration_of_the_remote_control_that_fails_writes_nothing(
    pilot: Pilot, why: str
) -> None:
    params = pilot.vehicle.params
    before = {name: params[name] for name in params.listed() if name.startswith("RC")}
    id_ = await pilot.client.send(type="execute", path=CALIBRATE, body={"what": "radio"})
    await asked(pilot, id_, "middle")
    await pilot.do(GO_ON)
    await asked(pilot, id_, "ends")
    await moved(pilot, 1, 2, 3)
    if why == "still":
        await pilot.do(GO_ON)
    elif why == "armed":
        pilot.vehicle.begin_armed("Arming motors")  # forced by somebody else
    else:
        await pilot.client.request("cancel", CALIBRATE)
    final = await pilot.client.final(id_, 30.0)
    if why == "cancelled":
        assert final["status"] == "cancelled"
    else:
        assert error(final) == {"still": "device_rejected", "armed": "precondition_failed"}[why]
    if why == "still":
        assert "yaw" in final["message"]
    assert {name: params[name] for name in before} == before
    assert error(await pilot.do(GO_ON)) == "precondition_failed"


async def test_a_remote_control_that_is_off_or_that_of_a_px4_is_not_calibrated(
    pilot: Pilot,
) -> None:
    pilot.vehicle.params.set("SIM_RC_FAIL", 1)
    await eventually(lambda: _is(pilot.vehicle.failsafes.radio_lost), "it is lost")
    off = await pilot.do("action/calibrate", {"what": "radio"})
    assert error(off) == "adapter_unavailable"
    async with px4() as (found, _):
        other = await found.do("action/calibrate", {"what": "radio"})
        assert error(other) == "unsupported_operation"
