"""A drive whose feedback fails is stopped, whatever else of it is still heard."""

from __future__ import annotations

import asyncio
from typing import Any

import can
import pytest

from backends.can.rig import MOTORS, channel, motor, opened
from backends.can.stopping import stays_at_rest, turns
from rcp_can.sim import Bench, make_twin
from rcp_kernel.errors import (
    AdapterUnavailable,
    DeviceTimeout,
    ModeForbids,
)

GOES_BLIND = ["cia402", "odrive", "moteus", "vesc"]
"""Drives whose feedback can fail while something else goes on."""


@pytest.mark.parametrize("profile", GOES_BLIND)
async def test_a_drive_that_is_heard_without_feedback_is_stopped_and_takes_nothing(
    profile: str,
) -> None:
    async with motor(profile, feedback_timeout=1.0, position=[-50.0, 50.0]) as rig:
        await turns(rig)
        rig.twin.blind = True
        await rig.host.published_as("sensor/m/state", state="no_feedback")
        assert "feedback_lost" in rig.faults()
        assert "received for 1 s" in (rig.host.reports[-1] or "")
        await rig.until(lambda: abs(rig.twin.plant.velocity) < 0.1)
        await stays_at_rest(rig)
        assert rig.backend.motion(None).at_rest is None
        for call in (
            rig.write("actuator/m/velocity", 1.0),
            rig.execute("service/m/enable"),
            rig.backend.halt(),
        ):
            with pytest.raises(DeviceTimeout, match="feedback lost"):
                await call
        rig.twin.blind = False
        await rig.host.until(lambda: "feedback_lost" in rig.faults(active=False))
        await rig.until(lambda: rig.host.reports[-1] is None)
        await stays_at_rest(rig)
        await rig.backend.halt()
        assert rig.backend.motion(None).at_rest is True


@pytest.mark.parametrize("profile", ["cia402", "odrive", "moteus"])
async def test_a_move_whose_feedback_fails_ends_with_that_reason(profile: str) -> None:
    async with motor(profile, feedback_timeout=0.3, velocity=2.0) as rig:
        await rig.enable()
        moving = asyncio.ensure_future(rig.execute("action/m/move_to", {"position": 9.0}))
        await rig.until(lambda: rig.twin.plant.velocity > 1.0)
        rig.twin.blind = True
        with pytest.raises(DeviceTimeout, match="feedback lost"):
            await asyncio.wait_for(moving, 60)
        await rig.until(lambda: abs(rig.twin.plant.velocity) < 0.1)
        assert rig.twin.plant.position < 8.0


async def test_a_drive_that_accepts_pdos_and_keeps_its_own_is_a_fault_of_configuration() -> None:
    name = channel()
    twin: Any = make_twin("cia402", 5)
    twin.keeps_mapping = True
    table = {"bus": "can0", "profile": "cia402", **MOTORS["cia402"]}
    bus = {"interface": "virtual", "channel": name}
    with Bench(can.Bus(name, "virtual", ignore_config=True), [twin]):
        async with opened({"buses": {"can0": bus}, "motors": {"m": table}, "grace": 0.1}) as rig:
            await rig.host.published_as("sensor/m/state", state="fault", faults=["configuration"])
            assert "position" in (rig.host.reports[-1] or "")
            for call in (
                rig.execute("service/m/enable"),
                rig.execute("action/m/move_to", {"position": 1.0}),
            ):
                with pytest.raises(AdapterUnavailable, match="position"):
                    await call
            with pytest.raises(ModeForbids):
                await rig.write("actuator/m/velocity", 1.0)
            assert not twin.enabled
