"""A stop holds, whatever the bus, the drive or another master does: the twin's plant is the witness."""

from __future__ import annotations

import asyncio
import random
import struct
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import anyio
import can
import msgspec
import pytest

from backends.can.peers import drive_eds
from backends.can.rig import MOTORS, Motor, Node, channel, motor, opened
from backends.can.test_gateway_gone import turn
from backends.can.test_joints import arm
from rcp_can.axis_state import Loss
from rcp_can.config_motor import MotorConfig
from rcp_can.sim import Bench, Plant, make_twin
from rcp_kernel.contract.fence import permitted
from rcp_kernel.errors import (
    AdapterUnavailable,
    DeviceRejected,
    DeviceTimeout,
    EstopActive,
    ModeForbids,
    RcpError,
)

every_profile = pytest.mark.parametrize("profile", MOTORS)
GOES_BLIND = ["cia402", "odrive", "moteus", "vesc"]
"""Drives whose feedback can fail while something else goes on."""


async def stays_at_rest(rig: Motor, seconds: float = 0.5) -> None:
    """See that the plant does not turn for a while."""
    began = rig.twin.plant.position
    end = asyncio.get_running_loop().time() + seconds
    while asyncio.get_running_loop().time() < end:
        assert abs(rig.twin.plant.velocity) < 0.1
        await asyncio.sleep(0.005)
    assert abs(rig.twin.plant.position - began) < 0.05


async def turns(rig: Motor, velocity: float = 2.0) -> None:
    await rig.enable()
    await rig.write("actuator/m/velocity", velocity)
    await rig.until(lambda: rig.twin.plant.velocity > 0.7 * velocity)


# Feedback, signal by signal


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


async def test_the_torque_goes_some_time_after_a_stop_where_that_is_configured() -> None:
    for profile in ("cia402", "odrive", "damiao", "moteus"):
        async with motor(profile, torque_off_after=0.3) as rig:
            await turns(rig)
            await rig.backend.halt()
            assert rig.host.last("sensor/m/state").energised
            await rig.host.published_as("sensor/m/state", energised=False, state="disabled")
            await rig.until(lambda r=rig: not r.twin.enabled and r.twin.plant.loop == "off")
            await stays_at_rest(rig, 0.2)
            rig.backend.hold_stop(None)
            await asyncio.sleep(0.1)
            assert rig.twin.plant.loop == "off"
            await rig.enable()


@pytest.mark.parametrize("profile", ["vesc", "odrive", "cia402"])
@pytest.mark.usefixtures("stands_still")
async def test_a_gateway_that_stood_still_sends_no_set_point_of_before(profile: str) -> None:
    slow = {"timeout": 3.0, "feedback_timeout": 3.0, "watchdog": 0.5}
    async with motor(profile, valid_for=60.0, **slow) as rig:
        await turns(rig)
        taken = len(rig.twin.commands)
        time.sleep(0.8)  # noqa: ASYNC251  # the loop is what stands still
        # the one of CANopen has left operational meanwhile: its watchdog has expired
        await rig.host.until(lambda: {"gateway_stalled", "reset"} & set(rig.faults()))
        await rig.until(lambda: abs(rig.twin.plant.velocity) < 0.1)
        await stays_at_rest(rig)
        assert all(abs(value) < 0.05 for _, value in rig.twin.commands[taken:][3:])


# What a halt says


async def test_a_quick_stopped_drive_is_said_to_hold_torque() -> None:
    async with motor("cia402") as rig:
        await turns(rig)
        await rig.backend.halt()
        assert rig.twin.state == "quick_stop"
        state = await rig.host.published_as("sensor/m/state", state="quick_stop")
        assert state.energised is True
        motion = rig.backend.motion(None)
        assert (motion.at_rest, motion.energised) == (True, True)


@pytest.mark.parametrize("option", [2, 6])
async def test_what_follows_a_quick_stop_is_what_is_configured(option: int) -> None:
    async with motor("cia402", options={"quick_stop": option}) as rig:
        await turns(rig)
        await rig.backend.halt()
        await rig.host.published_as("sensor/m/state", energised=option == 6)
        assert rig.twin.state == ("quick_stop" if option == 6 else "switch_on_disabled")


@every_profile
async def test_a_motor_that_is_silent_is_no_confirmed_stop_and_is_stopped_when_it_is_back(
    profile: str,
) -> None:
    async with motor(profile) as rig:
        await turns(rig)
        rig.twin.silent = True
        with pytest.raises(RcpError) as caught:
            await rig.backend.halt()
        assert isinstance(caught.value, AdapterUnavailable | DeviceTimeout)
        rig.host.latched = True
        rig.host.on_restored = lambda: rig.backend.hold_stop(None)
        await rig.host.published_as("sensor/m/state", state="offline")
        with pytest.raises(AdapterUnavailable):
            await rig.backend.halt()
        assert rig.backend.motion(None).at_rest is None
        rig.twin.silent = False
        await rig.until(lambda: rig.host.restored)
        await rig.until(lambda: abs(rig.twin.plant.velocity) < 0.1)
        await stays_at_rest(rig)
        await rig.until(lambda: rig.axis.configured)
        await rig.backend.halt()


@pytest.mark.parametrize("optional", [False, True])
async def test_a_motor_that_was_never_heard_is_named_and_the_others_are_stopped(
    optional: bool,  # noqa: FBT001
) -> None:
    absent = {"bus": "can0", "profile": "odrive", "node": 9, "optional": optional}
    patient = {"timeout": 10.0, "feedback_timeout": 10.0}  # two gateways and a busy machine
    async with motor("odrive", **patient) as sole:
        table = {"bus": "can0", "profile": "odrive", "node": 1, **patient}
        bus = {"interface": "virtual", "channel": sole.channel}
        motors = {"m": table, "gripper": absent}
        async with opened({"buses": {"can0": bus}, "motors": motors, "grace": 0.2}) as rig:
            await sole.until(lambda: rig.backend.axes["m"].configured)
            await rig.ran("service/m/enable")
            await rig.write("actuator/m/velocity", 2.0)
            await sole.until(lambda: sole.twin.plant.velocity > 1.0)
            if optional:
                await rig.backend.halt()
                assert rig.backend.motion(None).at_rest is True
            else:
                with pytest.raises(AdapterUnavailable, match="gripper"):
                    await rig.backend.halt()
                assert rig.backend.motion(None).at_rest is None
            assert abs(sole.twin.plant.velocity) < 0.1


# Other masters, lost frames, nodes that go away


def rpdo(control: int, mode: int = 3) -> bytes:
    return bytes((control, 0, mode)) + bytes(4)


BY: dict[str, tuple[bool, Callable[[Motor], None]]] = {
    "axis": (True, lambda _rig: None),
    "kernel": (False, lambda rig: rig.backend.hold_stop(None)),
}
"""Who stops a drive again that another master moves, each without the other: the backend's own look after
what is latched, and what the kernel calls for as long as it is."""
by_either = pytest.mark.parametrize("by", BY)


@by_either
async def test_another_master_that_enables_a_stopped_drive_moves_it_for_a_moment_only(
    by: str,
) -> None:
    async with motor("cia402") as rig:
        await turns(rig)
        await rig.backend.halt()
        rig.host.latched, stop_again = BY[by]
        with Node(rig.channel) as node:
            for _ in range(6):
                taken = len(rig.twin.commands)
                await rig.until(lambda: not rig.axis.stopping)
                node.send(0x205, rpdo(0x0F))  # out of quick stop active (CiA 402-2, transition 16)
                node.send(0x305, (3000).to_bytes(4, "little") + bytes(2))
                await rig.until(lambda n=taken: len(rig.twin.commands) > n)
                await rig.until(lambda: stop_again(rig) or rig.twin.state == "quick_stop")
            await rig.until(lambda: abs(rig.twin.plant.velocity) < 0.1)
        await stays_at_rest(rig)
        assert rig.twin.state != "enabled"


PUSHED: Any = ("velocity", 3.0)


def pushed(plant: Plant) -> None:
    """Turn for good, as another master orders."""
    plant.loop, plant.goal = PUSHED


@pytest.mark.parametrize("profile", ["odrive", "mit", "moteus"])
async def test_a_drive_that_another_master_pushes_is_stopped_again(profile: str) -> None:
    async with motor(profile) as rig:
        await turns(rig)
        await rig.backend.halt()
        rig.host.latched = True
        for _ in range(3):
            await rig.until(lambda: not rig.axis.stopping)
            await rig.ordered(lambda: pushed(rig.twin.plant))
            plant = rig.twin.plant
            await rig.until(lambda p=plant: (p.loop, p.goal) != PUSHED)
            await rig.until(lambda: abs(rig.twin.plant.velocity) < 0.1)
        await stays_at_rest(rig)


@pytest.mark.parametrize("profile", ["odrive", "damiao", "moteus"])
async def test_a_drive_that_another_master_powers_and_pushes_is_cut_off_again(
    profile: str,
) -> None:
    async with motor(profile, torque_off_after=0.1) as rig:
        await turns(rig)
        await rig.backend.halt()
        for _ in range(3):
            await rig.until(lambda: rig.axis.released and rig.twin.plant.loop == "off")
            await rig.host.published_as("sensor/m/state", energised=False)
            await rig.ordered(lambda: (turn(rig.twin), pushed(rig.twin.plant)))
            await rig.host.published_as("sensor/m/state", energised=True)
            assert rig.twin.plant.velocity > 0.0
            await rig.until(lambda: rig.backend.hold_stop(None) or rig.twin.plant.loop == "off")
        await rig.until(lambda: abs(rig.twin.plant.velocity) < 0.1)
        await stays_at_rest(rig)


@every_profile
async def test_a_halt_is_confirmed_with_two_of_three_frames_lost(profile: str) -> None:
    async with motor(profile, timeout=3.0, feedback_timeout=3.0) as rig:
        await turns(rig)
        chance = random.Random(3)
        rig.bench.loses = lambda: chance.random() < 2 / 3
        with anyio.fail_after(60):
            for _ in range(5):
                with suppress(DeviceTimeout):
                    await rig.backend.halt()
                    break
        assert abs(rig.twin.plant.velocity) < 0.1
        await stays_at_rest(rig)
        rig.bench.loses = None


async def test_a_node_that_boots_while_it_is_being_stopped_ends_up_at_rest_and_off() -> None:
    async with motor("cia402") as rig:
        await turns(rig, 8.0)
        halting = asyncio.ensure_future(rig.backend.halt())
        await asyncio.sleep(0)
        await rig.ordered(rig.twin.boot)
        with suppress(RcpError):
            await asyncio.wait_for(halting, 60)
        await rig.until(lambda: rig.axis.configured)
        await rig.until(lambda: abs(rig.twin.plant.velocity) < 0.1)
        await rig.backend.halt()
        await stays_at_rest(rig)
        assert not rig.twin.enabled
        await rig.host.published_as("sensor/m/state", energised=False)


async def test_a_node_that_leaves_operational_while_it_turns_is_stopped_by_sdo() -> None:
    async with motor("cia402", watchdog=False) as rig:
        await turns(rig)
        with Node(rig.channel) as node:
            node.send(0x000, bytes((0x80, 5)))  # pre-operational: PDOs have no effect
            await rig.host.until(lambda: "reset" in rig.faults())
            (reset,) = (e for e in rig.host.events("event/m/fault") if e.fault == "reset")
            assert reset.text == "the drive left the NMT state operational while in use"
            await rig.until(lambda: abs(rig.twin.plant.velocity) < 0.1, 20.0)
            await stays_at_rest(rig)
            assert rig.twin.state != "enabled"


async def test_a_stop_of_a_bus_that_is_off_is_no_success_and_nothing_moves_when_it_is_back() -> (
    None
):
    async with motor("odrive", bus={"restart": 0.2}) as rig:
        await turns(rig)
        rig.host.on_restored = lambda: rig.backend.hold_stop(None)
        with Node(rig.channel) as node:
            node.bus_off()
            await rig.host.published_as("sensor/can/can0/state", state="bus_off")
            rig.host.latched = True
            with pytest.raises(AdapterUnavailable):
                await rig.backend.halt()
            await rig.until(lambda: abs(rig.twin.plant.velocity) < 0.1)
        await stays_at_rest(rig)
        await rig.backend.halt()


# Faults, enabling, holding


@every_profile
async def test_clearing_faults_of_a_healthy_turning_drive_leaves_it_turning(profile: str) -> None:
    async with motor(profile, valid_for=20.0) as rig:
        await turns(rig)
        slowest: list[float] = []
        await rig.ran("service/m/clear_faults")
        for _ in range(60):
            slowest.append(rig.twin.plant.velocity)
            await asyncio.sleep(0.005)
        assert min(slowest) > 1.0
        assert rig.axis.state == "enabled"
        assert rig.faults() == []


@pytest.mark.parametrize("profile", ["cia402", "odrive", "damiao", "cybergear", "moteus"])
async def test_an_enable_that_does_not_last_is_no_enable(profile: str) -> None:
    async with motor(profile) as rig:
        enabling = asyncio.ensure_future(rig.execute("service/m/enable"))
        await rig.until(lambda: rig.twin.enabled)
        await rig.ordered(rig.twin.break_down)
        with pytest.raises(DeviceRejected):
            await asyncio.wait_for(enabling, 60)
        assert rig.axis.state == "fault"


async def test_an_enable_in_which_contact_is_lost_does_not_blame_the_drive() -> None:
    async with motor("odrive") as rig:
        enabling = asyncio.ensure_future(rig.execute("service/m/enable"))
        await rig.until(lambda: rig.axis.wanted_on)
        rig.axis._lose(Loss("feedback_lost", "no message received for 0.5 s"))  # noqa: SLF001 - contact is lost between two steps, which no frame can time
        rig.axis.online = True  # and it is back before anybody looks
        with pytest.raises(AdapterUnavailable, match=r"no message received for 0.5 s"):
            await asyncio.wait_for(enabling, 60)
        await stays_at_rest(rig)


@pytest.mark.parametrize("profile", ["cia402", "damiao"])
async def test_an_enable_that_a_stop_cuts_off_leaves_the_drive_without_torque(profile: str) -> None:
    async with motor(profile) as rig:
        for late in range(6):
            enabling = asyncio.ensure_future(rig.execute("service/m/enable"))
            await asyncio.sleep(0.004 * late)
            halting = asyncio.ensure_future(rig.backend.halt())
            enabling.cancel()
            await asyncio.wait((enabling,), timeout=60)
            await asyncio.wait_for(halting, 60)
            await asyncio.sleep(0.1)
            assert rig.twin.state != "enabled" if profile == "cia402" else True
            assert abs(rig.twin.plant.velocity) < 0.1
            await rig.ran("service/m/disable")


@every_profile
async def test_a_hold_brings_it_to_rest_and_keeps_its_torque(profile: str) -> None:
    async with motor(profile, acceleration=20.0, valid_for=20.0) as rig:
        await turns(rig)
        await rig.backend.hold(None)
        assert abs(rig.twin.plant.velocity) < 0.1
        await stays_at_rest(rig)
        assert rig.twin.enabled
        assert rig.axis.state == "enabled"
        await rig.write("actuator/m/velocity", 1.0)  # no latch
        await rig.until(lambda: rig.twin.plant.velocity > 0.5)


@pytest.mark.parametrize("profile", [name for name in MOTORS if name != "vesc"])
async def test_a_hold_ends_the_move(profile: str) -> None:
    async with motor(profile, velocity=2.0) as rig:
        await rig.enable()
        moving = asyncio.ensure_future(rig.execute("action/m/move_to", {"position": 9.0}))
        await rig.until(lambda: rig.twin.plant.velocity > 1.0)
        await rig.backend.hold(None)
        with pytest.raises(ModeForbids, match="hold"):
            await asyncio.wait_for(moving, 60)
        await stays_at_rest(rig)
        assert rig.twin.enabled
        assert rig.twin.plant.position < 8.0


# The fence


class Unit:
    name, stops = "/tenant/alpha", 0


@pytest.mark.parametrize("cancel", ["before", "with", "after"])
async def test_no_set_point_of_a_cancelled_trajectory_follows_the_halt(cancel: str) -> None:
    async with arm() as rig:
        unit = Unit()

        async def move() -> Any:
            with permitted(unit, 0):
                return await rig.execute(
                    "action/arm/move_joints", {"positions": {"pan": 5.0, "tilt": 5.0, "roll": 5.0}}
                )

        moving = asyncio.ensure_future(move())
        await rig.until(lambda: all(t.plant.velocity > 1.0 for t in rig.twins.values()))
        unit.stops += 1
        if cancel == "before":
            moving.cancel()
            await asyncio.sleep(0)
        halting = asyncio.ensure_future(rig.backend.halt())
        await asyncio.sleep(0)
        if cancel == "with":
            moving.cancel()
        with anyio.fail_after(60):
            await halting
        assert rig.still()
        if cancel == "after":
            moving.cancel()
        await asyncio.wait((moving,), timeout=60)
        stood = {name: twin.plant.position for name, twin in rig.twins.items()}
        taken = {name: len(twin.commands) for name, twin in rig.twins.items()}
        for _ in range(60):
            assert rig.still()
            await asyncio.sleep(0.005)
        for name, twin in rig.twins.items():
            assert twin.plant.position == pytest.approx(stood[name], abs=0.02)
            assert all(abs(value) < 0.05 for _, value in twin.commands[taken[name] :])


@every_profile
async def test_what_a_stop_has_cut_off_can_send_nothing_that_moves(profile: str) -> None:
    async with motor(profile) as rig:
        unit = Unit()
        unit.stops = 1
        await rig.enable()
        calls: list[Callable[[], Any]] = [
            lambda: rig.write("actuator/m/velocity", 1.0),
            lambda: rig.execute("service/m/enable"),
        ]
        for call in calls:
            with permitted(unit, 0), pytest.raises(EstopActive):
                await call()
        with permitted(unit, 0):
            rig.axis.stop()  # a stop passes, whoever sends it
            await rig.execute("service/m/disable")
        await rig.until(lambda: not rig.twin.enabled)


# Watchdogs, and what is declared


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


async def test_reports_from_before_a_stop_do_not_confirm_it_however_late_they_are_read() -> None:
    async with motor("odrive", timeout=9.0, feedback_timeout=9.0) as rig:
        await rig.enable()
        await rig.ordered(lambda: setattr(rig.twin, "blind", True))
        seen = rig.axis.status.counts["velocity"]
        with Node(rig.channel) as node, rig.unread():
            await rig.ordered(lambda: None)  # the reader waits
            for _ in range(5):
                node.send(1 << 5 | 0x09, struct.pack("<ff", 0.0, 0.0))
            sent = time.monotonic()
            await rig.until(lambda: time.monotonic() - sent > 0.05)
            halting = asyncio.ensure_future(rig.backend.halt())
            await rig.until(lambda: rig.axis.stopping)
        await rig.until(lambda: rig.axis.status.counts["velocity"] >= seen + 5)
        done, _ = await asyncio.wait((halting,), timeout=0.2)
        assert not done
        await rig.ordered(lambda: setattr(rig.twin, "blind", False))
        await halting
