"""Watchdogs are told as the drive has them, and what can move is declared."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import msgspec
import pytest

from backends.can.peers import drive_eds
from backends.can.rig import channel, motor, opened
from backends.can.test_joints import arm
from rcp_can.config_motor import MotorConfig


@pytest.mark.parametrize(
    ("profile", "within", "verified"),
    [
        ("cia402", 0.5, True),
        ("odrive", None, False),
        ("mit", None, False),
        ("tmotor", None, False),
        ("damiao", 0.5, True),
        ("cybergear", 0.5, True),
        ("moteus", 0.5, True),
        ("vesc", 1.0, False),
    ],
)
async def test_watchdogs_are_told_as_the_drive_has_them(
    profile: str,
    within: float | None,
    verified: bool,  # noqa: FBT001
) -> None:
    async with motor(profile, watchdog=0.5) as rig:
        await rig.enable()
        if verified:
            await rig.until(lambda: rig.backend.watchdogs()[0].verified)
        (found,) = rig.backend.watchdogs()
        assert (found.within, found.verified, found.robot) == (within, verified, "m")
        assert found.mechanism


@pytest.mark.parametrize("profile", ["cia402", "damiao", "cybergear"])
async def test_a_watchdog_that_is_left_alone_is_told_to_be_off(profile: str) -> None:
    async with motor(profile, watchdog=False) as rig:
        await rig.until(lambda: rig.axis.configured)
        (found,) = rig.backend.watchdogs()
        assert found.within is None
        assert not rig.axis.drive.protection.verified


async def test_an_odrive_with_a_watchdog_is_fed_at_rest_and_in_a_move() -> None:
    async with motor("odrive", velocity=1.0, options={"trapezoid": True}) as rig:
        rig.twin.watchdog = 0.4
        await rig.enable()
        await asyncio.sleep(0.6)
        assert rig.twin.enabled
        await rig.ran("action/m/move_to", {"position": 1.5})
        assert rig.twin.enabled
        rig.twin.deaf = True
        await rig.until(lambda: not rig.twin.enabled)


async def test_what_energises_or_moves_is_declared() -> None:
    async with arm() as rig:
        resources = rig.host.resources
        for name in ("service/pan/enable", "service/arm/enable"):
            assert resources[name].energises
        for name in ("service/pan/disable", "service/pan/clear_faults", "service/arm/disable"):
            assert not resources[name].energises


@pytest.mark.parametrize(
    ("keys", "words"),
    [({"watchdog": True}, "a time in s, or false"), ({"rate": 4.0}, "shorter than 3 periods")],
)
def test_a_watchdog_that_could_not_be_fed_is_refused(keys: dict[str, Any], words: str) -> None:
    table = {"bus": "can0", "profile": "cia402", "node": 5, **keys}
    with pytest.raises(msgspec.ValidationError, match=words):
        msgspec.convert(table, MotorConfig)


async def test_writing_what_moves_a_node_is_declared_to_move(tmp_path: Path) -> None:
    eds = drive_eds(tmp_path / "drive.eds", node=9)
    bus = {"interface": "virtual", "channel": channel(), "raw_send": True}
    node = {"bus": "can0", "node": 9, "eds": str(eds), "objects": ["0x1000-0xFFFF"]}
    async with opened({"buses": {"can0": bus}, "nodes": {"io": node}}) as rig:
        found = {r.meta["index"]: r.moves for r in rig.host.resources.values() if "index" in r.meta}
        assert found
        assert all(moves == (index >= "0x6000") for index, moves in found.items())
        assert rig.host.resources["actuator/can/can0/frame"].moves
