"""A stop holds against other masters, lost frames and nodes that go away: the twin's plant is the witness."""

from __future__ import annotations

import asyncio
import random
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import anyio
import pytest

from backends.can.rig import MOTORS, Motor, Node, motor
from backends.can.stopping import stays_at_rest, turns
from backends.can.test_gateway_gone import turn
from rcp_can.sim import Plant
from rcp_kernel.errors import (
    AdapterUnavailable,
    DeviceTimeout,
    RcpError,
)

every_profile = pytest.mark.parametrize("profile", MOTORS)


def rpdo(control: int, mode: int = 3) -> bytes:
    return bytes((control, 0, mode)) + bytes(4)


BY: dict[str, tuple[bool, Callable[[Motor], None]]] = {
    "axis": (True, lambda _rig: None),
    "kernel": (False, lambda rig: rig.backend.hold_stop(None)),
}
"""Who stops a drive again that another master moves, each without the other: the backend's own look after
what is latched, and what the kernel calls for as long as it is."""
by_either = pytest.mark.parametrize("by", BY)


@by_either
async def test_another_master_that_enables_a_stopped_drive_moves_it_for_a_moment_only(
    by: str,
) -> None:
    async with motor("cia402") as rig:
        await turns(rig)
        await rig.backend.halt()
        rig.host.latched, stop_again = BY[by]
        with Node(rig.channel) as node:
            for _ in range(6):
                taken = len(rig.twin.commands)
                await rig.until(lambda: not rig.axis.stopping)
                node.send(0x205, rpdo(0x0F))  # out of quick stop active (CiA 402-2, transition 16)
                node.send(0x305, (3000).to_bytes(4, "little") + bytes(2))
                await rig.until(lambda n=taken: len(rig.twin.commands) > n)
                await rig.until(lambda: stop_again(rig) or rig.twin.state == "quick_stop")
            await rig.until(lambda: abs(rig.twin.plant.velocity) < 0.1)
        await stays_at_rest(rig)
        assert rig.twin.state != "enabled"


PUSHED: Any = ("velocity", 3.0)


def pushed(plant: Plant) -> None:
    """Turn for good, as another master orders."""
    plant.loop, plant.goal = PUSHED


@pytest.mark.parametrize("profile", ["odrive", "mit", "moteus"])
async def test_a_drive_that_another_master_pushes_is_stopped_again(profile: str) -> None:
    async with motor(profile) as rig:
        await turns(rig)
        await rig.backend.halt()
        rig.host.latched = True
        for _ in range(3):
            await rig.until(lambda: not rig.axis.stopping)
            await rig.ordered(lambda: pushed(rig.twin.plant))
            plant = rig.twin.plant
            await rig.until(lambda p=plant: (p.loop, p.goal) != PUSHED)
            await rig.until(lambda: abs(rig.twin.plant.velocity) < 0.1)
        await stays_at_rest(rig)


@pytest.mark.parametrize("profile", ["odrive", "damiao", "moteus"])
async def test_a_drive_that_another_master_powers_and_pushes_is_cut_off_again(
    profile: str,
) -> None:
    async with motor(profile, torque_off_after=0.1) as rig:
        await turns(rig)
        await rig.backend.halt()
        for _ in range(3):
            await rig.until(lambda: rig.axis.released and rig.twin.plant.loop == "off")
            await rig.host.published_as("sensor/m/state", energised=False)
            await rig.ordered(lambda: (turn(rig.twin), pushed(rig.twin.plant)))
            await rig.host.published_as("sensor/m/state", energised=True)
            await rig.until(lambda: rig.twin.plant.velocity > 0.0)
            await rig.until(lambda: rig.backend.hold_stop(None) or rig.twin.plant.loop == "off")
        await rig.until(lambda: abs(rig.twin.plant.velocity) < 0.1)
        await stays_at_rest(rig)


@every_profile
async def test_a_halt_is_confirmed_with_two_of_three_frames_lost(profile: str) -> None:
    async with motor(profile, timeout=3.0, feedback_timeout=3.0) as rig:
        await turns(rig)
        chance = random.Random(3)
        rig.bench.loses = lambda: chance.random() < 2 / 3
        with anyio.fail_after(60):
            for _ in range(5):
                with suppress(DeviceTimeout):
                    await rig.backend.halt()
                    break
            else:
                pytest.fail("no halt was confirmed")
        assert abs(rig.twin.plant.velocity) < 0.1
        await stays_at_rest(rig)
        rig.bench.loses = None


async def test_a_node_that_boots_while_it_is_being_stopped_ends_up_at_rest_and_off() -> None:
    async with motor("cia402") as rig:
        await turns(rig, 8.0)
        halting = asyncio.ensure_future(rig.backend.halt())
        await asyncio.sleep(0)
        await rig.ordered(rig.twin.boot)
        with suppress(RcpError):
            await asyncio.wait_for(halting, 60)
        await rig.until(lambda: rig.axis.configured)
        await rig.until(lambda: abs(rig.twin.plant.velocity) < 0.1)
        await rig.backend.halt()
        await stays_at_rest(rig)
        assert not rig.twin.enabled
        await rig.host.published_as("sensor/m/state", energised=False)


async def test_a_node_that_leaves_operational_while_it_turns_is_stopped_by_sdo() -> None:
    async with motor("cia402", watchdog=False) as rig:
        await turns(rig)
        with Node(rig.channel) as node:
            node.send(0x000, bytes((0x80, 5)))  # pre-operational: PDOs have no effect
            await rig.host.until(lambda: "reset" in rig.faults())
            (reset,) = (e for e in rig.host.events("event/m/fault") if e.fault == "reset")
            assert reset.text == "the drive left the NMT state operational while in use"
            await rig.until(lambda: abs(rig.twin.plant.velocity) < 0.1, 20.0)
            await stays_at_rest(rig)
            assert rig.twin.state != "enabled"


async def test_a_stop_of_a_bus_that_is_off_is_no_success_and_nothing_moves_when_it_is_back() -> (
    None
):
    async with motor("odrive", bus={"restart": 0.2}) as rig:
        await turns(rig)
        rig.host.on_restored = lambda: rig.backend.hold_stop(None)
        with Node(rig.channel) as node:
            node.bus_off()
            await rig.host.published_as("sensor/can/can0/state", state="bus_off")
            rig.host.latched = True
            with pytest.raises(AdapterUnavailable):
                await rig.backend.halt()
            await rig.until(lambda: abs(rig.twin.plant.velocity) < 0.1)
        await stays_at_rest(rig)
        await rig.backend.halt()
