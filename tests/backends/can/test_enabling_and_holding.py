"""Power and torque come and go as they are asked for, and no further."""

from __future__ import annotations

import asyncio

import pytest

from backends.can.rig import MOTORS, motor
from backends.can.stopping import stays_at_rest, turns
from rcp_can.axis_state import Loss
from rcp_kernel.errors import (
    AdapterUnavailable,
    DeviceRejected,
    ModeForbids,
)

every_profile = pytest.mark.parametrize("profile", MOTORS)


@every_profile
async def test_clearing_faults_of_a_healthy_turning_drive_leaves_it_turning(profile: str) -> None:
    async with motor(profile, valid_for=20.0) as rig:
        await turns(rig)
        slowest: list[float] = []
        await rig.ran("service/m/clear_faults")
        for _ in range(60):
            slowest.append(rig.twin.plant.velocity)
            await asyncio.sleep(0.005)
        assert min(slowest) > 1.0
        assert rig.axis.state == "enabled"
        assert rig.faults() == []


@pytest.mark.parametrize("profile", ["cia402", "odrive", "damiao", "cybergear", "moteus"])
async def test_an_enable_that_does_not_last_is_no_enable(profile: str) -> None:
    async with motor(profile) as rig:
        enabling = asyncio.ensure_future(rig.execute("service/m/enable"))
        await rig.until(lambda: rig.twin.enabled)
        await rig.ordered(rig.twin.break_down)
        with pytest.raises(DeviceRejected):
            await asyncio.wait_for(enabling, 60)
        assert rig.axis.state == "fault"


async def test_an_enable_in_which_contact_is_lost_does_not_blame_the_drive() -> None:
    async with motor("odrive") as rig:
        enabling = asyncio.ensure_future(rig.execute("service/m/enable"))
        await rig.until(lambda: rig.axis.wanted_on)
        rig.axis._lose(Loss("feedback_lost", "no message received for 0.5 s"))  # noqa: SLF001 - contact is lost between two steps, which no frame can time
        rig.axis.online = True  # and it is back before anybody looks
        with pytest.raises(AdapterUnavailable, match=r"no message received for 0.5 s"):
            await asyncio.wait_for(enabling, 60)
        await stays_at_rest(rig)


@pytest.mark.parametrize("profile", ["cia402", "damiao"])
async def test_an_enable_that_a_stop_cuts_off_leaves_the_drive_without_torque(profile: str) -> None:
    async with motor(profile) as rig:
        for late in range(6):
            enabling = asyncio.ensure_future(rig.execute("service/m/enable"))
            await asyncio.sleep(0.004 * late)
            halting = asyncio.ensure_future(rig.backend.halt())
            enabling.cancel()
            await asyncio.wait((enabling,), timeout=60)
            await asyncio.wait_for(halting, 60)
            await asyncio.sleep(0.1)
            assert rig.twin.state != "enabled" if profile == "cia402" else True
            assert abs(rig.twin.plant.velocity) < 0.1
            await rig.ran("service/m/disable")


@every_profile
async def test_a_hold_brings_it_to_rest_and_keeps_its_torque(profile: str) -> None:
    async with motor(profile, acceleration=20.0, valid_for=20.0) as rig:
        await turns(rig)
        await rig.backend.hold(None)
        assert abs(rig.twin.plant.velocity) < 0.1
        await stays_at_rest(rig)
        assert rig.twin.enabled
        assert rig.axis.state == "enabled"
        await rig.write("actuator/m/velocity", 1.0)  # no latch
        await rig.until(lambda: rig.twin.plant.velocity > 0.5)


@pytest.mark.parametrize("profile", [name for name in MOTORS if name != "vesc"])
async def test_a_hold_ends_the_move(profile: str) -> None:
    async with motor(profile, velocity=2.0) as rig:
        await rig.enable()
        moving = asyncio.ensure_future(rig.execute("action/m/move_to", {"position": 9.0}))
        await rig.until(lambda: rig.twin.plant.velocity > 1.0)
        await rig.backend.hold(None)
        with pytest.raises(ModeForbids, match="hold"):
            await asyncio.wait_for(moving, 60)
        await stays_at_rest(rig)
        assert rig.twin.enabled
        assert rig.twin.plant.position < 8.0
