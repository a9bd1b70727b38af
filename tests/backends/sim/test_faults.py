"""Each fault does what it says, for as long as it says, and no more."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from rcp_kernel.errors import AdapterUnavailable, DeviceRejected, DeviceTimeout, InvalidValue
from rcp_sim.faults import FaultBoard, unknown_target
from rcp_sim.messages import FaultSpec

pytestmark = pytest.mark.anyio
HERE = {"position": {"x": 3.0, "y": 1.0}}


def seen(rig: Any) -> list[tuple[str, bool]]:
    return [(event.fault, event.active) for event in rig.host.samples["event/fault"][1:]]


async def test_a_stopped_sensor_is_silent_alone_and_comes_back(rig: Any) -> None:
    await rig.fault(fault="sensor_stop", target="sensor/imu", seconds=1.0)
    before = {name: rig.host.count(name) for name in ("sensor/imu", "sensor/pose")}
    rig.tick(0.9)
    assert rig.host.count("sensor/imu") == before["sensor/imu"]
    assert rig.host.count("sensor/pose") == before["sensor/pose"] + 45
    with pytest.raises(DeviceTimeout, match="sensor/imu"):
        await rig.backend.read("sensor/imu")
    await rig.backend.read("sensor/pose")
    rig.tick(1)
    assert rig.host.count("sensor/imu") > before["sensor/imu"]
    assert seen(rig) == [("sensor_stop", True), ("sensor_stop", False)]
    assert rig.host.reports == [("sensor/imu has stopped", False), (None, False)]


async def test_all_sensors_can_stop_at_once(rig: Any) -> None:
    await rig.fault(fault="sensor_stop")
    counts = {name: rig.host.count(name) for name in rig.host.samples if name.startswith("sensor")}
    async with rig.backend.watch("sensor/scan", None):
        rig.tick(2)
    assert all(rig.host.count(name) == count for name, count in counts.items())
    assert rig.host.count("sensor/scan") == 0


async def test_a_refusing_rover_refuses_but_never_a_stop(rig: Any) -> None:
    await rig.drive(0.5)
    await rig.fault(fault="refuse")
    with pytest.raises(DeviceRejected, match="refuses actuator/cmd_vel"):
        await rig.drive(0.8)
    with pytest.raises(DeviceRejected, match="refuses action/move_to"):
        await rig.execute("action/move_to", HERE)
    with pytest.raises(DeviceRejected, match="refuses param/speed_limit"):
        await rig.write("param/speed_limit", 0.5)
    await rig.drive(0.0)
    rig.tick(1)
    assert rig.sim.rover.at_rest
    await rig.backend.halt()
    await rig.execute("service/clear_faults")
    await rig.drive(0.8)


async def test_a_slow_rover_answers_late(rig: Any) -> None:
    await rig.fault(fault="slow", delay=0.5, target="param/speed_limit")
    started = rig.device.uptime
    await rig.settle(rig.write("param/speed_limit", 0.7))
    assert 0.5 <= rig.device.uptime - started < 0.6
    assert rig.sim.limit == 0.7
    await rig.drive(0.1)
    assert rig.host.reports == [("param/speed_limit responds 0.5 s late", False)]


async def test_a_lost_link_carries_nothing_and_returns(rig: Any) -> None:
    await rig.drive(0.5)
    rig.tick(1)
    await rig.fault(fault="link_lost", seconds=2.0)
    counts = {name: rig.host.count(name) for name in rig.host.samples}
    for request in (
        rig.drive(0.0),
        rig.execute("action/move_to", HERE),
        rig.backend.read("sensor/pose"),
        rig.backend.halt(),
    ):
        with pytest.raises(AdapterUnavailable, match="link"):
            await request
    rig.tick(1.9)
    assert {name: rig.host.count(name) for name in rig.host.samples} == counts
    assert rig.sim.rover.v == 0.5  # the drive is dumb: only a stop stops it
    rig.tick(0.2)
    assert rig.host.count("sensor/pose") > counts["sensor/pose"]
    await rig.drive(0.0)
    assert rig.host.reports == [("the link to the rover is lost", True), (None, False)]


async def test_a_drive_ends_when_the_link_is_lost(rig: Any) -> None:
    drive = await rig.begin(rig.execute("action/move_to", HERE))
    await rig.fault(fault="link_lost")
    with pytest.raises(AdapterUnavailable, match="stopped by itself"):
        await rig.turn(drive, seconds=1)
    rig.tick(9)
    assert rig.sim.rover.at_rest
    rig.tick(2)
    assert rig.host.reports[-1] == (None, False)


async def test_the_answer_passes_the_link_before_it_breaks(rig: Any) -> None:
    injected = await rig.execute("service/inject_fault", {"fault": "link_lost"})
    assert [spec.fault for spec in injected.active] == ["link_lost"]
    assert rig.host.reports == []
    await rig.backend.read("sensor/pose")
    rig.tick(0.06)
    assert rig.host.reports == [("the link to the rover is lost", True)]


async def test_a_link_that_breaks_while_a_slow_answer_waits_is_lost_too(rig: Any) -> None:
    await rig.fault(fault="slow", delay=1.0)
    late = await rig.begin(rig.write("param/speed_limit", 0.7), seconds=0.2)
    await rig.fault(fault="link_lost")
    with pytest.raises(AdapterUnavailable):
        await rig.turn(late, seconds=2)
    assert rig.sim.limit == 1.0


async def test_lost_stops_leave_the_rover_driving(rig: Any) -> None:
    await rig.drive(0.5)
    rig.tick(1)
    await rig.fault(fault="stop_lost", count=2)
    for stop in (rig.drive(0.0), rig.backend.halt()):
        unanswered = await rig.begin(stop)
        with pytest.raises(DeviceTimeout, match="was lost"):
            await rig.turn(unanswered, seconds=2)
    assert rig.sim.rover.v == 0.5
    await rig.drive(0.0)
    rig.tick(1)
    assert rig.sim.rover.at_rest
    assert rig.device.faults.active == []


async def test_faults_can_be_there_from_the_start(make_rig: Callable[..., Any]) -> None:
    rig = make_rig(faults=(FaultSpec("sensor_stop", "sensor/imu"),))
    rig.tick(1)
    assert rig.host.count("sensor/imu") == 1  # the first value of all
    assert rig.host.reports == [("sensor/imu has stopped", False)]
    left = await rig.execute("service/clear_faults", {"fault": "slow"})
    assert [spec.fault for spec in left.active] == ["sensor_stop"]


async def test_a_target_that_is_none_is_named(rig: Any) -> None:
    with pytest.raises(InvalidValue, match="sensor/nose") as caught:
        await rig.fault(fault="sensor_stop", target="sensor/nose")
    assert caught.value.details == {"pointer": "/target"}
    assert unknown_target(FaultSpec("link_lost", "sensor/pose")) is not None


def test_a_new_fault_of_the_same_kind_takes_the_place_of_the_old() -> None:
    board = FaultBoard()
    board.inject(FaultSpec("slow", delay=1.0, seconds=5), 0.0)
    board.inject(FaultSpec("slow", delay=2.0), 1.0)
    assert board.expire(100.0) == []
    assert board.delay("sensor/pose") == 2.0
    assert len(board.clear()) == 1
    assert board.troubles() is None
