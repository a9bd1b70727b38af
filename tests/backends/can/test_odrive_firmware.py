"""Heartbeats of an ODrive: by the published message databases, and what they tell of a procedure."""

from __future__ import annotations

import asyncio
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import can
import cantools
import odrive_can
import pytest

from rcp_can.profiles.odrive import OdriveDrive, OdriveOptions
from rcp_can.profiles.odrive_messages import MESSAGES
from rcp_kernel.errors import DeviceRejected, DeviceTimeout

FLAGS = ("Motor_Error_Flag", "Encoder_Error_Flag", "Controller_Error_Flag")


def database(firmware: str) -> Any:
    path = Path(odrive_can.__file__).parent / "dbc" / f"odrive-cansimple-{firmware}.dbc"
    return cantools.database.load_file(path)


async def moving(firmware: str) -> tuple[Any, Any]:
    """Return a drive on its way, and what tells it heartbeats of that firmware."""
    bus: Any = quiet_bus()
    drive, messages = OdriveDrive(0, OdriveOptions(), bus), database(firmware)

    def tell(name: str, **values: float) -> None:
        message = messages.get_message_by_name(f"Axis0_{name}")
        data = message.encode({signal.name: 0 for signal in message.signals} | values, strict=False)
        drive.take(can.Message(arbitration_id=message.frame_id, data=data, is_extended_id=False))

    if firmware != "0.5.6":
        tell("Get_Version", Fw_Version_Minor=6)
    await drive.move(1.0, 1.0, None)
    return drive, tell


@pytest.mark.parametrize("firmware", ["0.5.6", "0.6.10"])
async def test_the_end_of_a_trajectory_is_seen(firmware: str) -> None:
    drive, tell = await moving(firmware)
    tell("Heartbeat", Axis_State=8)
    assert drive.status.reached is False
    tell("Heartbeat", Axis_State=8, Trajectory_Done_Flag=1)
    assert drive.status.reached is True


@pytest.mark.parametrize("flag", FLAGS)
async def test_no_error_of_firmware_0_5_is_that_end(flag: str) -> None:
    drive, tell = await moving("0.5.6")
    tell("Heartbeat", Axis_State=1, Axis_Error=0x100, **{flag: 1})
    assert drive.status.reached is False
    assert drive.status.faults


def heartbeats(drive: OdriveDrive, *each: tuple[float, int, int]) -> None:
    """Take a batch of heartbeats, each with its time of arrival, state and result."""
    for moment, state, result in each:
        drive.status.frame_at = moment
        command, layout = MESSAGES["heartbeat"]
        data = layout.encode(state=state, result=result)
        drive.take(can.Message(arbitration_id=command, data=data, is_extended_id=False))
    drive.status.frame_at = None
    drive.wake_waiters()


async def calibrating(bus: Any, result: int = 0) -> tuple[OdriveDrive, Any, list[int], float]:
    """Request a calibration of a drive whose last procedure had a result; return when it was sent."""
    drive, states = OdriveDrive(0, OdriveOptions(), bus), list[int]()
    heartbeats(drive, (time.monotonic(), 1, result))
    begun: list[bool] = []
    run = drive.calibrate(4, 60.0, states.append, lambda: begun.append(True))
    task = asyncio.ensure_future(run)
    await asyncio.sleep(0)
    return drive, (task, begun), states, time.monotonic()


def quiet_bus(**facts: Any) -> Any:
    return SimpleNamespace(**{"send": lambda *_, **__: None, "lag": 0.0, **facts})


async def test_a_calibration_that_comes_in_one_batch_has_run() -> None:
    drive, (task, begun), states, at = await calibrating(quiet_bus())
    batch = ((0.1, 1, 0), (0.2, 4, 1), (0.3, 7, 1), (0.4, 1, 0))
    heartbeats(drive, *((at + later, state, result) for later, state, result in batch))
    await task
    assert (states, begun) == ([4, 7], [True])


@pytest.mark.parametrize(("result", "ends"), [(0, None), (6, "phase resistance")])
async def test_a_calibration_of_which_only_the_result_is_heard_has_run(
    result: int, ends: str | None
) -> None:
    drive, (task, begun), states, at = await calibrating(quiet_bus(), result=2)
    heartbeats(drive, (at + 0.9, 1, result), (at + 1.0, 1, result))
    if ends is None:
        await task
    else:
        with pytest.raises(DeviceRejected, match=ends):
            await task
    assert (states, begun) == ([], [True])


async def test_a_calibration_that_may_have_run_unheard_is_not_called_refused() -> None:
    drive, (task, begun), _, at = await calibrating(quiet_bus())
    heartbeats(drive, (at + 0.9, 1, 0), (at + 1.0, 1, 0))
    with pytest.raises(DeviceTimeout, match="not known"):
        await task
    assert not begun


async def test_an_old_result_is_not_the_reason_why_a_calibration_did_not_start() -> None:
    drive, (task, begun), _, at = await calibrating(quiet_bus(), result=6)
    heartbeats(drive, (at + 0.1, 1, 6), (at + 0.2, 1, 6))
    with pytest.raises(DeviceRejected, match="did not start"):
        await task
    assert not begun


async def test_heartbeats_from_before_the_request_tell_nothing_of_it() -> None:
    bus = quiet_bus(lag=0.1)
    drive, (task, _), states, at = await calibrating(bus)
    heartbeats(drive, *((at - 0.1 * n, 1, 0) for n in (4, 3, 2, 1)))  # read late
    heartbeats(drive, *((at + 0.1 * n, 1, 0) for n in (1, 2, 3)))  # the request still waits
    await asyncio.sleep(0)
    assert drive.busy
    bus.lag = 0.0
    heartbeats(drive, *((at + 0.1 * n, n, 1) for n in (4,)), (at + 0.5, 1, 0))
    await task
    assert states == [4]


async def test_homing_that_comes_in_one_batch_has_run() -> None:
    drive = OdriveDrive(0, OdriveOptions(), quiet_bus())
    now = time.monotonic()
    heartbeats(drive, (now, 8, 0))
    begun: list[bool] = []
    task = asyncio.ensure_future(drive.home(lambda: begun.append(True)))
    await asyncio.sleep(0)
    at = time.monotonic()
    heartbeats(drive, (at + 0.1, 8, 0), (at + 0.2, 11, 1), (at + 0.3, 8, 0))
    await task
    assert begun == [True]
    assert drive.status.homed
