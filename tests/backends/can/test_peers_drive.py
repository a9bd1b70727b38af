"""Peers that are not ours as drives and as masters: durand with CiA 402, odrive-can's own driver."""

from __future__ import annotations

import asyncio
import warnings
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from typing import Any

import anyio
import can
import pytest

from backends.can.durand_drive import DurandDrive, durand_drive
from backends.can.rig import Rig, channel, opened
from rcp_can.sim import Bench, make_twin
from rcp_kernel.errors import ModeForbids


async def until(holds: Any, seconds: float = 60.0) -> None:
    with anyio.fail_after(seconds):
        while not holds():  # noqa: ASYNC110  # a peer lives in a thread that tells nobody
            await asyncio.sleep(0.005)


def failed(drive: Any) -> bool:
    """Return whether an ODrive reports an error."""
    from odrive_can.odrive import DriveError

    try:
        drive.check_errors()
    except DriveError:
        return True
    return False


@asynccontextmanager
async def driven_durand() -> AsyncGenerator[tuple[Rig, DurandDrive]]:
    name = channel()
    motor = {"bus": "can0", "profile": "cia402", "node": 6, "velocity": 20.0, "timeout": 10.0}
    bus = {"interface": "virtual", "channel": name}
    with durand_drive(name, 6) as drive:
        async with opened({"buses": {"can0": bus}, "motors": {"m": motor}, "grace": 30.0}) as rig:
            assert rig.host.reports == []
            yield rig, drive


async def test_we_drive_a_drive_on_durand_which_maps_our_pdos_and_tells_by_sync() -> None:
    async with driven_durand() as (rig, drive):
        assert drive.node.tpdo[0].mapping == ((0x6041, 0), (0x6061, 0), (0x6064, 0))
        assert drive.node.tpdo[0].transmission_type == 1  # it has no event timer
        with pytest.raises(ModeForbids):
            await rig.write("actuator/m/velocity", 1.0)
        await rig.ran("service/m/enable")
        assert drive.state == "run"
        await rig.write("actuator/m/velocity", 3.0)
        await until(lambda: abs(drive.plant.velocity - 3.0) < 0.1)
        with anyio.fail_after(60):
            await rig.backend.halt()
        assert drive.state == "quick"
        assert abs(drive.plant.velocity) < 0.1
        await rig.ran("service/m/enable")
        moved = await rig.ran("action/m/move_to", {"position": 1.0})
        assert moved["position"] == pytest.approx(1.0, abs=0.02)
        assert drive.plant.position == pytest.approx(1.0, abs=0.02)
        await rig.ran("service/m/disable")
        assert drive.state in ("off", "ready")


async def test_an_emcy_of_durand_is_a_fault_that_can_be_cleared() -> None:
    async with driven_durand() as (rig, drive):
        await rig.ran("service/m/enable")
        await rig.write("actuator/m/velocity", 3.0)
        await until(lambda: drive.plant.velocity > 2.0)
        drive.fail(0x4310)
        state = await rig.host.published_as("sensor/m/state", state="fault")
        assert state.faults == ["emergency_4310"]
        await rig.ran("service/m/clear_faults")
        await rig.host.published_as("sensor/m/state", state="disabled", faults=[])
        await asyncio.sleep(0.1)
        assert drive.state in ("off", "ready")


@pytest.mark.serial  # it gives up whatever takes more than half a second
async def test_the_driver_of_odrive_can_drives_our_twin() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from odrive_can.odrive import ODriveCAN

    name = channel()
    twin = make_twin("odrive", 2)
    with Bench(can.Bus(name, "virtual", ignore_config=True), [twin]):
        line = can.Bus(name, "virtual", ignore_config=True)
        drive = ODriveCAN(2, line)
        with anyio.fail_after(60):
            await drive.start()
            drive.check_alive()
            drive.check_errors()
            assert drive.axis_state == "IDLE"
            drive.set_controller_mode("POSITION_CONTROL", "TRAP_TRAJ")
            drive.set_traj_vel_limit(4.0)
            drive.set_traj_accel_limits(40.0, 40.0)
            await drive.set_axis_state("CLOSED_LOOP_CONTROL")
            assert twin.enabled
            drive.set_input_pos(0.5)  # turns
            await until(lambda: abs(twin.plant.position - 3.1416) < 0.02)
            estimates = await drive.get_encoder_estimates()
            assert estimates["Pos_Estimate"] == pytest.approx(0.5, abs=0.02)
            assert (await drive.get_bus_voltage_current())["Bus_Voltage"] == pytest.approx(24.0)
            twin.break_down()
            await until(lambda: failed(drive))
            drive.clear_errors()
            await until(lambda: not failed(drive))
            await asyncio.to_thread(drive.stop)
        await until(lambda: not twin.enabled)
        line.shutdown()
