"""A gateway that is frozen or killed leaves no drive turning: its own watchdog, or the guard's frames."""

from __future__ import annotations

import asyncio
import os
import signal
import sys
import time
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import anyio
import can
import pytest

from backends.can.loopback import group, line
from backends.can.rig import MOTORS, channel, motor, opened
from rcp_can.sim import Bench, Twin, make_twin
from timing import in_one_of_three_attempts, in_time_under, measured_load

TESTS = Path(__file__).parents[2]
WATCHED = {"cia402": 1.0, "damiao": 1.2, "cybergear": 1.2, "moteus": 1.2, "vesc": 3.0}
"""Profiles whose drives stop by themselves, and seconds within which they are at rest: 0.5 s of the
watchdog and the way of braking, or of running out, where the torque goes."""


@asynccontextmanager
async def gateway(profile: str) -> AsyncGenerator[tuple[Any, Twin]]:
    """Run a gateway in a process of its own; yield it with the twin that it turns."""
    channel, node = group(), MOTORS[profile]["node"]
    twin = make_twin(profile, node)
    twin.plant.friction = 0.01  # so that what runs out does so in the time of a test
    command = [sys.executable, "-m", "backends.can.lone_gateway", channel, f"{profile}:{node}"]
    with Bench(line(channel, fd=profile == "moteus"), [twin]):
        child = await asyncio.create_subprocess_exec(
            *command, stdout=asyncio.subprocess.PIPE, cwd=TESTS
        )
        try:
            assert child.stdout is not None
            async with asyncio.timeout(60):
                while (heard := await child.stdout.readline()) != b"turning\n":
                    assert heard, "the gateway ended early"
            yield child, twin
        finally:
            if child.returncode is None:
                os.kill(child.pid, signal.SIGKILL)
                await child.wait()


@pytest.mark.parametrize("how", [signal.SIGSTOP, signal.SIGKILL], ids=["frozen", "killed"])
@pytest.mark.paired
@pytest.mark.parametrize("profile", WATCHED)
@in_one_of_three_attempts
async def test_a_drive_with_a_watchdog_comes_to_rest_without_its_gateway(
    profile: str, how: signal.Signals, record_property: Any
) -> None:
    async with gateway(profile) as (child, twin):
        assert twin.plant.velocity > 1.0
        with measured_load() as load:
            os.kill(child.pid, how)
            began = time.monotonic()
            with anyio.fail_after(60):
                while abs(twin.plant.velocity) > 0.05:  # noqa: ASYNC110  # a thread turns it
                    await asyncio.sleep(0.002)
            took = time.monotonic() - began
        record_property("seconds_to_rest", round(took, 3))
        print(f"{profile} {how.name}: at rest after {took:.3f} s")  # noqa: T201
        in_time_under(load, took, WATCHED[profile])
        stood = twin.plant.position
        for _ in range(100):
            assert abs(twin.plant.velocity) < 0.05
            await asyncio.sleep(0.005)
        assert twin.plant.position == pytest.approx(stood, abs=0.02)


# What the guard process is to send


async def planned(profile: str) -> tuple[str, Any]:
    """Return the bus and the plan of a backend with one motor on it."""
    name, node = group(), MOTORS[profile]["node"]
    table = {"bus": "can0", "profile": profile, "node": node}
    bus = {"interface": "udp_multicast", "channel": name, "fd": profile == "moteus"}
    async with opened({"buses": {"can0": bus}, "motors": {"m": table}, "grace": 0.0}) as rig:
        plan = rig.host.plans.get("can/can0")
    assert rig.host.plans.get("can/can0") is None  # it is taken back
    return name, plan


@pytest.mark.paired
@pytest.mark.parametrize("profile", [name for name in MOTORS if name != "moteus"])
@in_one_of_three_attempts
async def test_the_frames_of_the_plan_stop_a_drive_that_turns(profile: str) -> None:
    name, plan = await planned(profile)
    assert plan.sender == "can"
    twin = make_twin(profile, MOTORS[profile]["node"])
    with Bench(line(name), [twin]) as bench:
        bench.order(lambda: turn(twin))
        with anyio.fail_after(60):
            while twin.plant.velocity < 1.0:  # noqa: ASYNC110
                await asyncio.sleep(0.002)
        arguments = dict(plan.data["bus"])
        guard = can.Bus(
            arguments.pop("channel"), arguments.pop("interface"), ignore_config=True, **arguments
        )
        try:
            began = time.monotonic()
            with measured_load() as load, anyio.fail_after(60):
                while abs(twin.plant.velocity) > 0.05:
                    replay(guard, plan)
                    await asyncio.sleep(plan.period)
                took = time.monotonic() - began
            in_time_under(load, took, 0.5)
            stood = twin.plant.position
            for _ in range(10):
                replay(guard, plan)
                await asyncio.sleep(plan.period)
            assert twin.plant.position == pytest.approx(stood, abs=0.02)
        finally:
            guard.shutdown()


@pytest.mark.parametrize("profile", [name for name in MOTORS if name not in ("moteus", "vesc")])
async def test_the_frames_of_the_plan_switch_nothing_on(profile: str) -> None:
    name, plan = await planned(profile)
    twin = make_twin(profile, MOTORS[profile]["node"])
    with Bench(line(name), [twin]):
        guard = line(name)
        try:
            for _ in range(10):
                replay(guard, plan)
                await asyncio.sleep(0.02)
        finally:
            guard.shutdown()
        assert not twin.enabled
        assert twin.plant.loop == "off"


async def test_a_bus_that_no_other_process_can_open_has_no_plan() -> None:
    async with motor("odrive") as rig:
        assert rig.host.plans == {}


async def test_safe_values_of_devices_are_in_the_plan(tmp_path: Path) -> None:
    dbc = tmp_path / "gripper.dbc"
    dbc.write_text(
        'VERSION ""\n\nBU_: A\n\nBO_ 256 Jaw: 2 A\n SG_ Force : 0|16@1+ (1,0) [0|65535] "N" A\n'
    )
    device = {"bus": "can0", "dbc": str(dbc), "write": ["Jaw"], "safe": {"Jaw": {"Force": 7}}}
    bus = {"interface": "udp_multicast", "channel": group()}
    async with opened({"buses": {"can0": bus}, "devices": {"gripper": device}}) as rig:
        plan = rig.host.plans["can/can0"]
        assert plan is not None
        (frame,) = plan.data["frames"]
        assert (frame["id"], bytes.fromhex(frame["data"])) == (256, b"\x07\0")


async def test_what_is_safe_is_sent_by_a_halt_that_sent_nothing_before(tmp_path: Path) -> None:
    dbc = tmp_path / "gripper.dbc"
    dbc.write_text(
        'VERSION ""\n\nBU_: A\n\nBO_ 256 Jaw: 2 A\n SG_ Force : 0|16@1+ (1,0) [0|65535] "N" A\n'
    )
    device = {"bus": "can0", "dbc": str(dbc), "write": ["Jaw"], "safe": {"Jaw": {"Force": 0}}}
    name = channel()
    bus = {"interface": "virtual", "channel": name}
    other = can.Bus(name, "virtual", ignore_config=True)
    try:
        async with opened({"buses": {"can0": bus}, "devices": {"gripper": device}}) as rig:
            for act in (rig.backend.halt, lambda: rig.backend.hold_stop(None)):
                done = act()
                if done is not None:
                    await done
                message = await anyio.to_thread.run_sync(other.recv, 5.0)
                assert message is not None
                assert (message.arbitration_id, bytes(message.data)) == (256, b"\0\0")
    finally:
        other.shutdown()


def replay(bus: can.BusABC, plan: Any) -> None:
    """Send the frames of a plan, as the guard process does."""
    for frame in plan.data["frames"]:
        bus.send(
            can.Message(
                arbitration_id=frame["id"],
                data=bytes.fromhex(frame["data"]),
                is_extended_id=frame["extended"],
                is_fd=frame["fd"],
                bitrate_switch=frame["brs"],
            )
        )


def turn(twin: Any) -> None:
    """Have a twin turn as somebody left it: enabled, with a velocity."""
    twin.enabled = True
    twin.plant.loop, twin.plant.goal = "velocity", 2.0
    if hasattr(twin, "local"):
        twin.state, twin.local.nmt.state = "enabled", "OPERATIONAL"
    elif hasattr(twin, "error"):
        twin.state = 8
    twin.feed()
