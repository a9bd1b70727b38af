"""DroneCAN nodes tell what they are and measure, and let themselves be set; what is wrong is refused."""

from __future__ import annotations

import asyncio
import math
import subprocess
import sys
import time
from collections import deque
from typing import Any

import can
import msgspec
import pytest

from backends.can.dronecan_rig import (
    STATUS,
    Ear,
    Field,
    esc,
    field,
    from_gateway,
)
from backends.can.rig import channel, opened
from rcp_can import CanConfig
from rcp_can.dronecan.library import make
from rcp_can.dronecan.node_status import Uptime
from rcp_can.dronecan.parameters import Parameters, decoded, parameter_type
from rcp_can.dronecan.transfers import Assembler, Service, encode
from rcp_can.sim.dronecan import DronecanTwin
from rcp_kernel.errors import (
    AdapterUnavailable,
    ConfigError,
    DeviceRejected,
    DeviceTimeout,
    ModeForbids,
)

# Nodes


async def sensing(rig: Field) -> None:
    await rig.until(lambda: rig.host.events("sensor/gps/info"))


async def test_a_node_tells_its_state_and_what_it_is_and_measures() -> None:
    twin = DronecanTwin(40, sensors=("gnss", "battery"))
    gps = {"bus": "can0", "node": 40, "sensors": ["gnss", "battery"], "as_robot": True}
    async with field(twin, dronecan={"gps": gps}) as rig:
        fix = await rig.host.published_as("sensor/gnss", fix="rtk_fixed")
        assert fix.latitude == pytest.approx(-35.3632621)
        assert (fix.altitude, fix.satellites) == (584.1, 12)
        assert fix.horizontal_accuracy == pytest.approx(0.2, abs=1e-3)
        assert fix.timestamp.endswith("Z")
        battery = await rig.host.published_as("sensor/battery", percentage=0.81)
        assert (battery.voltage, battery.current, battery.charging) == (22.25, -4.5, False)
        assert rig.host.resources["sensor/battery"].profiles == ("battery/1.0",)
        await sensing(rig)
        info = await rig.backend.read("sensor/gps/info")
        assert (info.name, info.firmware) == ("org.example.twin", "1.4 (00c0ffee)")
        assert info.serial.startswith("28")
        state = await rig.backend.read("sensor/gps/state")
        assert (state.mode, state.health) == ("operational", "ok")


async def test_a_node_that_vanishes_degrades_the_backend_until_it_is_back() -> None:
    twin = DronecanTwin(40, sensors=("gnss",))
    gps = {"bus": "can0", "node": 40, "sensors": ["gnss"]}
    async with field(twin, dronecan={"gps": gps}) as rig:
        await rig.host.until(lambda: "sensor/gps/gnss" in rig.host.samples)
        await rig.host.published_as("sensor/gps/state", mode="operational")
        twin.silent = True
        await rig.host.published_as("sensor/gps/state", mode="offline")
        assert "has sent no report" in (rig.host.reports[-1] or "")
        with pytest.raises(AdapterUnavailable, match="does not respond"):
            await rig.backend.read("sensor/gps/info")
        twin.silent = False
        await rig.host.published_as("sensor/gps/state", mode="operational")
        assert rig.host.reports[-1] is None


async def test_a_place_that_is_not_on_earth_is_not_told() -> None:
    twin = DronecanTwin(40, sensors=("gnss",))
    twin.latitude = 95.0
    gps = {"bus": "can0", "node": 40, "sensors": ["gnss"]}
    async with field(twin, dronecan={"gps": gps}) as rig:
        bus = rig.backend.buses["can0"]
        await rig.until(lambda: bus.malformed > 1)
        assert "sensor/gps/gnss" not in rig.host.samples


async def test_parameters_are_listed_written_and_stored() -> None:
    twin = DronecanTwin(40)
    mast = {"bus": "can0", "node": 40, "parameters": True}
    async with field(twin, dronecan={"mast": mast}) as rig:
        await rig.until(lambda: "param/mast/LABEL" in rig.host.resources)
        index = rig.host.resources["param/mast/ESC_INDEX"]
        schema = msgspec.json.schema(index.value)
        assert (schema["minimum"], schema["maximum"]) == (0, 19)
        assert await rig.write("param/mast/ESC_INDEX", 4) == 4
        assert await rig.write("param/mast/GAIN", 0.1) == pytest.approx(0.1)
        assert await rig.write("param/mast/BEEP", False) is False
        assert await rig.write("param/mast/LABEL", "rear") == "rear"
        assert await rig.backend.read("param/mast/LABEL") == "rear"
        assert twin.saved["LABEL"] == "front"
        await rig.ran("service/mast/save_parameters")
        assert twin.saved["LABEL"] == "rear"
        with pytest.raises(DeviceRejected, match="REVISION = 7 after 3"):
            await rig.write("param/mast/REVISION", 3)
        with pytest.raises(DeviceRejected, match="refused reset_parameters"):
            await rig.ran("service/mast/reset_parameters")


async def test_many_parameters_that_are_read_at_once_are_not_mixed_up() -> None:
    twin = DronecanTwin(40)
    twin.parameters = {f"P{n}": n for n in range(40)}
    mast = {"bus": "can0", "node": 40, "parameters": True}
    async with field(twin, dronecan={"mast": mast}) as rig:
        await rig.until(lambda: "param/mast/P39" in rig.host.resources)
        names = list(twin.parameters)
        read = [rig.backend.read(f"param/mast/{name}") for name in names]
        assert await asyncio.gather(*read) == list(twin.parameters.values())


async def test_a_restart_completes_when_the_node_is_back_and_not_while_its_motor_turns() -> None:
    twin = DronecanTwin(20, index=0)
    twin.age(100)
    tables = {"motors": {"m": esc(20, 0)}, "dronecan": {"mast": {"bus": "can0", "node": 20}}}
    async with field(twin, **tables) as rig:
        await rig.until(lambda: (rig.host.events("sensor/mast/state") or [0])[-1])
        await rig.ran("service/m/enable")
        with pytest.raises(ModeForbids, match="is enabled"):
            await rig.ran("service/mast/restart")
        await rig.ran("service/m/disable")
        began = time.monotonic()
        await rig.ran("service/mast/restart")
        assert time.monotonic() - began > 0.3  # it boots
        (event,) = rig.host.events("event/mast/restarted")
        assert event.uptime < event.before


async def test_a_node_that_does_not_restart_is_told_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rcp_can.dronecan.node._REBOOT", 0.5)
    twin = DronecanTwin(40)
    async with field(twin, dronecan={"mast": {"bus": "can0", "node": 40}}) as rig:
        with pytest.raises(AdapterUnavailable):
            await rig.ran("service/mast/restart")  # nothing was heard of it yet
        await rig.until(lambda: (rig.host.events("sensor/mast/state") or [None])[-1])
        await rig.until(lambda: (rig.host.last("sensor/mast/state").uptime or 0) >= 1)
        twin.deaf = True
        with pytest.raises(DeviceTimeout, match="did not report a restart"):
            await rig.ran("service/mast/restart")


# The bus


async def test_the_gateway_is_a_node_that_tells_what_it_is() -> None:
    async with field(DronecanTwin(40), dronecan={"mast": {"bus": "can0", "node": 40}}) as rig:
        with Ear(rig.channel) as ear:
            state = await ear.hears(from_gateway(STATUS))
            assert state.payload.mode == 0
            ask = make("protocol.GetNodeInfo.Request")
            ear.send(
                encode(
                    ask, source=9, transfer_id=5, priority=16, service=Service(126, request=True)
                )
            )
            answer = await ear.hears(
                lambda got: got.type_id == 1 and got.service is not None and not got.service.request
            )
            assert (answer.transfer_id, bytes(answer.payload.name)) == (5, b"org.rcp.gateway")


async def test_another_node_with_the_gateways_id_is_reported() -> None:
    async with field(DronecanTwin(126), dronecan={"mast": {"bus": "can0", "node": 40}}) as rig:
        await rig.host.until(
            lambda: any("has the gateway's" in (r or "") for r in rig.host.reports)
        )


async def test_another_node_with_the_gateways_id_that_has_left_is_no_fault_any_more(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("rcp_can.dronecan.port.OFFLINE", 0.05)
    monkeypatch.setattr("rcp_can.dronecan.port._PERIOD", 0.02)
    async with field(DronecanTwin(40), dronecan={"mast": {"bus": "can0", "node": 40}}) as rig:
        with Ear(rig.channel) as ear:
            status = make("protocol.NodeStatus", uptime_sec=5)
            ear.send(encode(status, source=126, transfer_id=1, priority=16))
            told = rig.host.reports
            await rig.host.until(lambda: any("has the gateway's" in (r or "") for r in told))
            await rig.host.until(lambda: told[-1] is None)


@pytest.mark.parametrize(
    ("reports", "restarted"),
    [
        ([(0, 0.0), (1, 1.0), (1, 1.99), (3, 3.1)], False),  # whole seconds
        ([(5, 0.0), (9, 4.2)], False),  # some were lost
        ([(5, 0.0), (4, 4.0)], True),
        ([(1, 0.0), (1, 1.5)], True),  # it counted to one again
        ([(5, 0.0), (3000, 4000.0)], True),  # it was away, and has been up for longer than before
        ([(5, 0.0), (3990, 4000.0)], False),  # its clock is slow
    ],
)
def test_a_restart_shows_in_the_uptime(
    reports: list[tuple[int, float]], *, restarted: bool
) -> None:
    uptime = Uptime()
    found = [uptime.has_restarted(seconds, at) for seconds, at in reports]
    assert any(found) is restarted


def test_transfers_without_an_end_or_a_beginning_are_dropped() -> None:
    frames = encode(make("equipment.esc.Status", rpm=5), source=20, transfer_id=3, priority=8)
    messages = [can.Message(arbitration_id=i, data=data) for i, data in frames]
    assembler = Assembler((1034,))
    assert [assembler.take(message) for message in messages][-1].payload.rpm == 5  # type: ignore[union-attr]
    with pytest.raises(ValueError, match="first frame"):
        assembler.take(messages[1])
    assembler.take(messages[0])
    with pytest.raises(ValueError, match="first frame"):
        deque(map(assembler.take, [messages[1]] * 1000))
    damaged = can.Message(arbitration_id=frames[1][0], data=bytes(7) + frames[1][1][-1:])
    assembler.take(messages[0])
    assembler.take(damaged)
    with pytest.raises(ValueError, match="CRC"):
        assembler.take(messages[2])
    with pytest.raises(ValueError, match="last byte"):
        assembler.take(can.Message(arbitration_id=frames[0][0], data=b""))
    for priority in range(32):
        for other in range(1, 128):
            start = encode(
                make("equipment.esc.Status"), source=other, transfer_id=0, priority=priority
            )[0]
            assembler.take(can.Message(arbitration_id=start[0], data=start[1]))
    assert len(assembler._open) <= 64  # noqa: SLF001 - what a bus full of nonsense may take


WRONG: list[tuple[dict[str, Any], str]] = [
    ({"motors": {"a": esc(126, 0)}}, "motors.a.node: 126 is the gateway's own"),
    ({"motors": {"a": esc(1, 0), "b": esc(2, 0)}}, "index: 0 is already used by a"),
    (
        {
            "motors": {
                "a": esc(1, 0),
                "b": esc(2, 1, options={"control": "raw", "full_speed": 1.0}),
            }
        },
        "control: a of the same bus has 'rpm'",
    ),
    ({"motors": {"a": esc(1, 0, options={"control": "raw"})}}, "needs `full_speed`"),
    ({"motors": {"a": esc(1, 20)}}, "motors.a.options: Expected `int` <= 19"),
    ({"dronecan": {"a": {"bus": "can1", "node": 1}}}, "dronecan.a.bus: there is no bus"),
    (
        {"dronecan": {n: {"bus": "can0", "node": 1} for n in "ab"}},
        "dronecan.b.node: 1 is already used by a",
    ),
    (
        {"dronecan": {"a": {"bus": "can0", "node": 1, "battery_id": 2}}},
        "`battery_id` needs the sensor",
    ),
    (
        {
            "dronecan": {
                n: {"bus": "can0", "node": i, "sensors": ["battery"], "as_robot": True}
                for i, n in enumerate("ab", 1)
            }
        },
        "dronecan.b.as_robot: a has the robot's battery already",
    ),
]


@pytest.mark.parametrize(("tables", "text"), WRONG, ids=[text for _, text in WRONG])
def test_a_configuration_that_cannot_work_is_refused(tables: dict[str, Any], text: str) -> None:
    bus = {"interface": "virtual", "channel": "none"}
    with pytest.raises(msgspec.ValidationError) as caught:
        msgspec.convert({"buses": {"can0": bus}, **tables}, CanConfig)
    assert text in str(caught.value)


@pytest.mark.parametrize(
    ("tables", "text"),
    [
        (
            {"motors": {"m": esc(20, 0, position=[-1.0, 1.0])}},
            "motors.m.position: dronecan reports",
        ),
        (
            {
                "motors": {"l": esc(20, 0), "r": esc(21, 1)},
                "diff_drives": {"b": {"left": "l", "right": "r", "track": 1.0, "radius": 0.1}},
            },
            "diff_drives.b: motor 'l' \\(dronecan\\) reports no position",
        ),
    ],
)
async def test_what_needs_a_position_is_refused(tables: dict[str, Any], text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        async with field(**tables):
            pass


BOUNDS: list[tuple[Any, Any, tuple[Any, Any]]] = [
    (0, 19, (0, 19)),
    (None, 19, (None, 19)),
    (0, 0, (None, None)),  # of firmware that has none
    (10, 19, (None, None)),  # the value is 4
    (math.nan, 19.0, (None, None)),
]


@pytest.mark.parametrize(("low", "high", "kept"), BOUNDS)
async def test_bounds_that_cannot_be_are_not_offered(
    low: Any, high: Any, kept: tuple[Any, Any]
) -> None:
    class Port:
        async def request(self, _node: int, request: Any, _what: str) -> Any:
            answer = make("protocol.param.GetSet.Response", name="X")  # whatever the number
            answer.value = make("protocol.param.Value", integer_value=4)
            for field_, bound in (("min_value", low), ("max_value", high)):
                if bound is not None:
                    kind = "integer_value" if isinstance(bound, int) else "real_value"
                    setattr(answer, field_, make("protocol.param.NumericValue", **{kind: bound}))
            return answer

    (parameter,) = await Parameters(Port(), 20).list()  # type: ignore[arg-type]
    assert (parameter.low, parameter.high) == kept
    schema = msgspec.json.schema(parameter_type(parameter))
    assert (schema.get("minimum"), schema.get("maximum")) == kept


def test_without_the_library_the_configuration_says_what_to_install() -> None:
    code = "import sys; sys.modules['dronecan'] = None; from rcp_can.profiles import profile; profile('dronecan')"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert "ConfigError" in done.stderr
    assert "pip install 'rcp-gateway[dronecan]'" in done.stderr


async def test_a_simulated_bus_has_all_of_them() -> None:
    bus = {"interface": "virtual", "channel": channel(), "simulate": True}
    nodes = {
        "mast": {"bus": "can0", "node": 20},
        "pack": {"bus": "can0", "node": 41, "sensors": ["battery"]},
    }
    whole = {"buses": {"can0": bus}, "motors": {"m": esc(20, 0)}, "dronecan": nodes}
    async with opened(whole) as rig:
        await rig.ran("service/m/enable")
        await rig.host.until(lambda: "sensor/pack/battery" in rig.host.samples)
        await rig.host.published_as("sensor/mast/state", mode="operational")


def test_bounds_of_another_kind_are_left_out() -> None:
    response = make("protocol.param.GetSet.Response", name="N")
    response.value = make("protocol.param.Value", integer_value=3)
    response.min_value = make("protocol.param.NumericValue", real_value=0.5)
    response.max_value = make("protocol.param.NumericValue", integer_value=9)
    parameter = decoded(response)
    assert parameter is not None
    assert (parameter.low, parameter.high) == (None, 9)
    msgspec.json.schema(parameter_type(parameter))
