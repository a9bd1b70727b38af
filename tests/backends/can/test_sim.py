"""The twins without a gateway, in a process of their own, and on a configuration's word."""

from __future__ import annotations

import asyncio
import random
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest

from backends.can.rig import MOTORS, channel, opened
from rcp_can.sim.__main__ import main


def test_the_twins_run_in_a_process_of_their_own() -> None:
    command = [sys.executable, "-m", "rcp_can.sim", "--interface", "virtual", "--seconds", "0.1"]
    done = subprocess.run(
        [*command, "odrive:1", "cia402:5"], capture_output=True, text=True, timeout=30, check=False
    )
    assert done.stdout.startswith("2 drives on"), done.stderr


@pytest.mark.parametrize("drive", ["steam:1", "odrive:64", "odrive", "odrive:x"])
def test_a_drive_that_there_is_not_is_a_usage_error(drive: str) -> None:
    with pytest.raises(SystemExit):
        main([drive])


async def test_a_bus_that_is_simulated_has_a_twin_of_every_motor() -> None:
    motors = {n: {"bus": "can0", "profile": n, **t} for n, t in MOTORS.items() if n != "moteus"}
    motors["mit"]["options"] = {"reply_id": 0x100}
    bus = {"interface": "virtual", "channel": channel(), "simulate": True}
    async with opened({"buses": {"can0": bus}, "motors": motors, "grace": 4.0}) as rig:
        for name, axis in rig.backend.axes.items():
            await rig.host.until(lambda a=axis: a.online and a.state == "disabled")
            assert rig.host.last(f"sensor/{name}/state").state == "disabled"


def patient(table: dict[str, Any]) -> dict[str, Any]:
    """Return a table whose drives are not lost where a busy machine holds their threads up."""
    motors = {name: {**motor, "timeout": 10.0} for name, motor in table["motors"].items()}
    return {**table, "motors": motors, "grace": 30.0}


async def test_the_example_configuration_drives() -> None:
    text = (Path(__file__).parents[3] / "examples" / "motors.toml").read_text(encoding="utf-8")
    table = tomllib.loads(text)["backends"][0]
    for key in ("use", "name", "tenant"):
        del table[key]
    async with opened(patient(table)) as rig:
        assert rig.host.reports == []
        for name in ("shoulder", "wheel", "gripper"):
            await rig.ran(f"service/{name}/enable")
        moved = await rig.ran("action/shoulder/move_to", {"position": 0.5})
        assert moved["position"] == pytest.approx(0.5, abs=0.02)
        goal = {"positions": {"shoulder": -0.2, "gripper": 0.4}}
        moved = await rig.ran("action/arm/move_joints", goal)
        assert moved["positions"]["gripper"] == pytest.approx(0.4, abs=0.02)
        await rig.write("actuator/wheel/velocity", 5.0)
        await rig.host.until(lambda: rig.backend.axes["wheel"].velocity > 4.0)
        await rig.backend.halt()
        assert abs(rig.backend.axes["wheel"].velocity) < 0.1


async def test_the_rover_of_the_example_configuration_drives() -> None:
    text = (Path(__file__).parents[3] / "examples" / "motors.toml").read_text(encoding="utf-8")
    table = tomllib.loads(text)["backends"][1]
    for key in ("use", "name", "tenant", "robot"):
        del table[key]
    async with opened(patient(table)) as rig:
        await rig.ran("service/enable")
        goal = {"position": {"x": 0.3, "y": 0.0}, "frame": "odom"}
        moved = await rig.ran("action/move_to", goal)
        assert moved["pose"]["position"]["x"] == pytest.approx(0.3, abs=0.06)


async def test_a_twin_in_a_process_of_its_own_is_driven_over_multicast() -> None:
    group = f"239.{random.randrange(64, 128)}.{random.randrange(256)}.{random.randrange(1, 255)}"
    bus = {"interface": "udp_multicast", "channel": group}
    motors = {
        "m": {"bus": "can0", "profile": "odrive", "node": 1, "velocity": 10.0, "timeout": 5.0}
    }
    command = [sys.executable, "-m", "rcp_can.sim", "--channel", group, "odrive:1"]
    twins = await asyncio.create_subprocess_exec(*command, stdout=asyncio.subprocess.PIPE)
    try:
        assert twins.stdout is not None
        async with asyncio.timeout(60):
            assert (await twins.stdout.readline()).startswith(b"1 drives on")
        async with opened({"buses": {"can0": bus}, "motors": motors, "grace": 30.0}) as rig:
            assert rig.host.reports == []
            await rig.ran("service/m/enable")
            moved = await rig.ran("action/m/move_to", {"position": 1.0})
            assert moved["position"] == pytest.approx(1.0, abs=0.02)
            twins.terminate()
            await twins.wait()
            await rig.host.published_as("sensor/m/state", seconds=60, state="offline")
    finally:
        if twins.returncode is None:
            twins.kill()
            await twins.wait()
