"""A torque against gravity is fed forward with positions, where the drive takes one."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from backends.can.peers import drive_eds
from backends.can.rig import Motor, channel, motor, opened
from rcp_can.config_motor import MotorConfig
from rcp_can.gravity import Gravity
from rcp_kernel.errors import ConfigError

TABLE = [[-1.0, -2.0], [0.0, 0.0], [1.0, 4.0]]
LOAD = -0.5  # N·m


@pytest.mark.parametrize(
    ("position", "torque"), [(-2.0, -2.0), (-0.5, -1.0), (0.0, 0.0), (0.25, 1.0), (5.0, 4.0)]
)
def test_a_torque_is_linear_between_the_pairs_and_constant_beyond(
    position: float, torque: float
) -> None:
    assert Gravity([(a, b) for a, b in TABLE]).torque(position) == pytest.approx(torque)


def offset(rig: Motor) -> float:
    twin: Any = rig.twin
    return twin.get("torque_offset") / 1000


async def test_a_cia402_drive_is_told_the_torque_at_its_shaft_with_each_position() -> None:
    keys = {"gear": 10.0, "direction": -1, "torque": 5.0, "gravity": TABLE}
    async with motor("cia402", velocity=5.0, **keys) as rig:
        await rig.enable()
        for position, torque in ((0.5, 2.0), (-0.5, -1.0)):
            await rig.write("actuator/m/position", position)
            await rig.until(lambda at=position: abs(rig.twin.plant.position + 10 * at) < 0.05)
            assert offset(rig) == pytest.approx(-torque / 10, abs=0.002)
        await rig.write(
            "actuator/m/torque", 0.0
        )  # a torque is what was commanded, and nothing else
        await rig.until(lambda: offset(rig) == 0.0)


async def sinks(profile: str, **keys: Any) -> float:
    """Return by how much a joint sinks that is held at zero under a load; rad."""
    async with motor(profile, velocity=5.0, torque=2.0, **keys) as rig:
        rig.twin.plant.integrates = False
        await rig.enable()
        await rig.write("actuator/m/position", 0.0)
        await rig.until(lambda: rig.axis.mode == "position")
        await rig.ordered(lambda: setattr(rig.twin.plant, "load", LOAD))
        seen = rig.axis.status.moved
        await rig.until(lambda: rig.axis.status.moved > seen + 20)
        return abs(rig.twin.plant.position)


@pytest.mark.parametrize("profile", ["cia402", "mit"])
async def test_what_is_fed_forward_holds_the_joint_up(profile: str) -> None:
    without = await sinks(profile)
    assert without > 0.005
    assert await sinks(profile, gravity=[[-10.0, -LOAD], [10.0, -LOAD]]) < without / 3


async def test_a_drive_without_the_object_is_driven_without_it(tmp_path: Any) -> None:
    eds = drive_eds(tmp_path / "drive.eds", node=5)
    options = {"eds": str(eds), "map_pdos": False}
    keys = {"gravity": TABLE, "torque": 5.0, "options": options}
    async with motor("cia402", velocity=5.0, **keys) as rig:
        await rig.enable()
        await rig.write("actuator/m/position", 0.3)
        await rig.until(lambda: abs(rig.twin.plant.position - 0.3) < 0.02)


async def test_a_drive_that_takes_no_torque_beside_a_position_is_refused() -> None:
    bus = {"interface": "virtual", "channel": channel()}
    table = {"bus": "can0", "profile": "vesc", "node": 7, "gravity": TABLE, "torque": 5.0}
    with pytest.raises(ConfigError, match=r"motors\.m\.gravity: vesc takes no torque"):
        async with opened({"buses": {"can0": bus}, "motors": {"m": table}}):
            pass


@pytest.mark.parametrize(
    ("gravity", "words"),
    [
        ([[0.0, 1.0]], "two pairs"),
        ([[1.0, 1.0], [0.0, 1.0]], "increasing"),
        ([[0.0, 1.0], [1.0, 9.0]], "exceeds `torque`"),
    ],
)
def test_a_table_that_is_none_is_refused(gravity: Any, words: str) -> None:
    table = {"bus": "can0", "profile": "cia402", "node": 5, "torque": 5.0, "gravity": gravity}
    with pytest.raises(msgspec.ValidationError, match=words):
        msgspec.convert(table, MotorConfig)
