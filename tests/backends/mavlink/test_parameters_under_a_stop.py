"""Parameters while an e-stop is latched: what cannot move the vehicle is written, nothing else."""

from __future__ import annotations

from collections.abc import AsyncIterator
from typing import Any

import pytest

from backends.mavlink.test_gateway import Pilot, flying
from rcp_gateway.testing import eventually
from rcp_gateway.testing._serve import ADMIN
from rcp_mavlink.parameter_hazards import is_hazard

HARMFUL = ("ARMING_REQUIRE", "SERVO1_TRIM", "MOT_PWM_MIN", "FLTMODE1", "PWM_MAIN_DIS1")
VALUES: dict[str, Any] = dict.fromkeys(HARMFUL, 1)


@pytest.fixture
async def pilot() -> AsyncIterator[Pilot]:
    async with flying({"parameters": VALUES | {"RTL_ALT": 1500.0}}) as found:
        await found.ready()

        async def listed() -> bool:
            reply = await found.client.request("read", "/tenant/t/param/SERVO1_TRIM")
            return reply["status"] == "completed"

        await eventually(listed, "its parameters are listed")
        yield found


async def write(pilot: Pilot, name: str, value: float) -> dict[str, Any]:
    return await pilot.client.request("write", f"/tenant/t/param/{name}", body=value, within=60.0)


async def estop(pilot: Pilot) -> None:
    reply = await pilot.served.client(ADMIN).request("execute", "/system/estop", within=60.0)
    assert reply["status"] == "completed", reply


async def test_what_may_move_a_stopped_vehicle_is_refused_and_the_rest_written(
    pilot: Pilot,
) -> None:
    for name in HARMFUL:
        assert (await write(pilot, name, 2))["status"] == "completed"
    await estop(pilot)
    for name in HARMFUL:
        reply = await write(pilot, name, 3)
        assert reply["error"]["code"] == "estop_active", reply
        assert pilot.vehicle.params[name] == 2
    assert (await write(pilot, "RTL_ALT", 2000))["status"] == "completed"
    assert pilot.vehicle.params["RTL_ALT"] == 2000


async def test_a_file_is_loaded_into_a_stopped_vehicle_only_without_them(pilot: Pilot) -> None:
    await estop(pilot)
    both = {"text": "RTL_ALT,2100\nSERVO1_TRIM,1900\n"}
    reply = await pilot.do("action/param/load", both)
    assert reply["error"]["code"] == "estop_active", reply
    assert "SERVO1_TRIM" in reply["message"]
    assert "Leave them out" in reply["error"]["remedy"]
    assert pilot.vehicle.params["RTL_ALT"] == 1500
    reply = await pilot.do("action/param/load", {"text": "RTL_ALT,2100\n"})
    assert reply["status"] == "completed", reply
    assert pilot.vehicle.params["RTL_ALT"] == 2100


async def test_nothing_is_written_to_a_stopped_vehicle_that_is_armed(pilot: Pilot) -> None:
    await estop(pilot)
    pilot.vehicle.armed = True  # by its remote control

    async def told() -> bool:
        return await pilot.read("sensor/armed")

    await eventually(told, "it is seen armed")
    reply = await write(pilot, "RTL_ALT", 2000)
    assert reply["error"]["code"] == "estop_active", reply
    assert "armed" in reply["message"]
    assert pilot.vehicle.params["RTL_ALT"] == 1500


@pytest.mark.parametrize(
    ("name", "hazard"),
    [
        ("SERVO12_FUNCTION", True), ("ARMING_CHECK", True), ("RC7_OPTION", True), ("MODE_CH", True),
        ("MODE3", True), ("RELAY_DEFAULT", True), ("BRD_SAFETY_DEFLT", True), ("H_SV_MAN", True),
        ("COM_PREARM_MODE", True), ("PWM_AUX_FUNC1", True), ("CBRK_IO_SAFETY", True),
        ("PCA9685_DIS3", True), ("PCA9685_FUNC16", True), ("RBCLW_FUNC1", True), ("RBCLW_REV", True),
        ("VTQ_IO_FUNC0", True), ("VTQ_ARM_BEHAVE", True), ("MODAL_IO_FUNC1", True), ("OTHER_FAIL2", True),
        ("BTN0_FUNCTION", True), ("BTN15_SFUNCTION", True), ("FENCE_ALT_MAX", False), ("MPC_Z_VEL_MAX_UP", False),
        ("RTL_ALT", False), ("WPNAV_SPEED", False), ("ATC_RAT_RLL_P", False), ("MPC_XY_VEL_MAX", False),
        ("SERIAL1_BAUD", False), ("LOG_BITMASK", False), ("SR0_POSITION", False), ("THRESH", False),
    ],
)  # fmt: skip
def test_names_are_told_apart(name: str, *, hazard: bool) -> None:
    assert is_hazard(name) is hazard
