"""Detection of the motor of a VESC: measured, stored, and ended by nothing but a reboot."""

from __future__ import annotations

import asyncio
import math
import struct

import anyio
import pytest

from backends.can.rig import motor
from backends.can.test_gateway import bed
from rcp_can.profiles import vesc_detection as ours
from rcp_can.sim import make_twin
from rcp_kernel.errors import AdapterUnavailable, DeviceRejected, DeviceTimeout, ModeForbids

BODY = {"power_loss": 45.0}
LAYOUT = ours.LAYOUTS[776184161]
ENDS: dict[str, tuple[type[BaseException], str]] = {
    "cancel": (asyncio.CancelledError, "^$"),
    "halt": (ModeForbids, "halted"),
    "hold": (ModeForbids, "commanded to hold"),
    "at once": (ModeForbids, "halted"),
    "unheard": (AdapterUnavailable, "no message received"),
    "timeout": (DeviceTimeout, "no answer to command 58"),
}
"""What ends a detection, and the error that it ends with."""


def test_the_commands_are_those_of_the_firmware() -> None:
    # datatypes.h of firmware 6.00, COMM_PACKET_ID
    names = ("GET_MOTOR", "TERMINAL", "PRINT", "REBOOT", "DETECT")
    assert [getattr(ours, each) for each in names] == [14, 20, 21, 29, 58]


async def test_a_motor_is_measured_and_the_rest_of_the_drive_stays_as_it_was() -> None:
    async with motor("vesc", commissioning=True, position=[-1000.0, 1000.0]) as rig:
        twin = rig.twin
        rest, limits = twin.rest, list(twin.limits)
        found = await rig.ran("action/m/detect_motor", BODY)
        assert found["sensors"] == "hall"
        assert found["resistance"] == pytest.approx(0.05)
        assert found["inductance"] == pytest.approx(2e-5)
        assert found["flux_linkage"] == pytest.approx(0.0045)
        assert found["current_max"] == pytest.approx(math.sqrt(45.0 / 0.05))
        assert found["torque_constant"] == pytest.approx(1.5 * 7 * 0.0045)
        assert twin.plant.position > 1.0  # it did turn
        assert abs(twin.plant.velocity) < 0.1
        assert twin.rest == rest  # the status messages that the detection changed
        assert twin.limits == limits
        assert twin.stored_motor.get(LAYOUT.openloop_erpm) == 700.0
        assert twin.stored_motor.get(LAYOUT.sensorless_erpm) == 2500.0
        assert twin.stored_motor.get(LAYOUT.resistance) == pytest.approx(0.05)
        assert rig.axis.state == "disabled"
        await rig.enable()


async def test_a_position_that_pauses_while_the_drive_stores_ends_no_detection() -> None:
    async with motor("vesc", commissioning=True, position=[-1000.0, 1000.0]) as rig:
        twin, axis = rig.twin, rig.axis
        twin.detects, twin.pauses = 0.1, 0.6  # twice that is more than a position may be old
        usual, rest = axis.limit_of("position"), twin.rest
        assert (await rig.ran("action/m/detect_motor", BODY))["sensors"] == "hall"
        assert twin.rest == rest
        assert rig.faults() == []
        assert axis.limit_of("position") == usual == 1.0
        assert axis.is_fresh("position")
        await rig.enable()


@pytest.mark.parametrize(
    ("end", "error"),
    [
        ("cancel", asyncio.CancelledError),
        ("halt", ModeForbids),
        ("unanswered", (DeviceTimeout, AdapterUnavailable)),  # or, as soon, that it is put back
    ],
)
async def test_status_messages_are_put_back_whatever_ends_a_detection_that_has_stored(
    end: str,
    error: type[BaseException] | tuple[type[BaseException], ...],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("rcp_can.axis._RETRY", 0.1)
    async with motor("vesc", commissioning=True, position=[-1000.0, 1000.0]) as rig:
        twin, drive = rig.twin, rig.axis.drive
        twin.detects, rest = 0.1, twin.rest
        running = asyncio.ensure_future(rig.execute("action/m/detect_motor", BODY))
        await rig.until(lambda: twin.rest != rest)
        twin.deaf = True  # so that it does not take them back at once
        await rig.until(lambda: drive.application is not None and not drive.busy)
        with anyio.fail_after(60):
            if end == "cancel":
                running.cancel()
            elif end == "halt":
                await rig.backend.halt()
            with pytest.raises(error):
                await running
        assert twin.rest != rest
        assert rig.axis.limit_of("position") >= ours.LONGEST, "however long that detection took"
        with pytest.raises(AdapterUnavailable):
            await rig.enable()
        twin.deaf = False
        await rig.until(lambda: twin.rest == rest and rig.axis.configured)
        assert drive.application is None
        await rig.host.published_as("sensor/m/state", state="disabled")
        await rig.enable()


async def test_a_stop_while_the_drive_stores_leaves_no_other_status_messages() -> None:
    async with motor("vesc", commissioning=True, position=[-1000.0, 1000.0]) as rig:
        twin = rig.twin
        before, rest = bytes(twin.stored_motor.data), twin.rest
        twin.detects, twin.pauses = 0.1, 5.0
        running = asyncio.ensure_future(rig.execute("action/m/detect_motor", BODY))
        await rig.until(lambda: twin.rest != rest)
        with anyio.fail_after(60):
            await rig.backend.halt()
            with pytest.raises(ModeForbids, match="halted"):
                await running
        await rig.until(lambda: twin.rest == rest and rig.axis.configured)
        assert bytes(twin.motor.data) == before


async def test_what_is_asked_of_another_vesc_meanwhile_names_the_detection(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("rcp_can.profiles.vesc._TURN", 0.2)
    second = make_twin("vesc", 8)
    table = {"bus": "can0", "profile": "vesc", "node": 8, "commissioning": True}
    async with motor("vesc", commissioning=True, twins=(second,), motors={"n": table}) as rig:
        rig.twin.detects = 60.0
        await rig.until(lambda: rig.backend.axes["n"].configured)
        running = asyncio.ensure_future(rig.execute("action/m/detect_motor", BODY))
        await rig.until(lambda: rig.twin.detection is not None)
        for name, body in (("service/n/dump_settings", None), ("action/n/detect_motor", BODY)):
            with pytest.raises(DeviceTimeout, match="detection of node 7 still runs"):
                await rig.ran(name, body)
        assert second.detection is None
        running.cancel()
        with anyio.fail_after(60), pytest.raises(asyncio.CancelledError):
            await running
        assert (await rig.ran("service/n/dump_settings"))["settings"] > 0


async def test_a_configuration_with_the_old_id_is_not_put_back() -> None:
    async with motor("vesc", commissioning=True) as rig:
        drive = rig.axis.drive
        drive.application = b"with the old id"
        await rig.ran("service/m/set_node", {"node": 9})
        assert drive.application is None


async def test_of_another_firmware_only_the_sensors_are_told() -> None:
    async with motor("vesc", commissioning=True) as rig:
        rig.twin.motor.data[:4] = b"\0\0\0\1"
        found = await rig.ran("action/m/detect_motor", BODY)
        assert found["sensors"] == "hall"
        assert "resistance" not in found or found["resistance"] is None


@pytest.mark.parametrize(("result", "words"), [(-10, "flux linkage"), (-97, "fault 3"), (-42, "result -42")])  # fmt: skip
async def test_a_detection_that_fails_tells_why_and_leaves_the_drive_as_it_was(
    result: int, words: str
) -> None:
    async with motor("vesc", commissioning=True) as rig:
        rig.twin.fails = result
        before = bytes(rig.twin.motor.data)
        with pytest.raises(DeviceRejected, match=words):
            await rig.ran("action/m/detect_motor", BODY)
        assert (bytes(rig.twin.motor.data), rig.twin.stores) == (before, 0)
        assert rig.axis.drive.application is None  # so that nothing writes it later
        rig.twin.fails = 0
        assert (await rig.ran("action/m/detect_motor", BODY))["sensors"] == "hall"


async def test_a_detection_needs_a_motor_that_is_off_and_known_firmware() -> None:
    async with motor("vesc", commissioning=True) as rig:
        body = rig.typed("action/m/detect_motor", BODY)
        await rig.enable()
        with pytest.raises(ModeForbids, match="enabled"):
            rig.backend.foresee("action/m/detect_motor", body)
        with pytest.raises(ModeForbids, match="enabled"):
            await rig.ran("action/m/detect_motor", BODY)
        await rig.ran("service/m/disable")
        await rig.host.published_as("sensor/m/state", state="disabled")
        rig.backend.foresee("action/m/detect_motor", body)
        assert rig.twin.detection is None  # a dry run starts nothing
        rig.twin.firmware = 4, 2
        with pytest.raises(DeviceRejected, match=r"known are 5\.x and 6\.x"):
            await rig.ran("action/m/detect_motor", BODY)
        rig.twin.firmware = 6, 0
        rig.twin.limits[9] = 3e6  # which no command can carry
        with pytest.raises(DeviceRejected, match="cannot be sent back"):
            await rig.ran("action/m/detect_motor", BODY)
        assert rig.twin.plant.position == 0.0


@pytest.mark.parametrize("end", ENDS)
async def test_an_ended_detection_is_at_rest_and_stays_there(
    end: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    if end == "timeout":
        monkeypatch.setattr(ours, "_LONGEST", 0.3)
    async with motor("vesc", commissioning=True) as rig:
        twin = rig.twin
        twin.plant.friction = 0.02
        before, rest = bytes(twin.motor.data), twin.rest
        twin.detects = 2.0 if end == "unheard" else 1.0 if end == "timeout" else 5.0
        running = asyncio.ensure_future(rig.execute("action/m/detect_motor", BODY))
        if end == "at once":
            await rig.until(lambda: rig.axis.drive.busy)
        else:
            await rig.until(lambda: twin.detection is not None)
            if end != "timeout":
                await rig.until(lambda: twin.plant.velocity > 2.0)
                assert rig.backend.motion(None).at_rest is False
        match end:
            case "cancel":
                running.cancel()
            case "hold":
                with anyio.fail_after(60):
                    await rig.backend.hold(None)
            case "unheard":
                twin.silent = True
                await rig.host.published_as("sensor/m/state", state="offline")
                twin.silent = False
            case "timeout":
                pass
            case _:
                with anyio.fail_after(60):
                    await rig.backend.halt()
        with anyio.fail_after(60):
            with pytest.raises(ENDS[end][0], match=ENDS[end][1]):
                await running
            await rig.until(lambda: not rig.axis.drive.busy)
            await rig.until(lambda: rig.axis.resting)
        assert twin.detection is None
        assert abs(twin.plant.velocity) < 0.1
        if end != "unheard":  # then it came to its end, and stored that
            assert (bytes(twin.motor.data), twin.stores) == (before, 0)
        await rig.until(lambda: twin.rest == rest)  # the status messages, too
        place = twin.plant.position
        await rig.host.published_as("sensor/m/state", state="disabled")
        assert twin.plant.position == pytest.approx(place, abs=0.05)


async def test_a_drive_that_does_not_reboot_is_not_said_to_rest(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("rcp_can.profiles.vesc._REBOOTS", 0.5)
    async with motor("vesc", commissioning=True) as rig:
        twin = rig.twin
        twin.detects, twin.boots = 60.0, 0.02
        running = asyncio.ensure_future(rig.execute("action/m/detect_motor", BODY))
        await rig.until(lambda: twin.detection is not None)
        twin.deaf = True
        running.cancel()
        with anyio.fail_after(60), pytest.raises(DeviceTimeout, match="seen to reboot"):
            await running
        assert rig.backend.motion(None).at_rest is False
        twin.deaf = False
        await rig.until(lambda: not rig.axis.drive.busy)
        assert twin.detection is None


async def test_through_a_gateway_an_e_stop_ends_a_detection() -> None:
    async with bed("vesc", commissioning=True) as held:
        held.twin.detects, held.twin.plant.friction = 5.0, 0.02
        held.twin.boots = 0.8  # longer than a drive may be silent otherwise
        dry = await held.ask("execute", "action/m/detect_motor", BODY, dry_run=True)
        assert (dry["status"], dry["dry_run"]) == ("completed", True), dry
        id_ = await held.client.send(
            type="execute", path="/tenant/t/action/m/detect_motor", body=BODY
        )
        await held.until(lambda: held.twin.plant.velocity > 2.0)
        stopped = await held.client.request("execute", "/system/estop", body={}, within=60.0)
        assert stopped["status"] == "completed", stopped
        assert abs(held.twin.plant.velocity) < 0.1
        assert held.twin.detection is None
        reply = await held.client.final(id_, 20.0)
        assert reply["status"] in ("failed", "cancelled"), reply
        assert await held.code("execute", "action/m/detect_motor", BODY) == "estop_active"


def test_the_request_is_as_the_firmware_reads_it() -> None:
    # commands.c: bool, then five times buffer_get_float32(data, 1e3)
    packed = ours._REQUEST.pack(58, False, 45_000, -60_000, 99_000, 700_000, 2_500_000)  # noqa: SLF001 - the bytes are meant
    assert packed[:2] == b"\x3a\0"
    assert struct.unpack(">5i", packed[2:])[0] == 45_000
    assert len(packed) == 22
