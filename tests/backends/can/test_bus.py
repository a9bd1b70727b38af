"""The bus: frames in and out, its state and statistics, restart after bus-off, recordings."""

from __future__ import annotations

import asyncio
import errno
import math
import struct
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import anyio
import can
import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from backends.can.rig import Node, Rig, channel, opened
from rcp_can import CanConfig
from rcp_can.condition import read_error
from rcp_can.load import seconds_on_the_bus
from rcp_can.raw import pack
from rcp_can.wire import Wire
from rcp_kernel.errors import (
    AdapterUnavailable,
    ConfigError,
    DeviceRejected,
    InvalidValue,
    NotReady,
    PreconditionFailed,
    QueueFull,
)


def table(name: str, **more: Any) -> dict[str, Any]:
    bus = {"interface": "virtual", "channel": name, "restart": 0.02, "statistics": 0.05, **more}
    return {"buses": {"can0": bus}}


async def test_frames_are_shown_while_watched_and_only_those_wanted() -> None:
    name = channel()
    config = table(name, frames=["0x100-0x1FF", "0x18DAF110"])
    async with opened(config) as rig:
        with Node(name) as node:
            node.send(0x100, b"unseen")
            await rig.host.published_as("sensor/can/can0/statistics", rx=1)
            async with rig.backend.watch("event/can/can0/frame", None):
                node.send(0x050, b"no")
                node.send(0x18DAF110, b"long")
                node.send(0x1FF, b"last")
                await rig.host.published_as("event/can/can0/frame", id=0x1FF)
            node.send(0x101, b"unseen")
            await rig.host.published_as("sensor/can/can0/statistics", rx=5)
        seen = rig.host.samples["event/can/can0/frame"]
        assert [(f.id, f.data, f.extended) for f in seen] == [
            (0x18DAF110, b"long", True),
            (0x1FF, b"last", False),
        ]


async def test_a_frame_is_sent_where_that_is_offered() -> None:
    name = channel()
    async with opened(table(name, raw_send=True)) as rig:
        with Node(name) as node:
            await rig.write("actuator/can/can0/frame", {"id": 0x7DF, "data": "AgEM"})
            heard = await node.hears(lambda m: m.arbitration_id == 0x7DF)
            assert (bytes(heard.data), heard.is_extended_id) == (b"\x02\x01\x0c", False)


async def test_sending_frames_is_not_offered_unless_configured() -> None:
    async with opened(table(channel())) as rig:
        assert "actuator/can/can0/frame" not in rig.host.resources


@pytest.mark.parametrize(
    ("frame", "pointer"),
    [
        ({"id": 0x800}, "/id"),
        ({"id": 1, "data": "A" * 16}, "/data"),
        ({"id": 1, "data": "AAAA", "fd": True}, "/fd"),
        ({"id": 1, "error": True}, "/error"),
    ],
)
async def test_a_frame_that_cannot_be_is_refused(frame: dict[str, Any], pointer: str) -> None:
    async with opened(table(channel(), raw_send=True)) as rig:
        with pytest.raises(InvalidValue) as caught:
            await rig.write("actuator/can/can0/frame", frame)
        assert caught.value.details["pointer"] == pointer


async def test_can_fd_frames_go_both_ways() -> None:
    name = channel()
    async with opened(table(name, fd=True, raw_send=True)) as rig:
        with Node(name, fd=True) as node:
            async with rig.backend.watch("event/can/can0/frame", None):
                node.send(0x10, bytes(range(64)), is_fd=True, bitrate_switch=True)
                frame = await rig.host.published_as("event/can/can0/frame", id=0x10)
                assert (frame.fd, frame.bitrate_switch, frame.data) == (
                    True,
                    True,
                    bytes(range(64)),
                )
            data = "A" * 64  # 48 bytes in base64
            await rig.write("actuator/can/can0/frame", {"id": 1, "data": data, "fd": True})
            heard = await node.hears(lambda m: m.arbitration_id == 1)
            assert (heard.is_fd, len(heard.data)) == (True, 48)
            with pytest.raises(InvalidValue):
                await rig.write("actuator/can/can0/frame", {"id": 1, "data": "A" * 12, "fd": True})


async def test_several_buses_are_apart() -> None:
    one, two = channel(), channel()
    config = {
        "buses": {
            "one": {"interface": "virtual", "channel": one},
            "two": {"interface": "virtual", "channel": two},
        }
    }
    async with opened(config) as rig, rig.backend.watch("event/can/one/frame", None):
        async with rig.backend.watch("event/can/two/frame", None):
            with Node(two) as node:
                node.send(0x22)
                await rig.host.published_as("event/can/two/frame", id=0x22)
        assert "event/can/one/frame" not in rig.host.samples


async def test_statistics_count_both_ways_and_tell_the_load() -> None:
    name = channel()
    async with opened(table(name, bitrate=125_000, raw_send=True)) as rig:
        with Node(name) as node:
            for number in range(20):
                node.send(number, bytes(8))
            for number in range(3):
                await rig.write("actuator/can/can0/frame", {"id": number})
            await rig.host.until(
                lambda: any(
                    s.load is not None and s.load > 0 and s.rx == 20
                    for s in rig.host.events("sensor/can/can0/statistics")
                )
            )
            told = await rig.host.published_as("sensor/can/can0/statistics", rx=20, tx=3)
            assert (told.dropped, told.failed, told.malformed, told.restarts) == (0, 0, 0, 0)


async def test_bus_off_restarts_the_bus_and_is_told() -> None:
    name = channel()
    async with opened(table(name, raw_send=True)) as rig:
        with Node(name) as node:
            node.bus_off()
            await rig.host.until(lambda: len(rig.host.events("event/can/can0/state")) >= 3)
            events = [(e.was, e.now) for e in rig.host.samples["event/can/can0/state"]]
            assert events == [
                ("down", "error_active"),
                ("error_active", "bus_off"),
                ("bus_off", "error_active"),
            ]
            assert "bus-off" in (rig.host.reports[0] or "")
            assert rig.host.reports[-1] is None
            await rig.write("actuator/can/can0/frame", {"id": 7})
            await node.hears(lambda m: m.arbitration_id == 7)
            await rig.host.published_as("sensor/can/can0/statistics", restarts=1, error_frames=1)


async def test_while_the_bus_is_off_sending_is_refused_and_nothing_is_kept_for_later() -> None:
    name = channel()
    async with opened(table(name, raw_send=True, restart=0.2)) as rig:
        with Node(name) as node:
            node.bus_off()
            await rig.host.published_as("sensor/can/can0/state", state="bus_off")
            with pytest.raises(AdapterUnavailable, match="bus_off"):
                await rig.write("actuator/can/can0/frame", {"id": 0x66})
            await rig.host.published_as("sensor/can/can0/state", state="error_active")
            await rig.write("actuator/can/can0/frame", {"id": 0x67})
            first = await node.hears(lambda m: not m.is_error_frame)
            assert first.arbitration_id == 0x67


async def test_warnings_of_the_controller_are_told_with_its_counters() -> None:
    name = channel()
    async with opened(table(name)) as rig:
        with Node(name) as node:
            data = bytes([0, 0x20, 0, 0, 0, 0, 130, 3])
            node.send(0x204, data, is_error_frame=True, is_extended_id=False)
            state = await rig.host.published_as("sensor/can/can0/state", state="error_passive")
            assert (state.tx_errors, state.rx_errors) == (130, 3)


async def test_an_interface_that_breaks_is_opened_anew() -> None:
    name = channel()
    async with opened(table(name)) as rig:
        rig.backend.buses["can0"].wire.interface.shutdown()
        await rig.host.published_as("sensor/can/can0/state", state="down")
        await rig.host.published_as("sensor/can/can0/state", state="error_active")


class StuckBus:
    """An interface that takes nothing until it is told to."""

    def __init__(self) -> None:
        self.sent: list[int] = []
        self.gate = threading.Event()
        self.held = asyncio.Event()
        self._loop = asyncio.get_running_loop()

    def recv(self, timeout: float) -> None:
        time.sleep(timeout)  # as an interface does on a silent bus

    def send(self, message: can.Message, timeout: float) -> None:
        self._loop.call_soon_threadsafe(self.held.set)
        assert self.gate.wait(60)
        self.sent.append(message.arbitration_id)

    def shutdown(self) -> None:
        self.gate.set()


async def test_a_full_queue_refuses_but_lets_the_urgent_through_first() -> None:
    bus: Any = StuckBus()
    wire = Wire(bus, name="x", queue=4, echoes=False, received=lambda _: None, lost=lambda _: None)

    def send(number: int, *, urgent: bool = False, lifetime: float | None = None) -> None:
        frame = can.Message(arbitration_id=number)
        wire.send(frame, urgent=urgent, lifetime=lifetime, sender=number)

    send(0)
    with anyio.fail_after(60):
        await bus.held.wait()
    send(1, lifetime=0.0)
    for number in (2, 3, 4):
        send(number)
    with pytest.raises(QueueFull):
        send(5)
    send(9, urgent=True)
    bus.gate.set()
    await wire.close()
    assert bus.sent == [0, 9, 2, 3]
    assert wire.expired == 2  # the one that grew old, the one that gave way


async def test_no_set_point_that_waits_is_sent_after_a_stop() -> None:
    bus: Any = StuckBus()
    wire = Wire(bus, name="x", queue=9, echoes=False, received=lambda _: None, lost=lambda _: None)
    wire.send(can.Message(arbitration_id=0), lifetime=None, urgent=False)
    with anyio.fail_after(60):
        await bus.held.wait()
    wire.send(can.Message(arbitration_id=1), lifetime=60.0, urgent=False)
    wire.send(can.Message(arbitration_id=2), lifetime=None, urgent=False)
    wire.send(can.Message(arbitration_id=3), lifetime=None, urgent=True)
    wire.send(can.Message(arbitration_id=4), lifetime=60.0, urgent=False)
    bus.gate.set()
    await wire.close()
    assert bus.sent == [0, 3, 2, 4]


async def test_a_stop_outdates_what_its_own_sender_has_waiting_and_nothing_else() -> None:
    bus: Any = StuckBus()
    wire = Wire(bus, name="x", queue=9, echoes=False, received=lambda _: None, lost=lambda _: None)
    wire.send(can.Message(arbitration_id=0), lifetime=None, urgent=False)
    with anyio.fail_after(60):
        await bus.held.wait()
    for number, sender in ((1, "a"), (2, "b"), (3, "a")):
        wire.send(can.Message(arbitration_id=number), lifetime=60.0, urgent=False, sender=sender)
    wire.send(can.Message(arbitration_id=9), lifetime=None, urgent=True, sender="a")
    bus.gate.set()
    await wire.close()
    assert bus.sent == [0, 9, 2]
    assert wire.expired == 0  # nobody misses them


async def test_a_stop_of_several_frames_is_sent_in_order_and_replaces_the_one_before() -> None:
    bus: Any = StuckBus()
    wire = Wire(bus, name="x", queue=9, echoes=False, received=lambda _: None, lost=lambda _: None)
    wire.send(can.Message(arbitration_id=0), lifetime=None, urgent=False)
    with anyio.fail_after(60):
        await bus.held.wait()
    for first in (10, 20):
        frames = [can.Message(arbitration_id=first + part) for part in (0, 1)]
        wire.send_together(frames, lifetime=60.0, urgent=True, sender="a")
    wire.send(can.Message(arbitration_id=9), lifetime=None, urgent=False)
    bus.gate.set()
    await wire.close()
    assert bus.sent == [0, 20, 21, 9]  # the first may have set-points of others


class Narrow(StuckBus):
    """An interface with room for one frame, until somebody makes more."""

    def send(self, message: can.Message, timeout: float) -> None:
        if self.sent and not self.gate.is_set():
            self._loop.call_soon_threadsafe(self.held.set)
            raise can.CanOperationError("no room", errno.ENOBUFS)
        self.sent.append(message.arbitration_id)


async def test_frames_that_belong_together_are_not_broken_off_by_a_stop() -> None:
    bus: Any = Narrow()
    wire = Wire(bus, name="x", queue=9, echoes=False, received=lambda _: None, lost=lambda _: None)
    frames = [can.Message(arbitration_id=number) for number in (1, 2, 3)]
    wire.send_together(frames, lifetime=60.0, urgent=False, sender="a")
    with anyio.fail_after(60):
        await bus.held.wait()
    wire.send(can.Message(arbitration_id=9), lifetime=None, urgent=True, sender="a")
    bus.gate.set()
    await wire.close()
    assert bus.sent == [1, 2, 3, 9]


class Socket(StuckBus):
    """A SocketCAN interface at 1 Mbit/s with its usual queue: when that is full, sending fails at once."""

    def __init__(self, *, acknowledged: bool = True) -> None:
        super().__init__()
        self._leaves: list[float] = []
        self._takes = 130e-6 if acknowledged else math.inf

    def send(self, message: can.Message, timeout: float) -> None:
        now = time.monotonic()
        self._leaves = [at for at in self._leaves if at > now]
        if len(self._leaves) >= 10:
            self._loop.call_soon_threadsafe(self.held.set)
            text = "Failed to transmit: No buffer space available"
            raise can.CanOperationError(text, errno.ENOBUFS)
        self._leaves.append(max([now, *self._leaves]) + self._takes)
        self.sent.append(message.arbitration_id)


async def test_a_burst_beyond_the_queue_of_socketcan_loses_nothing() -> None:
    bus, lost = Socket(), list[str]()
    made: Any = bus
    wire = Wire(made, name="x", queue=99, echoes=False, received=lambda _: None, lost=lost.append)
    for number in range(60):
        wire.send(can.Message(arbitration_id=number), lifetime=None, urgent=False)
    await wire.close()
    assert bus.sent == list(range(60))
    assert (wire.failed, lost) == (0, [])


async def test_a_queue_of_socketcan_that_stays_full_ends_the_interface_but_not_at_once() -> None:
    bus, lost = Socket(acknowledged=False), asyncio.Queue[str]()
    made: Any = bus
    wire = Wire(
        made, name="x", queue=99, echoes=False, received=lambda _: None, lost=lost.put_nowait
    )
    for number in range(12):
        wire.send(can.Message(arbitration_id=number), lifetime=0.05, urgent=False, sender="a")
    with anyio.fail_after(60):
        await bus.held.wait()
        wire.send(can.Message(arbitration_id=99), lifetime=None, urgent=True, sender="a")
        began = time.monotonic()
        for _ in range(8):
            wire.send(can.Message(arbitration_id=50), lifetime=None, urgent=False)
        assert "No buffer space available" in await lost.get()
    assert time.monotonic() - began > 0.5
    await wire.close()
    assert bus.sent == list(range(10))
    assert wire.failed == 8, "the set-points that waited for room have failed with nobody"


async def test_an_unknown_interface_is_a_configuration_error_that_lists_those_there_are() -> None:
    with pytest.raises(ConfigError, match=r"buses\.can0\.interface.*slcan"):
        async with opened({"buses": {"can0": {"interface": "carrier-pigeon"}}}):
            pass


async def test_an_interface_that_is_not_there_is_tried_again() -> None:
    config = {"interface": "socketcan", "channel": "nowhere0"}
    with pytest.raises(NotReady, match="nowhere0"):
        async with opened({"buses": {"can0": config}}):
            pass


@pytest.mark.parametrize("format_", ["candump", "asc", "blf"])
async def test_a_recording_holds_every_frame(format_: str, tmp_path: Path) -> None:
    name = channel()
    async with opened(table(name, log_directory=str(tmp_path), raw_send=True)) as rig:
        with Node(name) as node:
            started = await rig.ran("service/can/can0/start_log", {"format": format_})
            with pytest.raises(PreconditionFailed):
                await rig.ran("service/can/can0/start_log", {"format": format_})
            for number in range(50):
                node.send(number, number.to_bytes(2, "big"))
            await rig.write("actuator/can/can0/frame", {"id": 0x7FF})
            await rig.host.published_as("sensor/can/can0/statistics", rx=50)
            ended = await rig.ran("service/can/can0/stop_log")
            with pytest.raises(PreconditionFailed):
                await rig.ran("service/can/can0/stop_log")
    assert ended == {"file": started["file"], "frames": 51}
    with can.LogReader(tmp_path / ended["file"]) as reader:
        found = [message.arbitration_id for message in reader]
    assert sorted(found) == [*range(50), 0x7FF]


async def test_a_directory_that_cannot_be_written_is_told() -> None:
    async with opened(table(channel(), log_directory="/proc/nowhere")) as rig:
        with pytest.raises(DeviceRejected, match="cannot be written"):
            await rig.ran("service/can/can0/start_log", {"format": "blf"})


def test_a_name_or_range_that_cannot_be_is_refused() -> None:
    for bad in ({"frames": ["256"]}, {"simulate": True}, {"speed": 1}):
        with pytest.raises(msgspec.ValidationError):
            msgspec.convert({"buses": {"can0": bad}}, CanConfig)


@given(st.integers(0, 0x1FFFFFFF), st.binary(max_size=8), st.tuples(*3 * [st.booleans()]))
def test_native_frames_are_linux_frames(
    identifier: int, data: bytes, flags: tuple[bool, bool, bool]
) -> None:
    extended, remote, error = flags
    identifier &= 0x1FFFFFFF if extended else 0x7FF
    message = can.Message(
        arbitration_id=identifier,
        is_extended_id=extended,
        is_remote_frame=remote,
        is_error_frame=error,
        data=None if remote else data,
    )
    packed = pack(message)
    word, size = struct.unpack_from("<IB", packed)
    assert len(packed) == 16
    assert word & 0x1FFFFFFF == identifier
    assert (bool(word >> 31), bool(word & 1 << 30), bool(word & 1 << 29)) == (
        extended,
        remote,
        error,
    )
    if not remote:
        assert packed[8 : 8 + size] == data


@given(st.integers(0, 0x1FFFFFFF), st.binary(max_size=64))
def test_any_error_frame_is_read(identifier: int, data: bytes) -> None:
    found = read_error(identifier, data)
    assert found.detail
    assert (found.state == "bus_off") == bool(identifier & 0x40)


def test_a_full_classic_frame_takes_about_a_tenth_more_than_its_bits() -> None:
    seconds = seconds_on_the_bus(
        8, extended=False, fd=False, switched=False, bitrate=1_000_000, data_bitrate=1_000_000
    )
    assert 111e-6 <= seconds <= 135e-6


async def test_the_backend_of_a_rig_refuses_what_it_does_not_have() -> None:
    async with opened(table(channel())) as rig:
        assert isinstance(rig, Rig)
        with pytest.raises(Exception, match="no 'sensor/nothing'"):
            await rig.backend.read("sensor/nothing")


async def test_a_periodic_frame_is_due_at_once_on_a_machine_that_has_just_booted(
    boot: Callable[[], None],
) -> None:
    async with opened(table(channel())) as rig:
        boot()
        assert [rig.backend.buses["can0"].paced("sync", 10.0) for _ in range(2)] == [True, False]
