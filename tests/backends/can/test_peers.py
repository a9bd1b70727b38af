"""Peers that are not ours: their devices driven by us, our twins driven by them."""

from __future__ import annotations

import asyncio
import math
import struct
import time
import warnings
from collections.abc import AsyncGenerator, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager
from typing import Any

import anyio
import can
import pytest

from backends.can.peers import durand_network
from backends.can.rig import RecordingHost, channel, opened
from rcp_can.bus import Bus
from rcp_can.config import BusConfig
from rcp_can.health import Health
from rcp_can.sdo import Sdo, SdoAborted
from rcp_can.sim import Bench, make_twin
from rcp_kernel.errors import DeviceTimeout


@contextmanager
def bench(profile: str, node: int, **options: Any) -> Iterator[tuple[Any, str]]:
    """Run one twin; yield it and the name of its bus."""
    name = channel()
    protocol = can.CanProtocol.CAN_FD if profile == "moteus" else can.CanProtocol.CAN_20
    line = can.Bus(name, "virtual", protocol=protocol, ignore_config=True)
    twin = make_twin(profile, node, **options)
    with Bench(line, [twin]):
        yield twin, name


@asynccontextmanager
async def line(name: str) -> AsyncGenerator[Bus]:
    """Open one of our buses without a backend around it."""
    config = BusConfig(interface="virtual", channel=name)
    host: Any = RecordingHost()
    host.publish = lambda *_: None
    bus = Bus("can0", config, host, Health(host))
    ready = asyncio.Event()
    running = asyncio.ensure_future(bus.run(ready))
    await ready.wait()
    try:
        yield bus
    finally:
        running.cancel()
        await asyncio.wait((running,))


def until(holds: Callable[[], object], seconds: float = 60.0) -> None:
    """Wait in a thread of its own for what another thread does."""
    end = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < end, "it did not come about"
        time.sleep(0.002)  # the other thread tells nobody


# canopen's master drives our CiA 402 twin


def test_canopens_own_402_master_drives_our_twin() -> None:
    import canopen
    from canopen.profiles.p402 import BaseNode402

    from rcp_can.sim.cia402_objects import make_dictionary

    with bench("cia402", 5) as (twin, name):
        network = canopen.Network()
        network.connect(channel=name, interface="virtual", ignore_config=True)
        try:
            node = BaseNode402(5, make_dictionary(5))
            network.add_node(node)
            node.nmt.state = "PRE-OPERATIONAL"
            assert node.sdo[0x1018][1].raw == 0x1CA
            with pytest.raises(canopen.SdoAbortedError) as caught:
                node.sdo.upload(0x2FFF, 0)
            assert caught.value.code == 0x06020000
            node.nmt.state = "OPERATIONAL"
            for word, state in ((0x06, 0x231), (0x07, 0x233), (0x0F, 0x237)):
                node.sdo[0x6040].raw = word
                until(lambda w=state: node.sdo[0x6041].raw & 0x6F == w & 0x6F)
            node.sdo[0x6060].raw = 1
            node.sdo[0x6081].raw = 40_000
            node.sdo[0x607A].raw = 4096
            node.sdo[0x6040].raw = 0x1F
            until(lambda: node.sdo[0x6041].raw & 1 << 10 and node.sdo[0x6064].raw > 4000)
            assert twin.plant.position == pytest.approx(2 * math.pi, abs=0.02)
            twin.break_down()
            until(lambda: node.emcy.active)
            assert node.emcy.active[0].code == 0x2310
            node.sdo[0x6040].raw = 0x80
            until(lambda: not node.emcy.active)
        finally:
            network.disconnect()


# Our SDO client with durand's server


@contextmanager
def durand_node(name: str) -> Iterator[Any]:
    """Run a node of durand's."""
    import durand

    with durand_network(name) as network:
        od = durand.object_dictionary.ObjectDictionary()
        kind = durand.DatatypeEnum
        od[0x2000] = durand.Variable(kind.UNSIGNED32, "rw", 7)
        text = b"a text that needs several segments"
        od[0x2001] = durand.Variable(kind.VISIBLE_STRING, "rw", text)
        od[0x2002] = durand.Variable(kind.UNSIGNED8, "ro", 3)
        od[0x2003] = durand.Variable(kind.INTEGER16, "rw", 0, minimum=-5, maximum=5)
        yield durand.Node(network, 9, od)


async def test_our_sdo_client_reads_and_writes_durands_objects() -> None:
    name = channel()
    with durand_node(name):
        async with line(name) as bus:
            sdo = Sdo(bus, 9)
            bus.listen(sdo.take, sdo.route)
            assert await sdo.upload(0x2000) == struct.pack("<I", 7)
            await sdo.download(0x2000, 0, struct.pack("<I", 0xDEADBEEF))
            assert await sdo.upload(0x2000) == struct.pack("<I", 0xDEADBEEF)
            assert await sdo.upload(0x2001) == b"a text that needs several segments"
            for text in (b"12345678", b"another text, of another length: %d" % 42, b"x" * 7):
                await sdo.download(0x2001, 0, text)
                assert await sdo.upload(0x2001) == text


@pytest.mark.parametrize(
    ("index", "data", "abort"),
    [
        (0x2FFF, b"\0", 0x06020000),
        (0x2002, b"\0", 0x06010002),
        (0x2003, struct.pack("<h", 6), 0x06090031),
        (0x2003, struct.pack("<h", -6), 0x06090032),
        (0x2000, b"\0", 0x06070010),
    ],
)
async def test_durands_refusals_are_told_in_words(index: int, data: bytes, abort: int) -> None:
    name = channel()
    with durand_node(name):
        async with line(name) as bus:
            sdo = Sdo(bus, 9)
            bus.listen(sdo.take, sdo.route)
            with pytest.raises(SdoAborted, match=f"0x{abort:08X}") as caught:
                await sdo.download(index, 0, data)
            assert "unknown reason" not in caught.value.message


async def test_a_node_that_is_not_there_does_not_answer() -> None:
    async with line(channel()) as bus:
        sdo = Sdo(bus, 9)
        bus.listen(sdo.take, sdo.route)
        with pytest.raises(DeviceTimeout, match="node 9 did not respond"):
            await sdo.upload(0x1000)


# odrive-can's mock, driven by us


@asynccontextmanager
async def odrive_mock(name: str) -> AsyncGenerator[Any]:
    """Run the mock of odrive-can, as it is."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from odrive_can.mock import ODriveCANMock

    bus: Any = can.Bus(name, "virtual", ignore_config=True)
    mock = ODriveCANMock(1, bus)
    mock.set_rate_of_change(20.0)
    running = asyncio.ensure_future(mock.main())
    try:
        yield mock
    finally:
        running.cancel()
        await asyncio.wait((running,))


async def test_we_drive_the_mock_of_odrive_can() -> None:
    name = channel()
    motor = {"bus": "can0", "profile": "odrive", "node": 1, "timeout": 10.0, "velocity": 60.0}
    bus = {"interface": "virtual", "channel": name}
    table = {"buses": {"can0": bus}, "motors": {"m": motor}, "grace": 30.0}
    async with odrive_mock(name) as mock, opened(table) as rig:
        await rig.ran("service/m/enable")
        assert mock.odrive.axis_state == "CLOSED_LOOP_CONTROL"
        moved = await rig.ran("action/m/move_to", {"position": 6.28, "tolerance": 0.1})
        assert moved["position"] == pytest.approx(6.28, abs=0.1)
        assert mock.odrive.model.setpoint == pytest.approx(1.0, abs=0.01)
        await rig.write("actuator/m/velocity", math.pi)
        with anyio.fail_after(60):
            while abs(mock.odrive.model.setpoint - 0.5) > 0.01:  # noqa: ASYNC110
                await asyncio.sleep(0.02)
        with anyio.fail_after(60):
            await rig.backend.halt()
        assert mock.odrive.model.setpoint == pytest.approx(0.0, abs=0.01)
        assert rig.backend.buses["can0"].malformed == 0


# moteus' official library drives our twin


async def test_the_official_moteus_library_drives_our_twin() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import moteus

    with bench("moteus", 1) as (twin, name):
        device = moteus.PythonCan(interface="virtual", channel=name)
        drive = moteus.Controller(id=1, transport=device)
        try:
            with anyio.fail_after(60):
                await drive.set_stop()
                found: Any = await drive.query()
                assert found.values[moteus.Register.MODE] == moteus.Mode.STOPPED
                assert found.values[moteus.Register.VOLTAGE] == pytest.approx(24.0)
                while abs(found.values[moteus.Register.POSITION] - 0.5) > 0.002:
                    found = await drive.set_position(
                        position=0.5,
                        velocity=0.0,
                        velocity_limit=4.0,
                        accel_limit=40.0,
                        watchdog_timeout=1.0,
                        query=True,
                    )
                    await asyncio.sleep(0.01)
                assert found.values[moteus.Register.MODE] == moteus.Mode.POSITION
                assert twin.plant.position == pytest.approx(math.pi, abs=0.02)
                await drive.set_output_exact(position=0.0)
                while abs(twin.plant.position) > 0.1:  # noqa: ASYNC110  # it lives in a thread
                    await asyncio.sleep(0.01)
                await drive.set_stop()
                while twin.enabled:  # noqa: ASYNC110
                    await asyncio.sleep(0.01)
        finally:
            device.close()


# damiao-motor and cybergeardriver drive our twins


def test_damiao_motor_drives_our_twin() -> None:
    from damiao_motor import DaMiaoController

    with bench("damiao", 3, model="4310") as (twin, name), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it names the interface as python-can no longer does
        control = DaMiaoController(channel=name, bustype="virtual")
        try:
            drive = control.add_motor(3, 0, "4310")
            drive.ensure_control_mode("MIT")
            drive.set_can_timeout(60_000)
            until(lambda: twin.registers[9] == struct.pack("<I", 1_200_000))
            assert drive.get_register(9) == 1_200_000
            drive.enable()
            until(lambda: twin.enabled)

            def is_there() -> bool:
                drive.send_cmd_mit(target_position=1.0, stiffness=50.0, damping=1.0)
                time.sleep(0.01)  # the beat that the library leaves to its user
                said = drive.get_states()
                rests = abs(twin.plant.position - 1.0) < 0.02 and abs(twin.plant.velocity) < 0.05
                return rests and said.get("status") == "ENABLED" and abs(said["pos"] - 1.0) < 0.05

            until(is_there)
            drive.set_can_timeout(200)
            until(lambda: twin.fault == 0xD)  # its watchdog, that the library has set
            drive.clear_error()
            drive.disable()
            until(lambda: not twin.enabled and twin.fault == 0)
        finally:
            control.shutdown()


def test_cybergeardriver_drives_our_twin() -> None:
    from CyberGearDriver import CyberGearMotor, CyberMotorMessage

    with bench("cybergear", 4) as (twin, name):
        bus = can.Bus(name, "virtual", ignore_config=True)

        def send(message: CyberMotorMessage) -> None:
            bus.send(
                can.Message(
                    arbitration_id=message.arbitration_id, data=message.data, is_extended_id=True
                )
            )

        drive = CyberGearMotor(4, send)

        def listen() -> None:
            while (message := bus.recv(0.02)) is not None:
                heard = CyberMotorMessage(message.arbitration_id, bytearray(message.data))
                drive.message_received(heard)

        try:
            drive.enable()
            until(lambda: twin.enabled)

            def is_there() -> bool:
                drive.control(1.0, 0.0, 0.0, 50.0, 1.0)
                listen()
                here = twin.plant.position
                return abs(here - 1.0) < 0.05 and abs(drive.state["position"] - here) < 0.1

            until(is_there)
            drive.stop()
            until(lambda: not twin.enabled)
            drive.set_zero_position()
            until(lambda: abs(twin.plant.position) < 0.1)
        finally:
            bus.shutdown()
