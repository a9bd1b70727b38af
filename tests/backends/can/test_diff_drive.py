"""Two motors drive as one: the kinematics, the limits, both wheels or neither."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from typing import Any

import msgspec
import pytest

from backends.can.rig import Rig, channel, opened
from rcp_can import CanConfig
from rcp_kernel.errors import ModeForbids, OutOfRange

CMD = "actuator/base/cmd_vel"


@asynccontextmanager
async def rover() -> AsyncGenerator[Rig]:
    wheel: dict[str, Any] = {"bus": "can0", "profile": "odrive", "velocity": 10.0}
    wheel |= {"timeout": 1.0, "feedback_timeout": 1.0}  # a busy machine's twins are late
    bus = {"interface": "virtual", "channel": channel(), "simulate": True}
    base = {"left": "l", "right": "r", "track": 0.4, "radius": 0.1}
    motors = {"l": {**wheel, "node": 1}, "r": {**wheel, "node": 2, "direction": -1}}
    table = {"buses": {"can0": bus}, "motors": motors, "diff_drives": {"base": base}}
    async with opened(table) as rig:
        yield rig


async def settled(rig: Rig, left: float, right: float) -> None:
    axes = rig.backend.axes
    await rig.host.until(
        lambda: abs(axes["l"].velocity - left) < 0.1 and abs(axes["r"].velocity - right) < 0.1
    )


async def test_it_says_what_it_is() -> None:
    async with rover() as rig:
        assert rig.host.facts[None].kind == "differential_drive"


async def test_a_twist_turns_the_wheels_by_track_and_radius() -> None:
    async with rover() as rig:
        for name in ("l", "r"):
            await rig.ran(f"service/{name}/enable")
        await rig.write(CMD, {"linear": {"x": 0.5}, "angular": {"z": 1.0}})
        await settled(rig, 3.0, 7.0)
        await rig.write(CMD, {})
        await settled(rig, 0.0, 0.0)
        with pytest.raises(OutOfRange, match=r"linear\.x"):
            await rig.write(CMD, {"linear": {"x": 1.5}})
        with pytest.raises(OutOfRange, match="wheel 'r'"):
            await rig.write(CMD, {"linear": {"x": 0.9}, "angular": {"z": 1.0}})
        with pytest.raises(OutOfRange):
            await rig.write(CMD, {"linear": {"y": 0.1}})


async def test_one_wheel_that_is_not_enabled_refuses_for_both_but_takes_a_stop() -> None:
    async with rover() as rig:
        await rig.ran("service/l/enable")
        with pytest.raises(ModeForbids, match="'r' is disabled"):
            await rig.write(CMD, {"linear": {"x": 0.5}})
        await rig.write(CMD, {})
        await asyncio.sleep(0.1)
        assert abs(rig.backend.axes["l"].velocity) < 0.1


def test_wheels_must_be_motors() -> None:
    base = {"left": "l", "right": "r", "track": 0.4, "radius": 0.1}
    with pytest.raises(msgspec.ValidationError, match="no motor 'l'"):
        msgspec.convert({"buses": {"can0": {}}, "diff_drives": {"base": base}}, CanConfig)
