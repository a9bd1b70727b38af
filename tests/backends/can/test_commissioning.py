"""Commissioning of ODrives: calibration, watchdog, storing, identity; at rest however it ends."""

from __future__ import annotations

import asyncio
import json
import math
import struct
from pathlib import Path
from typing import Any

import anyio
import cantools
import odrive_can
import pytest

from backends.can.rig import motor
from backends.can.test_gateway import bed
from rcp_can.profiles.odrive_messages import MESSAGES
from rcp_can.profiles.odrive_states import CALIBRATIONS, STATES, reason
from rcp_can.sim.odrive import ENDPOINTS
from rcp_kernel.errors import (
    AdapterUnavailable,
    ConfigError,
    DeviceRejected,
    DeviceTimeout,
    ModeForbids,
    RcpError,
)

PUBLISHED: Any = cantools.database.load_file(
    Path(odrive_can.__file__).parent / "dbc" / "odrive-cansimple-0.6.10.dbc"
)


@pytest.fixture
def endpoints(tmp_path: Path) -> str:
    file = tmp_path / "flat_endpoints.json"
    known = {name: {"id": number, "type": "float"} for name, number in ENDPOINTS.items()}
    file.write_text(json.dumps({"fw_version": "0.6.10", "endpoints": known}))
    return str(file)


def test_the_messages_are_those_of_the_published_database() -> None:
    for name, theirs, values in (
        ("version", "Get_Version", {"firmware_minor": 6, "hardware_variant": 58}),
        ("access", "RxSdo", {"opcode": 1, "endpoint": 301, "value": 77}),
        ("value", "TxSdo", {"endpoint": 300, "value": 1}),
        ("reboot", "Reboot", {"action": 1}),
        ("heartbeat", "Heartbeat", {"error": 0x40000000, "state": 7, "result": 6}),
    ):
        command, layout = MESSAGES[name]
        message = PUBLISHED.get_message_by_name(f"Axis0_{theirs}")
        assert message.frame_id == command
        assert layout.size <= message.length  # the heartbeat has a spare byte
        raw = layout.encode(**values).ljust(8, b"\0")
        if name in ("access", "value"):  # cantools takes their endpoint for a multiplexer
            assert raw[1:3] == struct.pack("<H", values["endpoint"])
            assert raw[4:8] == struct.pack("<I", values["value"])
            continue
        found = message.decode(raw, decode_choices=False)
        assert sorted(v for v in found.values() if v) == sorted(values.values())


def test_states_and_results_are_those_of_the_published_database() -> None:
    heartbeat = PUBLISHED.get_message_by_name("Axis0_Heartbeat")
    states = heartbeat.get_signal_by_name("Axis_State").choices
    results = heartbeat.get_signal_by_name("Procedure_Result").choices
    assert set(states) - {5} == set(STATES)
    assert states[CALIBRATIONS["full"]] == "FULL_CALIBRATION_SEQUENCE"
    assert states[CALIBRATIONS["encoder_offset"]] == "ENCODER_OFFSET_CALIBRATION"
    assert states[CALIBRATIONS["anticogging"]] == "ANTICOGGING_CALIBRATION"
    assert [n for n in results if reason(n) is None] == [0, 1]
    assert not [n for n in results if (reason(n) or "").startswith("result")]


async def test_a_calibration_tells_its_states_and_ends_at_idle_and_at_rest() -> None:
    async with motor("odrive", commissioning=True) as rig:
        found = await rig.ran("action/m/calibrate", {"sequence": "full"})
        assert found["states"] == ["motor", "encoder_offset"]
        assert [feedback.state for feedback, _ in rig.feedback if feedback] == found["states"]
        assert abs(rig.twin.plant.velocity) < 0.1
        assert (rig.twin.state, rig.twin.enabled) == (1, False)
        assert rig.axis.state == "disabled"
        assert rig.twin.plant.position > 0.3  # it did turn
        await rig.enable()


async def test_a_calibration_needs_a_drive_that_is_off_and_free_of_faults() -> None:
    async with motor("odrive", commissioning=True) as rig:
        body = rig.typed("action/m/calibrate", {"sequence": "motor"})
        await rig.enable()
        with pytest.raises(ModeForbids, match="enabled") as caught:
            await rig.ran("action/m/calibrate", {"sequence": "motor"})
        assert "disable" in str(caught.value.remedy)
        with pytest.raises(ModeForbids, match="enabled"):
            rig.backend.foresee("action/m/calibrate", body)
        await rig.ordered(rig.twin.break_down)
        await rig.host.published_as("sensor/m/state", state="fault")
        with pytest.raises(ModeForbids, match="has faults") as caught:
            await rig.ran("action/m/calibrate", {"sequence": "motor"})
        assert "clear_faults" in str(caught.value.remedy)
        await rig.ran("service/m/clear_faults")
        await rig.host.published_as("sensor/m/state", state="disabled")
        rig.backend.foresee("action/m/calibrate", body)
        assert rig.twin.state == 1  # a dry run starts nothing


@pytest.mark.parametrize(
    ("error", "result", "words"), [(0, 6, "phase resistance"), (1 << 30, 5, "calibration")]
)
async def test_a_calibration_that_fails_tells_why_and_can_be_run_again(
    error: int, result: int, words: str
) -> None:
    async with motor("odrive", commissioning=True) as rig:
        rig.twin.fails = error, result
        with pytest.raises(DeviceRejected, match=words):
            await rig.ran("action/m/calibrate", {"sequence": "motor"})
        if error:
            await rig.ran("service/m/clear_faults")
        await rig.host.published_as("sensor/m/state", state="disabled")
        found = await rig.ran("action/m/calibrate", {"sequence": "motor"})
        assert found["states"] == ["motor"]


async def test_a_drive_that_starts_no_calibration_is_told() -> None:
    async with motor("odrive", commissioning=True) as rig:
        rig.twin.refuses = True
        with pytest.raises(DeviceRejected, match="did not start"):
            await rig.ran("action/m/calibrate", {"sequence": "motor"})


@pytest.mark.parametrize("end", ["cancel", "halt", "hold", "at once", "unheard", "timeout"])
async def test_an_ended_calibration_is_at_rest_and_stays_there(end: str) -> None:
    async with motor("odrive", commissioning=True) as rig:
        twin = rig.twin
        body = {"sequence": "encoder_offset", "timeout": 0.25 if end == "timeout" else 60.0}
        running = asyncio.ensure_future(rig.execute("action/m/calibrate", body))
        if end == "at once":  # before the drive has said that it calibrates
            await rig.until(lambda: rig.axis.drive.busy)
        else:
            await rig.until(lambda: twin.plant.velocity > 2.0)
            assert rig.backend.motion(None).at_rest is False
        match end:
            case "cancel":
                running.cancel()
            case "hold":
                with anyio.fail_after(60):
                    await rig.backend.hold(None)
                assert abs(twin.plant.velocity) < 0.1
            case "unheard":
                twin.silent = True
            case "timeout":
                pass
            case _:
                with anyio.fail_after(60):
                    await rig.backend.halt()
                assert abs(twin.plant.velocity) < 0.1
                assert twin.state == 1
        with anyio.fail_after(60):
            await asyncio.wait((running,))
        twin.silent = False
        assert running.cancelled() or isinstance(running.exception(), RcpError)
        await rig.host.until(lambda: rig.axis.online)
        await rig.until(lambda: twin.state == 1 and abs(twin.plant.velocity) < 0.1)
        seen = rig.axis.status.counts["velocity"]
        await rig.until(lambda: rig.axis.status.counts["velocity"] > seen + 20)
        assert (twin.state, twin.enabled) == (1, False)
        assert abs(twin.plant.velocity) < 0.1


@pytest.mark.parametrize("end", ["cancel", "halt", "hold", "zero", "at once", "timeout"])
async def test_ended_homing_does_not_go_on_when_the_end_stop_closes(end: str) -> None:
    options = {"home_timeout": 2.0 if end == "timeout" else 60.0}
    async with motor("odrive", options=options) as rig:
        twin = rig.twin
        twin.end_stop = -500.0
        await rig.enable()
        running = asyncio.ensure_future(rig.execute("action/m/home"))
        if end == "at once":  # before the drive has said that it homes
            await rig.until(lambda: rig.axis.drive.busy)
        else:
            await rig.until(lambda: twin.plant.velocity < -2.0)
            await rig.until(lambda: rig.backend.motion(None).at_rest is False)
        match end:
            case "cancel":
                running.cancel()
            case "hold":
                with anyio.fail_after(60):
                    await rig.backend.hold(None)
            case "zero":
                await rig.write("actuator/m/velocity", 0.0)
            case "timeout":
                pass
            case _:
                with anyio.fail_after(60):
                    await rig.backend.halt()
                assert twin.state == 1
        with anyio.fail_after(60):
            await asyncio.wait((running,))
        assert running.cancelled() or isinstance(running.exception(), RcpError)
        await rig.until(lambda: twin.state == 1 and abs(twin.plant.velocity) < 0.1)
        at, seen = twin.plant.position, rig.axis.status.counts["velocity"]
        twin.end_stop = at + 1.0
        await rig.until(lambda: rig.axis.status.counts["velocity"] > seen + 20)
        assert (twin.state, twin.enabled) == (1, False)
        assert twin.plant.position == pytest.approx(at, abs=0.1)
        state = await rig.host.published_as("sensor/m/state", state="disabled")
        assert not state.homed


async def test_a_watchdog_is_fed_while_the_drive_homes_without_a_change_of_its_speed() -> None:
    async with motor("odrive") as rig:
        rig.twin.watchdog, rig.twin.end_stop = 0.5, -3.0
        await rig.enable()
        await rig.ran("action/m/home")
        assert (rig.twin.error, rig.twin.state) == (0, 8)
        assert rig.twin.plant.position == pytest.approx(0.0, abs=0.02)


async def test_a_watchdog_is_fed_while_the_drive_calibrates() -> None:
    async with motor("odrive", commissioning=True, options={}) as rig:
        rig.twin.watchdog = 0.3
        await rig.ran("action/m/calibrate", {"sequence": "full"})
        assert rig.twin.error == 0


async def test_the_watchdog_is_set_and_read_back(endpoints: str) -> None:
    async with motor("odrive", options={"endpoints": endpoints}, watchdog=0.4) as rig:
        await rig.host.published_as("sensor/m/state", watchdog_verified=True)
        assert rig.twin.watchdog == pytest.approx(0.4)
        assert rig.axis.drive.protection.within == pytest.approx(0.4)


async def test_a_drive_that_keeps_another_watchdog_is_not_commanded(endpoints: str) -> None:
    async with motor("odrive", options={"endpoints": endpoints}) as rig:
        rig.twin.keeps_watchdog = True
        rig.twin.watchdog = None
        await rig.ordered(rig.twin.boot)
        await rig.host.until(lambda: "configuration" in rig.faults())
        assert any("kept its watchdog off" in str(report) for report in rig.host.reports)
        with pytest.raises(AdapterUnavailable, match="kept its watchdog off"):
            await rig.enable()


@pytest.mark.parametrize("text", ["", "{}", '{"fw_version": "0.6.10", "endpoints": {}}'])
async def test_a_file_that_has_no_endpoints_is_a_configuration_error(
    tmp_path: Path, text: str
) -> None:
    file = tmp_path / "flat_endpoints.json"
    file.write_text(text)
    with pytest.raises(ConfigError, match=r"flat_endpoints\.json"):
        async with motor("odrive", options={"endpoints": str(file)}):
            pass


@pytest.fixture
def older(endpoints: str) -> str:
    file = Path(endpoints)
    file.write_text(file.read_text().replace("0.6.10", "0.6.9"))
    return endpoints


async def test_endpoints_of_other_firmware_are_not_written(older: str) -> None:
    async with motor("odrive", options={"endpoints": older}) as rig:
        await rig.host.until(lambda: "configuration" in rig.faults())
        assert any("firmware 0.6.9" in str(report) for report in rig.host.reports)
        assert rig.twin.watchdog is None


async def test_a_drive_is_asked_anew_what_it_is_after_each_boot(endpoints: str) -> None:
    options = {"endpoints": endpoints}
    async with motor("odrive", commissioning=True, options=options) as rig:
        await rig.host.until(lambda: rig.axis.configured)
        twin, accesses = rig.twin, rig.twin.accesses

        def flashed() -> None:
            twin.firmware, twin.options["serial"] = (0, 6, 9), 0x77
            accesses.clear()
            twin.boot()

        await rig.ordered(flashed)  # or a spare drive was put in its place
        await rig.host.until(lambda: "configuration" in rig.faults())
        assert any("the drive has 0.6.9" in str(report) for report in rig.host.reports)
        assert not accesses
        assert await rig.backend.read("param/m/serial") == f"{0x77:012X}"
        assert "duplicate_node" not in rig.faults()


async def test_a_configuration_is_stored_when_the_drive_has_rebooted(endpoints: str) -> None:
    options = {"endpoints": endpoints}
    async with motor("odrive", commissioning=True, options=options, watchdog=0.7) as rig:
        await rig.ran("service/m/save_configuration")
        assert rig.twin.saved == [pytest.approx(0.7)]
        assert rig.twin.state == 1
        await rig.host.until(lambda: rig.axis.configured)
        await rig.enable()


async def test_a_drive_that_does_not_reboot_has_not_stored_anything(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("rcp_can.profiles.odrive._REBOOT", 0.5)
    async with motor("odrive", commissioning=True) as rig:
        rig.twin.deaf = True
        with pytest.raises(DeviceTimeout, match="may not have stored"):
            await rig.ran("service/m/save_configuration")


async def test_firmware_and_serial_number_are_parameters() -> None:
    async with motor("odrive", commissioning=True) as rig:
        await rig.until(lambda: rig.axis.configured)
        assert await rig.backend.read("param/m/firmware") == "0.6.10"
        assert await rig.backend.read("param/m/serial") == f"{0x1001:012X}"
        assert rig.host.facts[None].firmware == "0.6.10"
    async with motor("tmotor", commissioning=True) as rig:
        with pytest.raises(AdapterUnavailable, match="not reported its firmware"):
            await rig.backend.read("param/m/firmware")


async def test_through_a_gateway_an_e_stop_ends_a_calibration_and_forbids_another() -> None:
    async with bed("odrive", commissioning=True) as held:
        body = {"sequence": "encoder_offset"}
        dry = await held.ask("execute", "action/m/calibrate", body, dry_run=True)
        assert (dry["status"], dry["dry_run"]) == ("completed", True), dry
        assert held.twin.state == 1
        id_ = await held.client.send(type="execute", path="/tenant/t/action/m/calibrate", body=body)
        await held.until(lambda: held.twin.plant.velocity > 2.0)
        stopped = await held.client.request("execute", "/system/estop", body={}, within=60.0)
        assert stopped["status"] == "completed", stopped
        assert abs(held.twin.plant.velocity) < 0.1
        assert held.twin.state == 1
        reply = await held.client.final(id_, 20.0)
        assert reply["status"] in ("failed", "cancelled"), reply
        assert await held.code("execute", "action/m/calibrate", body) == "estop_active"
        assert math.isclose(held.twin.plant.velocity, 0.0, abs_tol=0.1)
