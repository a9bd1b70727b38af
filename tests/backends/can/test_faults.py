"""What goes wrong on a bus with motors: it is told by type, mended, and moves nothing."""

from __future__ import annotations

import asyncio
import struct
import time
from contextlib import suppress
from types import SimpleNamespace
from typing import Any

import anyio
import can
import pytest

from backends.can.rig import MOTORS, Node, motor
from rcp_can import views
from rcp_can.profiles.vesc import VescDrive, VescOptions
from rcp_can.sim import make_twin
from rcp_kernel.errors import AdapterUnavailable, DeviceTimeout, ModeForbids, QueueFull


async def test_bus_off_in_motion_ends_the_move_and_nothing_moves_when_the_bus_is_back() -> None:
    async with motor("odrive", velocity=2.0, bus={"restart": 0.3}) as rig:
        await rig.enable()
        moving = asyncio.ensure_future(rig.execute("action/m/move_to", {"position": 9.0}))
        await rig.until(lambda: rig.twin.plant.velocity > 1.0)
        with Node(rig.channel) as node:
            node.bus_off()
            with pytest.raises(AdapterUnavailable):
                await asyncio.wait_for(moving, 60)
            with pytest.raises(AdapterUnavailable, match="bus_off"):
                await rig.write("actuator/m/velocity", 1.0)
            await rig.host.published_as("sensor/can/can0/state", state="error_active")
            await rig.until(lambda: abs(rig.twin.plant.velocity) < 0.1)
            await asyncio.sleep(0.2)
            assert abs(rig.twin.plant.velocity) < 0.1
            events = [event.now for event in rig.host.events("event/can/can0/state")]
            assert events[-2:] == ["bus_off", "error_active"]


async def test_an_emergency_of_a_drive_that_goes_on_is_told_and_taken_back() -> None:
    async with motor("cia402") as rig:
        await rig.enable()
        await rig.ordered(lambda: rig.twin.send(0x085, b"\x10\x42\x01\0\0\0\0\0"))
        await rig.host.until(lambda: "emergency_4210" in rig.faults())
        event = next(e for e in rig.host.events("event/m/fault") if e.active)
        assert (event.code, event.text) == (0x4210, "device temperature (0x4210)")
        await rig.write("actuator/m/velocity", 1.0)  # a warning does not stop it
        await rig.ordered(lambda: rig.twin.send(0x085, bytes(8)))
        await rig.host.until(lambda: "emergency_4210" in rig.faults(active=False))


@pytest.mark.parametrize(
    ("on_silence", "becomes"),
    [("quick_stop", "quick_stop"), ("disable_voltage", "switch_on_disabled"), ("fault", "fault")],
)
async def test_a_canopen_drive_that_misses_the_gateway_stops_by_itself(
    on_silence: str, becomes: str
) -> None:
    async with motor("cia402", watchdog=0.2, options={"on_silence": on_silence}) as rig:
        await rig.enable()
        await rig.write("actuator/m/velocity", 2.0)
        await rig.until(lambda: rig.twin.plant.velocity > 1.0)
        rig.twin.deaf = True
        await rig.until(lambda: rig.twin.state == becomes)
        rig.twin.deaf = False
        await rig.host.until(lambda: "emergency_8130" in rig.faults())
        assert not rig.twin.enabled
        await rig.host.until(lambda: "reset" in rig.faults())
        (reset,) = (e for e in rig.host.events("event/m/fault") if e.fault == "reset")
        assert "left the NMT state operational (missed heartbeat, 0x8130)" in reset.text
        await rig.host.published_as("sensor/m/state", state="fault")
        with pytest.raises(ModeForbids, match="emergency_8130"):
            await rig.write("actuator/m/velocity", 2.0)
        await rig.until(lambda: abs(rig.twin.plant.velocity) < 0.1)
        await rig.until(lambda: rig.axis.configured)
        await rig.ran("service/m/clear_faults")
        assert not rig.twin.enabled


@pytest.mark.parametrize("profile", ["damiao", "cybergear", "moteus", "vesc"])
async def test_a_drive_with_a_watchdog_stops_when_the_gateway_is_gone(profile: str) -> None:
    async with motor(profile) as rig:
        await rig.enable()
        await rig.write("actuator/m/velocity", 2.0)
        await rig.until(lambda: rig.twin.plant.velocity > 1.0)
        rig.twin.deaf = True
        await rig.until(lambda: not rig.twin.enabled)


async def test_a_canopen_drive_that_boots_is_configured_anew() -> None:
    async with motor("cia402") as rig:
        await rig.ordered(rig.twin.boot)
        await rig.until(lambda: not rig.twin.operational)
        await rig.until(lambda: rig.twin.operational)
        await rig.enable()
        await rig.ran("action/m/move_to", {"position": 0.2})


async def test_a_frame_that_is_malformed_is_counted_and_upsets_nobody() -> None:
    async with motor("odrive") as rig:
        with Node(rig.channel) as node:
            node.send(1 << 5 | 0x09, b"\0\0\xc0\x7f\0\0\0\0")  # a position that is not a number
            node.send(1 << 5 | 0x01, b"\0")
            await rig.host.published_as("sensor/can/can0/statistics", malformed=2)
        assert rig.axis.online
        assert rig.axis.position == pytest.approx(0, abs=0.01)


@pytest.mark.parametrize("profile", ["cia402", "odrive"])
async def test_a_heart_that_stops_is_a_lost_drive_whatever_else_it_sends(profile: str) -> None:
    options = {"heartbeat": 200} if profile == "cia402" else {}
    async with motor(profile, velocity=2.0, options=options) as rig:
        await rig.enable()
        moving = asyncio.ensure_future(rig.execute("action/m/move_to", {"position": 9.0}))
        await rig.until(lambda: rig.twin.plant.velocity > 1.0)
        rig.twin.heartless = True
        with pytest.raises(AdapterUnavailable, match="heartbeat lost"):
            await asyncio.wait_for(moving, 60)
        assert "heartbeat_lost" in rig.faults()
        assert "heartbeat lost" in (rig.host.reports[-1] or "")
        told = len(rig.host.events("sensor/m/motion"))
        await rig.until(lambda: abs(rig.twin.plant.velocity) < 0.1)
        assert rig.axis.state == "offline"
        assert len(rig.host.events("sensor/m/motion")) == told  # so that it grows stale
        rig.twin.heartless = False
        await rig.host.until(lambda: "heartbeat_lost" in rig.faults(active=False))
        await rig.host.until(lambda: rig.host.reports[-1] is None)
        await asyncio.sleep(0.2)
        assert abs(rig.twin.plant.velocity) < 0.1
        await rig.enable()
        await rig.ran("action/m/move_to", {"position": rig.axis.position + 0.2})


@pytest.mark.parametrize("profile", ["cia402", "odrive", "mit", "moteus"])
async def test_a_second_drive_with_its_id_stops_it_and_it_is_not_enabled_until_that_is_gone(
    profile: str,
) -> None:
    table = MOTORS[profile]
    other = make_twin(profile, table["node"], **table.get("options", {}), serial=77)
    other.silent = True
    async with motor(profile, twins=[other], velocity=2.0) as rig:
        await rig.enable()
        await rig.write("actuator/m/velocity", 2.0)
        await rig.until(lambda: rig.twin.plant.velocity > 1.0)
        other.silent = False
        if profile == "cia402":  # two nodes are told apart by their answers, and none is asked now
            await rig.axis.drive.read("mode")
        await rig.host.until(lambda: "duplicate_node" in rig.faults())
        await rig.until(lambda: abs(rig.twin.plant.velocity) < 0.1)
        for call in (rig.write("actuator/m/velocity", 1.0), rig.execute("service/m/enable")):
            with pytest.raises(ModeForbids, match="two drives respond") as caught:
                await call
            assert "clear_faults" in caught.value.remedy
        await rig.ordered(lambda: setattr(other, "silent", True))
        with anyio.fail_after(60):
            while True:
                try:
                    await rig.execute("service/m/clear_faults")
                    await rig.execute("service/m/enable")
                    break
                except (AdapterUnavailable, ModeForbids):
                    await asyncio.sleep(0.02)  # what the second sent last is still on its way
        await rig.host.until(lambda: "duplicate_node" in rig.faults(active=False))
        await rig.write("actuator/m/velocity", 1.0)
        await rig.until(lambda: rig.twin.plant.velocity > 0.5)


async def test_another_master_that_asks_a_drive_is_no_second_drive() -> None:
    async with motor("cia402") as rig:
        with Node(rig.channel) as node:
            for index in (b"\x00\x10", b"\x41\x60"):
                node.send(0x605, b"\x40" + index + bytes(5))
                await node.hears(lambda m, i=index: m.arbitration_id == 0x585 and m.data[1:3] == i)
        await rig.enable()
        assert rig.faults() == []


@pytest.mark.parametrize("where", ["take", "poll", "command"])
async def test_an_error_in_a_profile_stops_its_motor_and_no_other(
    where: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    second = make_twin("vesc", 8)
    table = {"bus": "can0", "profile": "vesc", "node": 8}
    async with motor("odrive", twins=(second,), motors={"n": table}) as rig:
        await rig.enable()
        await rig.ran("service/n/enable")
        for name in "mn":
            await rig.write(f"actuator/{name}/velocity", 2.0)
        await rig.until(lambda: min(rig.twin.plant.velocity, second.plant.velocity) > 1.0)

        def fail(*_: object, **__: object) -> None:
            raise KeyError("a fault of the profile")

        monkeypatch.setattr(rig.axis.drive, where, fail)
        await rig.until(lambda: abs(rig.twin.plant.velocity) < 0.1)
        # Without what it takes it is blind, and soon silent: whichever is noticed first stops it.
        expected = {"feedback_lost", "heartbeat_lost"} if where == "take" else {"profile_failed"}
        await rig.host.until(lambda: not expected.isdisjoint(rig.faults()))
        assert second.plant.velocity > 1.0
        # What the log says of the fault may hold the event loop up for a moment.
        await rig.until(lambda: rig.backend.axes["n"].is_fresh("velocity"))
        assert rig.backend.axes["n"].goal == 2.0


@pytest.mark.parametrize("also", ["state", "health"])
async def test_a_motor_is_stopped_whatever_else_of_its_profile_fails(
    also: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    second = make_twin("vesc", 8)
    table = {"bus": "can0", "profile": "vesc", "node": 8}
    monkeypatch.setattr("rcp_can.motor_group._HEALTH", 0.02)
    async with motor("odrive", twins=(second,), motors={"n": table}) as rig:
        await rig.enable()
        await rig.ran("service/n/enable")
        for name in "mn":
            await rig.write(f"actuator/{name}/velocity", 2.0)
        await rig.until(lambda: min(rig.twin.plant.velocity, second.plant.velocity) > 1.0)
        real = getattr(views, also)

        def view(axis: Any) -> Any:
            if axis is rig.axis:
                raise KeyError("a fault of the profile")
            return real(axis)

        def fail(*_: object, **__: object) -> None:
            raise KeyError("a fault of the profile")

        monkeypatch.setattr(views, also, view)
        monkeypatch.setattr(rig.axis.drive, "command", fail)
        await rig.until(lambda: abs(rig.twin.plant.velocity) < 0.1)
        polls = list[int]()
        monkeypatch.setattr(rig.backend.axes["n"].drive, "poll", polls.append)
        await rig.until(lambda: len(polls) > 5)


async def test_a_motor_whose_questions_fail_comes_to_rest() -> None:
    async with motor("vesc", rate=200.0) as rig:
        await rig.enable()
        await rig.write("actuator/m/velocity", 2.0)
        await rig.until(lambda: rig.twin.plant.velocity > 1.0)

        def fail(*_: object) -> None:
            raise KeyError("a fault of the profile")

        rests, real = list[None](), rig.axis.rest
        rig.axis.rest = lambda: rests.append(real())
        rig.axis.drive.poll = fail
        await rig.host.until(lambda: "profile_failed" in rig.faults())
        await rig.until(lambda: bool(rests))  # the stop has ended, as it was seen to rest


async def test_a_motor_that_cannot_be_told_to_stop_is_not_said_to_be_stopped() -> None:
    async with motor("odrive") as rig:
        await rig.enable()
        moving = asyncio.ensure_future(rig.execute("action/m/move_to", {"position": 9.0}))
        await rig.until(lambda: rig.twin.plant.velocity > 0.2)

        def fail(*_: object, **__: object) -> None:
            raise KeyError("a fault of the profile")

        rig.axis.drive.stop = rig.axis.drive.poll = fail
        with pytest.raises(DeviceTimeout, match="stop could not be sent"):
            await asyncio.wait_for(moving, 60)


async def test_another_master_that_guards_a_drive_is_no_loss_of_its_configuration() -> None:
    async with motor("cia402") as rig:
        await rig.enable()
        await rig.write("actuator/m/velocity", 2.0)
        with Node(rig.channel) as node:
            resets = rig.axis.status.resets
            for toggled in (0x85, 0x05, 0x85):  # its answers to that master (CiA 301, 7.2.8.2.2)
                beat = rig.axis.status.beat
                node.send(0x705, bytes((toggled,)))
                await rig.until(lambda b=beat: rig.axis.status.beat > b)
        assert (rig.axis.status.resets, rig.faults()) == (resets, [])
        assert rig.axis.driven


@pytest.mark.parametrize("profile", ["odrive", "mit"])
async def test_a_bus_that_takes_no_frames_drops_the_set_point_and_nothing_leaps_after_it(
    profile: str,
) -> None:
    async with motor(profile, velocity=2.0, acceleration=20.0, timeout=1.0) as rig:
        await rig.enable()
        await rig.write("actuator/m/position", 9.0)
        await rig.until(lambda: rig.twin.plant.velocity > 1.0)
        with rig.jammed():
            await rig.host.until(lambda: "not_sent" in rig.faults())
            with pytest.raises((QueueFull, AdapterUnavailable)):
                await rig.write("actuator/m/position", 1.0)
        await rig.until(lambda: abs(rig.twin.plant.velocity) < 0.1)
        await rig.host.until(lambda: rig.axis.online)
        stood = rig.twin.plant.position
        await asyncio.sleep(0.3)
        assert abs(rig.twin.plant.position - stood) < 0.1
        assert rig.axis.mode in (None, "velocity")


async def test_an_action_whose_set_points_do_not_leave_ends_with_that_reason() -> None:
    async with motor("damiao", velocity=2.0, timeout=2.0) as rig:
        await rig.enable()
        moving = asyncio.ensure_future(rig.execute("action/m/move_to", {"position": 9.0}))
        await rig.until(lambda: rig.twin.plant.velocity > 1.0)
        with rig.jammed(), pytest.raises(QueueFull, match="accepts no frames"):
            await asyncio.wait_for(moving, 60)
        await rig.until(lambda: abs(rig.twin.plant.velocity) < 0.1)


async def test_a_full_send_queue_refuses_and_is_an_event() -> None:
    async with motor("odrive", bus={"queue": 4, "raw_send": True}) as rig:
        with rig.jammed():
            for number in range(
                5
            ):  # one is in the interface already, and the motor's are among them
                with suppress(QueueFull):
                    await rig.write("actuator/can/can0/frame", {"id": number})
            with pytest.raises(QueueFull):
                await rig.write("actuator/can/can0/frame", {"id": 9})
            await rig.host.until(lambda: rig.host.events("event/can/can0/overflow"))
        event = rig.host.last("event/can/can0/overflow")
        assert (event.queue, event.lost > 0) == ("send", True)
        await rig.host.until(lambda: rig.host.last("sensor/can/can0/statistics").queued == 0)
        assert rig.host.last("sensor/can/can0/statistics").refused >= 1
        await rig.enable()


async def test_a_receive_queue_that_overflows_is_an_event_and_the_motor_goes_on() -> None:
    async with motor("odrive", timeout=5.0) as rig:
        with Node(rig.channel) as node:
            for _ in range(18_000):
                node.send(0x7FF)
            end = time.monotonic() + 10
            wire = rig.backend.buses["can0"].wire
            while not wire.dropped and time.monotonic() < end:
                time.sleep(0.01)  # noqa: ASYNC251  # the loop is busy, as far as the reader can see
        event = await rig.host.published_as("event/can/can0/overflow", queue="receive")
        assert event.lost > 0
        await rig.enable()
        await rig.write("actuator/m/velocity", 1.0)
        await rig.until(lambda: rig.twin.plant.velocity > 0.5)


async def test_a_vesc_that_reboots_between_two_reports_does_not_turn_again() -> None:
    async with motor("vesc", timeout=2.0, feedback_timeout=2.0) as rig:
        await rig.enable()
        await rig.write("actuator/m/velocity", 8.0)
        await rig.until(lambda: rig.twin.plant.position > 15.0)
        assert rig.faults() == []
        await rig.ordered(rig.twin.boot)
        await rig.host.until(lambda: "reset" in rig.faults())
        assert rig.axis.state == "disabled"
        await rig.until(lambda: abs(rig.twin.plant.velocity) < 0.05)
        stood = rig.twin.plant.position
        await asyncio.sleep(0.2)
        assert abs(rig.twin.plant.position - stood) < 0.05
        await rig.ran("service/m/enable")


@pytest.mark.parametrize(("before", "after"), [(2**31 - 20, -(2**31) + 20), (50, -20), (-40, 40)])
def test_a_counter_of_a_vesc_that_wraps_or_turns_back_is_no_reboot(before: int, after: int) -> None:
    bus: Any = SimpleNamespace(shared=lambda _kind, make: make(bus), listen=lambda *_, **__: None)
    drive = VescDrive(7, VescOptions(), bus)
    for tachometer in (before, after):
        data = struct.pack(">ih", tachometer, 240)
        drive.status.velocity = 0.1 if abs(after - before) < 42 else 120.0
        drive.take(can.Message(arbitration_id=27 << 8 | 7, data=data))
    assert drive.status.resets == 0


async def test_a_vesc_that_was_turned_while_nothing_was_heard_of_it_has_not_rebooted() -> None:
    async with motor("vesc", timeout=0.3, feedback_timeout=0.3) as rig:
        rig.twin.silent = True
        await rig.host.until(lambda: "feedback_lost" in rig.faults())
        rig.twin.plant.position += 50.0  # by hand
        rig.twin.silent = False
        await rig.host.until(lambda: "feedback_lost" in rig.faults(active=False))
        await rig.until(lambda: rig.axis.position is not None and rig.axis.position > 40.0)
        assert rig.axis.status.resets == 0
        rig.axis.drive.lose()  # as when its settings were written
        rig.twin.plant.position -= 50.0
        await rig.until(lambda: rig.axis.position is not None and rig.axis.position < 40.0)
        assert rig.axis.status.resets == 0
