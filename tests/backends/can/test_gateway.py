"""Motors through a whole gateway: what a client can ask of them, and what it is told."""

from __future__ import annotations

import asyncio
import struct
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import anyio
import can
import pytest

import rcp_can
from backends.can.rig import MOTORS, channel, with_keys
from rcp_can.sim import Bench, Twin, make_twin
from rcp_gateway.testing._serve import ADMIN, OPERATOR, VIEWER, serve_backend

KIND = next(iter(rcp_can.rcp_backends()))


class Bed:
    """An operator at a gateway with one motor 'm' behind it."""

    def __init__(self, served: Any, twin: Any) -> None:
        self.served, self.twin = served, twin
        self.client = served.client(OPERATOR)

    async def ask(self, operation: str, name: str, body: Any = None, **more: Any) -> Any:
        return await self.client.request(
            operation, f"/tenant/t/{name}", body=body, within=60.0, **more
        )

    async def done(self, name: str, body: Any = None) -> Any:
        reply = await self.ask("execute", name, body)
        assert reply["status"] == "completed", reply
        return reply.get("body")

    async def code(self, operation: str, name: str, body: Any = None) -> str:
        reply = await self.ask(operation, name, body)
        assert "error" in reply, reply
        return reply["error"]["code"]

    async def until(self, holds: Callable[[], object], seconds: float = 60.0) -> None:
        with anyio.fail_after(seconds):
            while not holds():  # noqa: ASYNC110  # a twin lives in a thread that tells nobody
                await asyncio.sleep(0.003)


@asynccontextmanager
async def bed(
    profile: str, *, bus: dict[str, Any] | None = None, **keys: Any
) -> AsyncGenerator[Bed]:
    name = channel()
    # A busy machine holds up the twin's thread for longer than a drive would be silent.
    patient = {"feedback_timeout": 5.0}
    table = {"bus": "can0", "profile": profile, **with_keys(profile, patient | keys)}
    fd = profile == "moteus"
    protocol = can.CanProtocol.CAN_FD if fd else can.CanProtocol.CAN_20
    line = can.Bus(name, "virtual", protocol=protocol, ignore_config=True)
    twin: Twin = make_twin(profile, table["node"], **table.get("options", {}))
    config = {
        "buses": {"can0": {"interface": "virtual", "channel": name, "fd": fd, **(bus or {})}},
        "motors": {"m": table},
        "grace": 5.0,
    }
    with Bench(line, [twin]):
        async with serve_backend(KIND, config) as served:
            bed = Bed(served, twin)
            # A gateway begins to serve while its backends open, which a busy machine delays.
            await bed.until(lambda: served.lives, 30)
            yield bed


@pytest.mark.parametrize("profile", [name for name in MOTORS if name != "vesc"])
async def test_enable_move_gear_direction_and_offset(profile: str) -> None:
    async with bed(profile, gear=2.0, direction=-1, offset=0.5, velocity=10.0) as motor:
        assert await motor.code("write", "actuator/m/velocity", 1.0) == "mode_forbids"
        await motor.done("service/m/enable")
        moved = await motor.done("action/m/move_to", {"position": 1.5})
        assert moved["position"] == pytest.approx(1.5, abs=0.02)
        assert motor.twin.plant.position == pytest.approx(-2.0, abs=0.05)
        reply = (await motor.ask("read", "sensor/m/motion"))["body"]
        assert reply["position"] == pytest.approx(1.5, abs=0.03)
        await motor.done("service/m/disable")
        await motor.until(lambda: not motor.twin.enabled)


@pytest.mark.parametrize("profile", MOTORS)
async def test_the_dead_man_stops_a_velocity_that_nobody_repeats(profile: str) -> None:
    async with bed(profile, valid_for=0.3) as motor:
        await motor.done("service/m/enable")
        await motor.ask("write", "actuator/m/velocity", 3.0)
        await motor.until(lambda: motor.twin.plant.velocity > 2.5)
        await motor.until(lambda: abs(motor.twin.plant.velocity) < 0.1)


@pytest.mark.parametrize("control", ["profile", "cyclic"])
async def test_the_modes_of_cia_402(control: str) -> None:
    options = {"control": control}
    async with bed("cia402", options=options, velocity=10.0, acceleration=50.0) as motor:
        await motor.done("service/m/enable")
        shown: dict[str, int] = {}
        for actuator, value in (("velocity", 2.0), ("torque", 0.1), ("position", 0.3)):
            reply = await motor.ask("write", f"actuator/m/{actuator}", value)
            assert reply["status"] == "completed", reply
            kind = {"velocity": "loop", "torque": "loop", "position": "loop"}[actuator]
            await motor.until(lambda a=actuator, k=kind: getattr(motor.twin.plant, k) == a)
            shown[actuator] = motor.twin.get("mode")
            await motor.ask("write", "actuator/m/velocity", 0.0)
        wanted = {"profile": (3, 4, 8), "cyclic": (9, 10, 8)}[control]
        assert tuple(shown.values()) == wanted
        moved = await motor.done("action/m/move_to", {"position": 1.0})
        assert moved["position"] == pytest.approx(1.0, abs=0.02)
        assert motor.twin.get("mode") == (1 if control == "profile" else 8)


@pytest.mark.parametrize("profile", ["cia402", "odrive"])
async def test_homing(profile: str) -> None:
    async with bed(profile, velocity=10.0) as motor:
        assert await motor.code("execute", "action/m/home") == "mode_forbids"
        await motor.done("service/m/enable")
        await motor.done("action/m/move_to", {"position": 1.0})
        await motor.done("action/m/home")
        assert motor.twin.plant.position == pytest.approx(0, abs=0.01)
        assert (await motor.ask("read", "sensor/m/state"))["body"]["homed"] is True


@pytest.mark.parametrize("profile", ["odrive", "damiao", "cybergear", "moteus"])
async def test_set_zero(profile: str) -> None:
    async with bed(profile, velocity=10.0) as motor:
        await motor.done("service/m/enable")
        await motor.done("action/m/move_to", {"position": 1.0})
        await motor.done("service/m/disable")
        await motor.done("service/m/set_zero")
        assert motor.twin.plant.position == pytest.approx(0, abs=0.05)


@pytest.mark.parametrize("profile", ["cia402", "odrive", "damiao", "cybergear", "moteus"])
async def test_a_fault_is_an_event_and_is_cleared(profile: str) -> None:
    async with bed(profile) as motor:
        watching = await motor.client.subscribe("/tenant/t/event/m/fault")
        await motor.done("service/m/enable")
        motor.twin.break_down()
        event = await motor.client.update(watching)
        assert event["body"]["active"] is True
        axis = motor.served.life.backend.axes["m"]
        await motor.until(lambda: axis.state == "fault")
        assert await motor.code("write", "actuator/m/velocity", 1.0) == "mode_forbids"
        await motor.done("service/m/clear_faults")
        state = (await motor.ask("read", "sensor/m/state"))["body"]
        assert (state["state"], state.get("faults", [])) == ("disabled", [])
        await motor.done("service/m/enable")


async def test_a_ramp_is_kept_to() -> None:
    async with bed("damiao", acceleration=10.0, velocity=20.0, rate=100, valid_for=2.0) as motor:
        await motor.done("service/m/enable")
        before = asyncio.get_running_loop().time()
        await motor.ask("write", "actuator/m/velocity", 5.0)
        await motor.until(lambda: motor.twin.plant.velocity > 4.8)
        assert asyncio.get_running_loop().time() - before > 0.35


async def test_what_is_out_of_limits_is_refused_with_its_bound() -> None:
    async with bed("odrive", position=[-1.0, 1.0], velocity=4.0, torque=0.5) as motor:
        await motor.done("service/m/enable")
        for name, value in (("velocity", 4.1), ("torque", -0.6), ("position", 1.2)):
            assert await motor.code("write", f"actuator/m/{name}", value) == "out_of_range"
        assert await motor.code("execute", "action/m/move_to", {"position": 1.2}) == "out_of_range"


async def test_an_e_stop_is_a_quick_stop_and_nothing_moves_until_it_is_reset() -> None:
    async with bed("cia402", velocity=10.0) as motor:
        await motor.done("service/m/enable")
        id_ = await motor.client.send(
            type="execute", path="/tenant/t/action/m/move_to", body={"position": 50.0}
        )
        await motor.until(lambda: motor.twin.plant.velocity > 5.0)
        stopped = await motor.client.request("execute", "/system/estop", body={}, within=60.0)
        assert stopped["status"] == "completed", stopped
        reply = await motor.client.final(id_, 20.0)
        assert reply["status"] in ("failed", "cancelled"), reply
        assert motor.twin.state == "quick_stop"
        assert abs(motor.twin.plant.velocity) < 0.1
        assert await motor.code("write", "actuator/m/velocity", 1.0) == "estop_active"


# The watchdog in the drive: set, where it can be, before anything moves


async def test_a_canopen_drive_is_told_how_long_the_gateway_may_be_silent() -> None:
    async with bed("cia402", watchdog=0.3, options={"master": 100}) as motor:
        await motor.until(lambda: motor.twin.get_raw(0x1016, 1) == 100 << 16 | 300)


async def test_a_damiao_is_told_how_long_the_gateway_may_be_silent() -> None:
    async with bed("damiao", watchdog=0.25) as motor:
        wanted = struct.pack("<I", 5000)  # of 50 µs
        await motor.until(lambda: motor.twin.registers[9] == wanted)


async def test_a_cybergear_is_told_how_long_the_gateway_may_be_silent() -> None:
    async with bed("cybergear", watchdog=0.25) as motor:
        wanted = struct.pack("<I", 5000)  # of 50 µs
        await motor.until(lambda: motor.twin.parameters.get(0x7028) == wanted)


async def test_a_moteus_is_told_with_every_set_point() -> None:
    async with bed("moteus", watchdog=0.25) as motor:
        await motor.done("service/m/enable")
        await motor.until(lambda: motor.twin.command["watchdog"] == pytest.approx(0.25))


# Raw frames


async def test_raw_frames_are_chosen_by_id_in_a_subscription_and_sent_by_permission() -> None:
    async with bed("odrive", bus={"raw_send": True}) as motor:
        heartbeats = {"field": "id", "ge": 0x21, "le": 0x21}
        watching = await motor.client.subscribe("/tenant/t/event/can/can0/frame", where=heartbeats)
        for _ in range(3):
            assert (await motor.client.update(watching))["body"]["id"] == 0x21
        frame = {"id": 0x123, "data": "AQI="}
        reply = await motor.ask("write", "actuator/can/can0/frame", frame)
        assert reply["status"] == "completed", reply
        viewer = motor.served.client(VIEWER)
        path = "/tenant/t/actuator/can/can0/frame"
        refused = await viewer.request("write", path, body=frame)
        assert refused["error"]["code"] == "forbidden", refused
        admin = motor.served.client(ADMIN)
        assert (await admin.request("write", path, body=frame))["status"] == "completed"


@pytest.mark.parametrize("format_", ["candump", "asc", "blf"])
async def test_frames_are_recorded_on_request(format_: str, tmp_path: Path) -> None:
    async with bed("odrive", bus={"log_directory": str(tmp_path)}) as motor:
        viewer = motor.served.client(VIEWER)
        start, stop = "service/can/can0/start_log", "service/can/can0/stop_log"
        refused = await viewer.request("execute", f"/tenant/t/{start}", body={"format": format_})
        assert refused["error"]["code"] == "forbidden", refused
        begun = await motor.done(start, {"format": format_})
        await motor.done("service/m/enable")
        ended = await motor.done(stop)
        assert ended["file"] == begun["file"]
        with can.LogReader(tmp_path / ended["file"]) as log:
            frames = list(log)
        assert len(frames) == ended["frames"]
        assert {frame.arbitration_id for frame in frames} >= {0x21, 0x29, 0x27}
