"""One motor model for every make: what holds for one profile holds for all."""

from __future__ import annotations

import asyncio
from typing import Any

import anyio
import can
import pytest

from backends.can.rig import MOTORS, motor
from rcp_can.profiles.moteus_wire import REGISTERS, Access, Kind, Width, build, pad, parse
from rcp_can.sim import make_twin
from rcp_kernel.errors import (
    AdapterUnavailable,
    ConfigError,
    DeviceRejected,
    DeviceTimeout,
    ModeForbids,
    OutOfRange,
)

every_profile = pytest.mark.parametrize("profile", MOTORS)
POSITIONED = [name for name in MOTORS if name != "vesc"]
TELLS_POWER = [name for name in POSITIONED if name not in ("mit", "tmotor")]
TELLS_FAULTS = [name for name in POSITIONED if name != "mit"]
ZEROES = [name for name in POSITIONED if name != "cia402"]
can_be_positioned = pytest.mark.parametrize("profile", POSITIONED)


@every_profile
async def test_it_is_heard_of_at_once_and_is_switched_off(profile: str) -> None:
    async with motor(profile) as rig:
        assert rig.axis.state == "disabled"
        assert rig.host.last("sensor/m/motion").position == pytest.approx(0, abs=0.02)
        assert rig.host.reports == []
        assert not rig.twin.enabled


@every_profile
async def test_enabling_is_never_implied(profile: str) -> None:
    async with motor(profile) as rig:
        for mode in rig.axis.drive.modes:
            with pytest.raises(ModeForbids, match="disabled") as caught:
                await rig.write(f"actuator/m/{mode}", 0.5)
            assert "service/m/enable" in caught.value.remedy
        await rig.write("actuator/m/velocity", 0.0)  # a stop is taken in any state
        await asyncio.sleep(0.1)
        assert not rig.twin.enabled
        assert rig.twin.commands == []


@every_profile
async def test_it_is_enabled_at_rest_and_disabled_again(profile: str) -> None:
    async with motor(profile) as rig:
        await rig.enable()
        await rig.until(lambda: rig.twin.enabled)
        assert rig.axis.state == "enabled"
        assert rig.twin.plant.velocity == pytest.approx(0, abs=0.05)
        await rig.ran("service/m/disable")
        await rig.until(lambda: not rig.twin.enabled)
        await rig.host.published_as("sensor/m/state", state="disabled")


@every_profile
async def test_a_velocity_is_that_of_the_joint_behind_the_gear(profile: str) -> None:
    async with motor(profile, gear=2.0, direction=-1) as rig:
        await rig.enable()
        await rig.write("actuator/m/velocity", 3.0)
        await rig.until(lambda: abs(rig.twin.plant.velocity + 6.0) < 0.1)
        await rig.host.until(lambda: abs(rig.host.last("sensor/m/motion").velocity - 3.0) < 0.1)
        await rig.write("actuator/m/velocity", 0.0)
        await rig.until(lambda: abs(rig.twin.plant.velocity) < 0.1)


@every_profile
async def test_a_torque_is_that_of_the_joint_behind_the_gear(profile: str) -> None:
    async with motor(profile, gear=2.0, direction=-1) as rig:
        await rig.enable()
        await rig.write("actuator/m/torque", 0.2)
        await rig.until(lambda: abs(rig.twin.plant.torque + 0.1) < 0.02)
        await rig.until(lambda: rig.axis.velocity > 0)
        await rig.write("actuator/m/torque", 0.0)


@can_be_positioned
async def test_a_move_completes_where_it_was_to_go(profile: str) -> None:
    async with motor(profile, gear=2.0, direction=-1, offset=0.5, velocity=20) as rig:
        await rig.enable()
        moved = await rig.ran("action/m/move_to", {"position": 1.5})
        assert moved["position"] == pytest.approx(1.5, abs=0.02)
        assert rig.twin.plant.position == pytest.approx(-2.0, abs=0.04)
        assert abs(rig.twin.plant.velocity) < 0.5


@can_be_positioned
async def test_a_position_is_kept_to(profile: str) -> None:
    async with motor(profile, velocity=20, acceleration=100) as rig:
        await rig.enable()
        await rig.write("actuator/m/position", 0.7)
        await rig.until(lambda: abs(rig.twin.plant.position - 0.7) < 0.02)


@every_profile
async def test_a_ramp_lets_no_velocity_jump(profile: str) -> None:
    async with motor(profile, acceleration=10, velocity=20, rate=100) as rig:
        await rig.enable()
        started = asyncio.get_running_loop().time()
        await rig.write("actuator/m/velocity", 5.0)
        await rig.until(lambda: rig.axis.ramp.velocity >= 5.0)
        assert asyncio.get_running_loop().time() - started > 0.4
        await rig.until(lambda: abs(rig.twin.plant.velocity - 5.0) < 0.2)


@every_profile
async def test_a_halt_is_a_quick_stop_and_nothing_moves_after_it(profile: str) -> None:
    async with motor(profile) as rig:
        await rig.enable()
        await rig.write("actuator/m/velocity", 5.0)
        await rig.until(lambda: rig.twin.plant.velocity > 4.5)
        with anyio.fail_after(60):
            await rig.backend.halt()
        assert abs(rig.twin.plant.velocity) < 0.1
        await asyncio.sleep(0.1)
        assert abs(rig.twin.plant.velocity) < 0.1
        assert rig.axis.mode in (None, "velocity")


@can_be_positioned
async def test_a_cancelled_move_has_come_to_rest_before_it_ends(profile: str) -> None:
    async with motor(profile, velocity=2.0) as rig:
        await rig.enable()
        moving = asyncio.ensure_future(rig.execute("action/m/move_to", {"position": 8.0}))
        await rig.until(lambda: rig.twin.plant.velocity > 1.0)
        with pytest.raises(ModeForbids, match="driven by"):
            await rig.write("actuator/m/velocity", 1.0)
        moving.cancel()
        await asyncio.wait((moving,), timeout=60)
        assert moving.cancelled()
        assert abs(rig.twin.plant.velocity) < 0.1
        assert rig.twin.plant.position < 7.0


@can_be_positioned
async def test_a_move_reports_how_far_it_is(profile: str) -> None:
    async with motor(profile, velocity=4.0) as rig:
        await rig.enable()
        await rig.ran("action/m/move_to", {"position": 2.0})
        parts = [fraction for _, fraction in rig.feedback]
        assert parts == sorted(parts)
        assert rig.feedback[1][0].left > rig.feedback[-1][0].left


@can_be_positioned
async def test_a_goal_beyond_the_limits_is_out_of_range(profile: str) -> None:
    async with motor(profile, position=[-1.0, 1.0]) as rig:
        await rig.enable()
        with pytest.raises(OutOfRange, match=r"1\.5 rad is not within -1 and 1 rad"):
            await rig.ran("action/m/move_to", {"position": 1.5})


@every_profile
async def test_no_velocity_leads_out_of_the_positions_that_are_allowed(profile: str) -> None:
    async with motor(profile, position=[-0.5, 0.5], rate=200) as rig:
        await rig.enable()
        await rig.write("actuator/m/velocity", 2.0)
        await rig.until(lambda: rig.axis.position > 0.5)
        await rig.until(lambda: abs(rig.twin.plant.velocity) < 0.1)
        assert rig.twin.plant.position < 0.8
        await rig.write("actuator/m/velocity", -2.0)
        await rig.until(lambda: rig.twin.plant.velocity < -1.0)


@pytest.mark.parametrize("profile", TELLS_POWER)
async def test_a_drive_that_will_not_switch_on_is_told(profile: str) -> None:
    async with motor(profile) as rig:
        rig.twin.refuses = True
        with pytest.raises(DeviceTimeout, match="enabled"):
            await rig.enable()
        with pytest.raises(ModeForbids):
            await rig.write("actuator/m/velocity", 1.0)


@pytest.mark.parametrize("profile", TELLS_FAULTS)
async def test_a_fault_is_told_by_name_ends_the_move_and_is_cleared_without_moving(
    profile: str,
) -> None:
    async with motor(profile, velocity=2.0) as rig:
        await rig.enable()
        moving = asyncio.ensure_future(rig.execute("action/m/move_to", {"position": 8.0}))
        await rig.until(lambda: rig.twin.plant.velocity > 1.0)
        await rig.ordered(rig.twin.break_down)
        with pytest.raises((ModeForbids, DeviceRejected), match=r"no longer enabled|2310"):
            await asyncio.wait_for(moving, 60)
        state = await rig.host.published_as("sensor/m/state", state="fault")
        assert any(word in str(state.faults) for word in ("over-current", "2310", "driver_fault"))
        with pytest.raises(ModeForbids, match="fault") as caught:
            await rig.write("actuator/m/velocity", 1.0)
        assert "clear_faults" in caught.value.remedy
        await rig.ran("service/m/clear_faults")
        await rig.host.published_as("sensor/m/state", state="disabled", faults=[])
        assert not rig.twin.enabled
        assert rig.faults(active=False)
        await rig.enable()
        taken = len(rig.twin.commands)
        await asyncio.sleep(0.1)
        assert all(value == pytest.approx(0, abs=0.02) for _, value in rig.twin.commands[taken:])


@every_profile
async def test_silence_is_a_fault_that_ends_the_move_and_nothing_moves_when_it_is_over(
    profile: str,
) -> None:
    async with motor(profile, velocity=2.0) as rig:
        await rig.enable()
        await rig.write("actuator/m/velocity", 2.0)
        await rig.until(lambda: rig.twin.plant.velocity > 1.5)
        rig.twin.silent = True
        await rig.host.published_as("sensor/m/state", state="offline")
        assert {"feedback_lost", "heartbeat_lost"} & set(rig.faults())
        words = ("silent", "no message received", "heartbeat lost")
        assert any(text in (rig.host.reports[-1] or "") for text in words)
        for call in (rig.write("actuator/m/velocity", 0.0), rig.execute("service/m/enable")):
            with pytest.raises(AdapterUnavailable, match="does not respond"):
                await call
        rig.twin.silent = False
        await rig.host.until(lambda: rig.axis.online)
        await rig.until(lambda: abs(rig.twin.plant.velocity) < 0.1)
        assert rig.axis.mode in (None, "velocity")
        assert rig.axis.goal == 0.0 or rig.axis.mode is None
        await rig.host.until(lambda: rig.host.reports[-1] is None)


@pytest.mark.parametrize("profile", TELLS_POWER)
async def test_a_drive_that_boots_in_motion_is_not_set_going_again(profile: str) -> None:
    # Its own watchdog would switch it off where a busy machine is late.
    async with motor(profile, velocity=2.0, watchdog=10.0) as rig:
        await rig.enable()
        moving = asyncio.ensure_future(rig.execute("action/m/move_to", {"position": 8.0}))
        await rig.until(lambda: rig.twin.plant.velocity > 1.0)
        await rig.ordered(rig.twin.boot)
        with pytest.raises((ModeForbids, AdapterUnavailable)):
            await asyncio.wait_for(moving, 60)
        await rig.host.until(lambda: {"reset", "switched_off"} & set(rig.faults()))
        await asyncio.sleep(0.2)
        assert not rig.twin.enabled
        assert rig.axis.state == "disabled"
        await rig.enable()
        await rig.ran("action/m/move_to", {"position": rig.axis.position + 0.2})


async def test_a_moteus_that_a_stray_set_point_enables_after_its_boot_is_stopped_by_off() -> None:
    async with motor("moteus") as rig:
        await rig.enable()
        drive, sent = rig.axis.drive, list[can.Message]()
        rig.backend.buses["can0"].taps.append(sent.append)
        for clock in (10_000_000.0, 5.0):  # ms: it has rebooted, and is on all the same
            told = (("mode", Width.INT8, 10.0), ("milliseconds", Width.INT32, clock))
            accesses = [Access(Kind.REPLY, REGISTERS[n].number, w, value) for n, w, value in told]
            drive.take(can.Message(arbitration_id=0x100, data=pad(build(accesses)), is_fd=True))
        drive.stop()  # as a command does that the reboot ended
        writes = [a for frame in sent for a in parse(bytes(frame.data)) if a.kind == Kind.WRITE]
        assert [(a.register, a.value) for a in writes] == [(0, 0.0), (0, 0.0)]


@pytest.mark.parametrize("profile", ZEROES)
async def test_the_present_position_can_be_made_zero(profile: str) -> None:
    async with motor(profile, velocity=20) as rig:
        await rig.enable()
        await rig.ran("action/m/move_to", {"position": 1.0})
        await rig.ran("service/m/disable")
        await rig.ran("service/m/set_zero")
        assert rig.twin.plant.position == pytest.approx(0, abs=0.05)


@pytest.mark.parametrize("profile", ZEROES)
async def test_a_zero_that_the_drive_does_not_take_is_not_confirmed(profile: str) -> None:
    async with motor(profile) as rig:

        def displace() -> None:
            rig.twin.keeps_zero = True
            rig.twin.plant.position = 0.015  # rad, which is near zero, but not there

        await rig.ordered(displace)
        await rig.until(lambda: abs((rig.axis.position or 0.0) - 0.015) < 0.001)
        with pytest.raises(DeviceTimeout, match="at zero"):
            await rig.ran("service/m/set_zero")


async def test_a_zero_is_confirmed_by_reports_from_after_the_request_alone() -> None:
    async with motor("odrive") as rig:
        await rig.until(lambda: rig.axis.position is not None)  # at zero, before anything is sent
        await rig.ordered(lambda: setattr(rig.twin, "blind", True))
        await rig.until(lambda: not rig.axis.is_fresh("position"))  # nothing of it is under way
        with pytest.raises(DeviceTimeout, match="at zero"):
            await rig.axis.drive.set_zero()


@pytest.mark.parametrize("profile", ["cia402", "odrive"])
async def test_homing_finds_the_reference(profile: str) -> None:
    async with motor(profile, velocity=20) as rig:
        await rig.enable()
        await rig.ran("action/m/move_to", {"position": 1.0})
        await rig.ran("action/m/home")
        assert rig.twin.plant.position == pytest.approx(0, abs=0.01)
        assert rig.host.last("sensor/m/state").homed is True
        assert rig.axis.state == "enabled"


@pytest.mark.parametrize("profile", ["odrive", "mit", "damiao", "cybergear", "moteus"])
async def test_two_drives_with_one_id_are_told(profile: str) -> None:
    table = MOTORS[profile]
    other = make_twin(profile, table["node"], **table.get("options", {}), serial=77)
    async with motor(profile, twins=[other]) as rig:
        await rig.host.until(lambda: "duplicate_node" in rig.faults())


async def test_two_canopen_nodes_with_one_id_are_told() -> None:
    async with motor("cia402", twins=[make_twin("cia402", 5)]) as rig:
        await rig.host.until(lambda: "duplicate_node" in rig.faults())


async def test_a_joint_that_is_held_fast_is_told_and_left_at_rest() -> None:
    async with motor("mit", velocity=100.0, options={"kp": 0.001, "kd": 0.0}) as rig:
        await rig.enable()
        rig.twin.plant.stiction = 100.0
        with pytest.raises(DeviceRejected, match="did not come closer"):
            await rig.ran("action/m/move_to", {"position": 1.0}, seconds=12)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            {"node": 64, "profile": "rcp_can.profiles.odrive:PROFILE"},
            r"motors\.m\.node: rcp_can\.profiles\.odrive:PROFILE has nodes 0 to 63",
        ),
        ({"options": {"gears": 1}}, r"motors\.m\.options: .*gears"),
    ],
)
async def test_a_motor_that_cannot_be_is_a_configuration_error(
    change: dict[str, Any], words: str
) -> None:
    from backends.can.rig import channel, opened

    table = {"bus": "can0", "profile": "odrive", "node": 1, **change}
    bus = {"interface": "virtual", "channel": channel()}
    with pytest.raises(ConfigError, match=words):
        async with opened({"buses": {"can0": bus}, "motors": {"m": table}}):
            pass
