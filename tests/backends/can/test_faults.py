"""What goes wrong on a bus with motors: it is told by type, mended, and moves nothing."""

from __future__ import annotations

import asyncio

import pytest

from backends.can.rig import Node, motor
from rcp_kernel.errors import AdapterUnavailable, ModeForbids


async def test_bus_off_in_motion_ends_the_move_and_nothing_moves_when_the_bus_is_back() -> None:
    async with motor("odrive", velocity=2.0, bus={"restart": 0.3}) as rig:
        await rig.enable()
        moving = asyncio.ensure_future(rig.execute("action/m/move_to", {"position": 9.0}))
        await rig.until(lambda: rig.twin.plant.velocity > 1.0)
        with Node(rig.channel) as node:
            node.bus_off()
            with pytest.raises(AdapterUnavailable):
                await asyncio.wait_for(moving, 3)
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


async def test_a_canopen_drive_that_misses_the_gateway_stops_by_itself() -> None:
    async with motor("cia402", options={"watchdog": 200}) as rig:
        await rig.enable()
        await rig.write("actuator/m/velocity", 2.0)
        await rig.until(lambda: rig.twin.plant.velocity > 1.0)
        rig.twin.deaf = True
        await rig.until(lambda: rig.twin.state == "fault")
        rig.twin.deaf = False
        await rig.host.until(lambda: "emergency_8130" in rig.faults())
        assert not rig.twin.enabled
        await rig.host.published_as("sensor/m/state", state="fault")
        with pytest.raises(ModeForbids, match="emergency_8130"):
            await rig.write("actuator/m/velocity", 2.0)


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
