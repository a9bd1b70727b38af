"""Heartbeats of an ODrive by the published message databases: the end of a trajectory has moved."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import can
import cantools
import odrive_can
import pytest

from rcp_can.profiles.odrive import OdriveDrive, OdriveOptions

FLAGS = ("Motor_Error_Flag", "Encoder_Error_Flag", "Controller_Error_Flag")


def database(firmware: str) -> Any:
    path = Path(odrive_can.__file__).parent / "dbc" / f"odrive-cansimple-{firmware}.dbc"
    return cantools.database.load_file(path)


async def moving(firmware: str) -> tuple[Any, Any]:
    """Return a drive on its way, and what tells it heartbeats of that firmware."""
    bus: Any = SimpleNamespace(send=lambda *_, **__: None)
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
