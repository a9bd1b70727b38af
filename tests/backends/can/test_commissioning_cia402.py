"""Commissioning of CiA 402 drives: homing by a method, storing and restoring of parameters."""

from __future__ import annotations

import asyncio
import math
import struct
from typing import Any

import anyio
import pytest

from backends.can.peers import local_node
from backends.can.rig import channel, motor, opened
from backends.can.test_gateway import bed
from rcp_can.profiles.cia402_homing import Homing, homing_of
from rcp_can.profiles.cia402_procedures import Units, cia402_procedures
from rcp_can.sim.cia402_objects import make_dictionary
from rcp_kernel.errors import DeviceRejected, ModeForbids, OutOfRange, RcpError

SEARCH = {"method": 1, "search_speed": 3.0, "zero_speed": 0.5, "acceleration": 20.0}


@pytest.mark.parametrize(
    ("word", "since", "found"),
    [  # CiA 402-2, table 129: homing error, attained, reached
        (0x0237, 0.1, Homing.RUNNING),
        (0x0637, 0.1, Homing.RUNNING),
        (0x0637, 0.6, Homing.NOT_STARTED),
        (0x1237, 9.0, Homing.RUNNING),
        (0x1637, 0.1, Homing.DONE),
        (0x2237, 0.1, Homing.FAILED),
        (0x2637, 0.1, Homing.FAILED),
        (0x3637, 0.1, Homing.FAILED),
    ],
)
def test_the_statusword_tells_how_homing_goes_on(word: int, since: float, found: Homing) -> None:
    assert homing_of(word, since) is found


async def test_homing_searches_the_switch_leaves_it_and_ends_at_rest() -> None:
    async with motor("cia402", commissioning=True, gear=2.0, velocity=4.0) as rig:
        await rig.enable()
        await rig.ran("action/m/homing", SEARCH)
        twin = rig.twin
        assert abs(twin.plant.velocity) < 0.1
        assert abs(twin.plant.position) < 0.2  # it counts from the switch
        assert twin.get("homing_method") == 1
        assert twin.get_raw(0x6099, 1) == round(3.0 * 2.0 * twin.scale)
        assert twin.get_raw(0x6099, 2) == round(0.5 * 2.0 * twin.scale)
        assert rig.host.last("sensor/m/state").homed is True
        assert rig.axis.state == "enabled"
        twin.plant.position, twin.switch = 1.0, -1.0
        await rig.ran("action/m/homing", SEARCH)  # the end of the first is not that of the second
        assert abs(twin.plant.position) < 0.2
        assert abs(twin.plant.velocity) < 0.1


@pytest.mark.parametrize("scales", [{}, {"acceleration_scale": 10.0}], ids=["rpm/s", "own"])
async def test_homing_and_moves_are_as_fast_as_asked_where_a_drive_counts_in_rpm(
    scales: dict[str, float],
) -> None:
    rpm = 60 / (2 * math.pi)
    options = {"velocity_scale": 60 / 4096, **scales}
    ramps = 4096 / (2 * math.pi) * 10 if scales else rpm
    keys: dict[str, Any] = {"gear": 2.0, "velocity": 4.0, "acceleration": 50.0}
    async with motor("cia402", commissioning=True, options=options, **keys) as rig:
        twin = rig.twin
        await rig.enable()
        running = asyncio.ensure_future(rig.ran("action/m/homing", SEARCH))
        await rig.until(lambda: twin.plant.velocity < -5.5)
        assert twin.plant.velocity > -6.5
        await running
        assert twin.get_raw(0x6099, 1) == round(3.0 * 2.0 * rpm)
        assert twin.get_raw(0x6099, 2) == round(0.5 * 2.0 * rpm)
        assert twin.get("homing_acceleration") == round(20.0 * 2.0 * ramps)
        await rig.ran("action/m/move_to", {"position": 1.0, "velocity": 2.0})
        assert twin.get("profile_velocity") == round(2.0 * 2.0 * rpm)
        assert twin.get("profile_acceleration") == round(50.0 * 2.0 * ramps)
        assert twin.get("profile_deceleration") == round(50.0 * 2.0 * ramps)
        assert twin.plant.position == pytest.approx(2.0, abs=0.05)
        twin.local.set_data(0x6099, 1, struct.pack("<I", round(5.0 * 2.0 * rpm)))
        await rig.until(lambda: rig.axis.resting)
        with pytest.raises(OutOfRange, match=r"search speed [45][.\d]* rad/s exceeds"):
            await rig.ran("action/m/homing", {"method": 1})


async def test_homing_that_fails_or_does_not_start_tells_why() -> None:
    async with motor("cia402", commissioning=True, velocity=8.0) as rig:
        with pytest.raises(ModeForbids, match="disabled"):
            rig.backend.foresee("action/m/homing", rig.typed("action/m/homing", SEARCH))
        await rig.enable()
        for body, words in (
            ({**SEARCH, "method": 5}, r"no homing method 5; it has 1, 2, 17"),
            ({**SEARCH, "search_speed": 9.0}, "limit of 8 rad/s"),
        ):
            with pytest.raises(OutOfRange, match=words):
                await rig.ran("action/m/homing", body)
            assert rig.axis.status.enabled  # nothing moved, so nothing is stopped
        assert rig.twin.plant.position == 0.0
        rig.twin.stuck = True
        with pytest.raises(DeviceRejected, match="homing error"):
            await rig.ran("action/m/homing", SEARCH)
        assert abs(rig.twin.plant.velocity) < 0.1
        assert not rig.host.last("sensor/m/state").homed


async def test_a_speed_of_the_drive_itself_that_is_too_fast_is_refused() -> None:
    async with motor("cia402", commissioning=True, velocity=2.0) as rig:
        await rig.enable()
        rig.twin.local.set_data(0x6099, 1, struct.pack("<I", round(5.0 * rig.twin.scale)))
        with pytest.raises(OutOfRange, match=r"search speed [45][.\d]* rad/s exceeds"):
            await rig.ran("action/m/homing", {"method": 1})
        assert rig.twin.plant.position == 0.0


@pytest.mark.parametrize("end", ["cancel", "halt", "hold", "timeout"])
async def test_ended_homing_is_at_rest_and_stays_there(end: str) -> None:
    async with motor("cia402", commissioning=True, velocity=8.0) as rig:
        twin = rig.twin
        twin.switch = -500.0
        await rig.enable()
        body: dict[str, Any] = SEARCH | ({"timeout": 1.0} if end == "timeout" else {})
        running = asyncio.ensure_future(rig.execute("action/m/homing", body))
        await rig.until(lambda: twin.plant.velocity < -2.5)
        assert rig.backend.motion(None).at_rest is False
        match end:
            case "cancel":
                running.cancel()
            case "hold":
                await rig.backend.hold(None)
            case "halt":
                await rig.backend.halt()
                assert abs(twin.plant.velocity) < 0.1
            case _:
                pass
        with anyio.fail_after(60):
            await asyncio.wait((running,))
        assert running.cancelled() or isinstance(running.exception(), RcpError)
        assert abs(twin.plant.velocity) < 0.1
        seen = rig.axis.status.counts["velocity"]
        await rig.until(lambda: rig.axis.status.counts["velocity"] > seen + 10)
        assert abs(twin.plant.velocity) < 0.1


async def test_parameters_are_stored_and_restored_by_their_signatures() -> None:
    async with motor("cia402", commissioning=True) as rig:
        await rig.ran("service/m/store_parameters", {"group": "all"})
        assert rig.twin.stored == {0x1010: b"save"}
        await rig.ran("service/m/restore_parameters", {"group": "application"})
        assert rig.twin.stored == {0x1010: b"save", 0x1011: b"load"}
        rig.twin.storage_fails = True
        with pytest.raises(DeviceRejected, match="hardware error"):
            await rig.ran("service/m/store_parameters", {})
        rig.twin.stores_on_command = False
        with pytest.raises(DeviceRejected, match="on command for all"):
            await rig.ran("service/m/store_parameters", {})
        rig.twin.storage_fails = False
        await rig.enable()
        with pytest.raises(ModeForbids, match="enabled"):
            await rig.ran("service/m/store_parameters", {})


async def test_a_node_of_canopen_gets_the_signature() -> None:
    """Write it to canopen's own server, by the client that the service uses."""
    name = channel()
    with local_node(name, 6, make_dictionary(6)) as node:
        written: list[bytes] = []
        node.add_write_callback(lambda **what: written.append(bytes(what["data"])))
        bus = {"interface": "virtual", "channel": name}
        motors = {"m": {"bus": "can0", "profile": "cia402", "node": 6}}
        async with opened({"buses": {"can0": bus}, "motors": motors, "grace": 0.05}) as rig:
            drive = rig.backend.axes["m"].drive
            store = next(
                each
                for each in cia402_procedures(drive, Units(1.0, 1.0), 1.0)
                if each.verb == "store_parameters"
            )
            with anyio.fail_after(60):
                await store.run(store.input(group="application"), lambda *_, **__: None)
            assert b"save" in written


async def test_through_a_gateway_an_e_stop_ends_homing() -> None:
    async with bed("cia402", commissioning=True, velocity=8.0) as held:
        held.twin.switch = -500.0
        await held.done("service/m/enable")
        id_ = await held.client.send(type="execute", path="/tenant/t/action/m/homing", body=SEARCH)
        await held.until(lambda: held.twin.plant.velocity < -2.5)
        stopped = await held.client.request("execute", "/system/estop", body={}, within=60.0)
        assert stopped["status"] == "completed", stopped
        assert abs(held.twin.plant.velocity) < 0.1
        reply = await held.client.final(id_, 20.0)
        assert reply["status"] in ("failed", "cancelled"), reply
        assert held.twin.state == "quick_stop"
        assert await held.code("execute", "action/m/homing", SEARCH) == "estop_active"


@pytest.mark.parametrize("name", ["action/m/homing", "action/m/home"])
async def test_homing_that_fails_after_it_moved_has_failed_and_was_not_refused(name: str) -> None:
    options = {"homing_method": 1}
    async with bed("cia402", commissioning=True, velocity=8.0, options=options) as held:
        await held.done("service/m/enable")
        if name.endswith("homing"):
            reply = await held.ask("execute", name, {**SEARCH, "method": 5})
            assert reply["status"] == "rejected", reply  # nothing moved
        held.twin.stuck = True
        held.twin.local.set_data(0x6099, 1, struct.pack("<I", round(3.0 * held.twin.scale)))
        reply = await held.ask("execute", name, SEARCH if name.endswith("homing") else None)
        assert (reply["status"], reply["error"]["code"]) == ("failed", "device_rejected"), reply
        assert held.twin.plant.position < held.twin.switch
