"""A sample carries the time at which it was measured, by the vehicle's clock beside ours."""

from __future__ import annotations

import time
from datetime import datetime
from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from backends.mavlink.puppet import Puppet, station
from rcp_gateway.testing import eventually
from rcp_mavlink.clock import Clock
from rcp_mavlink.dialect import dialect
from rcp_mavlink.frames import Frame

DIALECT = dialect("ardupilotmega")
LATE = 0.4  # s


def attitude(ms: int) -> Frame:
    payload = ms.to_bytes(4, "little") + bytes(24)
    return Frame(DIALECT.by_name["ATTITUDE"], 1, 1, payload, b"")


async def test_samples_are_as_old_as_the_vehicle_says() -> None:
    puppet = Puppet()

    def sync(message: Any) -> None:
        if message.tc1 == 0:
            puppet.send("TIMESYNC", puppet.clock * 1_000_000, message.ts1)

    def attitude_of_before() -> None:
        puppet.send("ATTITUDE", puppet.clock - round(LATE * 1e3), 0.1, 0, 0, 0, 0, 0)

    puppet.on["TIMESYNC"] = sync
    puppet.also.append(attitude_of_before)
    async with station(puppet) as found:
        id_ = await found.client.subscribe("/tenant/t/sensor/attitude")

        async def is_late() -> bool:
            update = await found.client.update(id_)
            return LATE - 0.1 < time.time() - _seconds(update["timestamp"]) < LATE + 1.0

        await eventually(is_late, "the time is that of the measurement")


def _seconds(stamp: Any) -> float:
    if isinstance(stamp, int | float):
        return stamp / 1e9
    return datetime.fromisoformat(stamp).timestamp()


@given(booted=st.integers(1, 10**9), took=st.lists(st.integers(0, 10**8), min_size=1, max_size=5))
def test_an_answer_is_right_to_half_the_way_it_took(booted: int, took: list[int]) -> None:
    now = start = time.time_ns()
    clock = Clock(lambda: now)
    for way in took:
        asked = clock.request()
        now += way
        clock.on_reply(booted * 1_000_000 + now - start, asked)
    at = clock.of(attitude(booted + (now - start) // 1_000_000))
    assert at is not None
    assert abs(at - now) <= max(took) / 2 + 1_000_000  # the frame has milliseconds


def test_without_timesync_its_own_date_counts_and_nonsense_does_not() -> None:
    clock = Clock()
    assert clock.of(attitude(5000)) is None
    now = time.time_ns()
    clock.on_system_time(now // 1000, 10_000)
    at = clock.of(attitude(9_000))
    assert at is not None
    assert abs(now - 1_000_000_000 - at) < 10_000_000
    assert clock.of(attitude(20_000)) <= time.time_ns(), "nothing comes from the future"  # type: ignore[operator]
    clock.on_system_time(1_600_000_000_000_000, 10_000)
    assert clock.of(attitude(10_000)) is None, "a clock that is years off tells nothing"
    clock.forget()
    assert clock.of(attitude(9_000)) is None


def test_the_place_of_the_time_is_that_of_pymavlink() -> None:
    for name in ("ATTITUDE", "GPS_RAW_INT", "RAW_IMU", "GLOBAL_POSITION_INT", "VIBRATION"):
        definition = DIALECT.by_name[name]
        assert definition.stamp is not None
        place, size, _ = definition.stamp
        payload = bytes(place) + (123_456).to_bytes(size, "little")
        fields = definition.fields_of(payload.ljust(definition.size, b"\0"))
        assert fields.get("time_boot_ms", fields.get("time_usec")) == 123_456, name
    assert DIALECT.by_name["HEARTBEAT"].stamp is None


async def _is(truth: bool) -> bool:  # noqa: FBT001 - for `eventually`, which awaits
    return truth
