"""A link with a device over a real socket: cut, silent, late and talking nonsense."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager, suppress
from functools import partial
from itertools import pairwise
from typing import Any

import msgspec
import pytest

from rcp_gateway.testing import BOUND, SteppedClock
from rcp_kernel.errors import AdapterUnavailable, DeviceTimeout, NotReady, Refused
from rcp_links import LinkTiming, Messages, RequestLink, json_lines, request_link

Message = dict[str, Any]
QUICK = LinkTiming(first_pause=0.01, longest_pause=0.04)
LONG = 300.0  # s that no test waits


class Device:
    """Listens on a port; answers probes at once, and the rest when a test says so."""

    def __init__(self) -> None:
        self.received = asyncio.Queue[Message]()
        self.connected = asyncio.Queue[asyncio.StreamWriter]()
        self.answers_probes = True
        self.port = 0
        self.writer: asyncio.StreamWriter | None = None

    async def take(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.connected.put_nowait(writer)
        self.writer = writer
        with suppress(ConnectionResetError):
            while line := await reader.readline():
                message = msgspec.json.decode(line)
                if message["do"] != "probe":
                    self.received.put_nowait(message)
                elif self.answers_probes:
                    self.send({"id": message["id"]})
        writer.transport.abort()

    def send(self, message: Message) -> None:
        self.write(msgspec.json.encode(message) + b"\n")

    def write(self, data: bytes) -> None:
        assert self.writer is not None
        self.writer.write(data)

    async def request(self) -> Message:
        async with asyncio.timeout(BOUND):
            return await self.received.get()

    async def connection(self) -> None:
        async with asyncio.timeout(BOUND):
            await self.connected.get()

    def close(self) -> None:
        assert self.writer is not None
        self.writer.close()

    def cut(self) -> None:
        if self.writer is not None:
            self.writer.transport.abort()


class Gateway:
    """Keeps what a link tells."""

    def __init__(self) -> None:
        self.told = asyncio.Queue[str]()

    def report(self, detail: str | None, *, down: bool = False, robot: str | None = None) -> None:
        assert down == (detail is not None)
        self.told.put_nowait(f"{robot}: {detail or 'up'}")

    def link_restored(self, robot: str | None = None) -> None:
        self.told.put_nowait(f"{robot}: restored")

    async def next(self, *expected: str) -> None:
        for each in expected:
            async with asyncio.timeout(BOUND):
                assert each in (told := await self.told.get()), told


@pytest.fixture
async def device() -> AsyncGenerator[Device]:
    made = Device()
    async with await asyncio.start_server(made.take, "127.0.0.1", 0) as server:
        made.port = server.sockets[0].getsockname()[1]
        yield made
        made.cut()


@pytest.fixture
def gateway() -> Gateway:
    return Gateway()


def numbered(do: str) -> Callable[[int], Message]:
    return lambda number: {"id": number, "do": do}


@asynccontextmanager
async def linked(
    device: Device,
    gateway: Gateway,
    handle: Callable[[Message], None] = lambda _: None,
    timing: LinkTiming = QUICK,
) -> AsyncGenerator[RequestLink[Message]]:
    messages = Messages(numbered("probe"), lambda message: message.get("id"), handle)
    connect = partial(json_lines, "127.0.0.1", device.port)
    async with (
        asyncio.timeout(BOUND * 4),
        request_link(connect, messages, gateway, robot="r1", timing=timing) as link,
    ):
        await device.connection()
        await gateway.next("r1: restored", "r1: up")
        yield link


async def test_answers_reach_who_asked_in_whatever_order_they_come(
    device: Device, gateway: Gateway
) -> None:
    async with linked(device, gateway) as link:
        asked = [asyncio.create_task(link.request(numbered(do), within=LONG)) for do in ("a", "b")]
        first, second = [await device.request() for _ in asked]
        device.send({"id": second["id"], "value": 2})
        device.send({"id": first["id"], "value": 1})
        assert [(await each)["value"] for each in asked] == [1, 2]


async def test_what_answers_nothing_is_handled_in_order(device: Device, gateway: Gateway) -> None:
    handled = asyncio.Queue[Message]()
    async with linked(device, gateway, handled.put_nowait):
        device.send({"x": 1})
        device.send({"id": 999})  # of nobody's request
        device.send({"x": 2})
        assert [await handled.get(), await handled.get()] == [{"x": 1}, {"x": 2}]


async def test_a_request_while_the_link_is_down_is_refused_and_never_sent(
    device: Device, gateway: Gateway
) -> None:
    async with linked(device, gateway) as link:
        device.answers_probes = False  # so that the next connection is not up
        device.cut()
        await gateway.next("r1: connection lost")
        await device.connection()
        assert not link.is_up
        with pytest.raises(AdapterUnavailable, match="connection lost"):
            await link.request(numbered("move"), within=LONG)
        link.post(numbered("stop"))
        device.answers_probes = True
        device.cut()
        await gateway.next("r1: connection lost", "r1: restored", "r1: up")
        asking = asyncio.create_task(link.request(numbered("read"), within=LONG))
        request = await device.request()
        assert request["do"] == "read"
        device.send({"id": request["id"]})
        await asking


async def test_a_cut_during_a_request_ends_it_and_tells_a_refusal_from_the_unknown(
    device: Device, gateway: Gateway
) -> None:
    effects: list[Message] = []
    async with linked(device, gateway) as link:
        reading = asyncio.create_task(link.request(numbered("read"), within=LONG))
        moving = asyncio.create_task(
            link.request(numbered("move"), within=LONG, effect=effects.append)
        )
        for _ in range(2):
            await device.request()
        device.cut()
        with pytest.raises(AdapterUnavailable, match="connection lost"):
            await reading
        with pytest.raises(DeviceTimeout, match="unknown whether") as lost:
            await moving
        assert not isinstance(lost.value, Refused)  # it may be moving
        assert effects == []


async def test_an_answer_just_before_a_cut_counts(device: Device, gateway: Gateway) -> None:
    async with linked(device, gateway) as link:
        asking = asyncio.create_task(link.request(numbered("move"), within=LONG))
        request = await device.request()
        device.send({"id": request["id"], "value": 7})
        device.close()
        assert (await asking)["value"] == 7
        await gateway.next("r1: connection lost", "r1: restored", "r1: up")


async def test_a_cancelled_read_ends_at_once(device: Device, gateway: Gateway) -> None:
    async with linked(device, gateway) as link:
        asking = asyncio.create_task(link.request(numbered("read"), within=LONG))
        await device.request()
        asking.cancel()
        await asyncio.wait([asking])
        assert asking.cancelled()


async def test_a_cancelled_request_with_an_effect_ends_once_the_effect_is_known(
    device: Device, gateway: Gateway
) -> None:
    effects: list[Message] = []
    async with linked(device, gateway) as link:
        moving = asyncio.create_task(
            link.request(numbered("move"), within=LONG, effect=effects.append)
        )
        moved = await device.request()
        moving.cancel()
        reading = asyncio.create_task(link.request(numbered("read"), within=LONG))
        read = await device.request()
        moving.cancel()  # somebody is impatient
        device.send({"id": read["id"]})
        await reading
        assert not moving.done()
        device.send({"id": moved["id"], "value": 1})
        await asyncio.wait([moving])
        assert moving.cancelled()
        assert effects == [{"id": moved["id"], "value": 1}]


async def test_a_late_answer_is_still_an_effect(
    device: Device, gateway: Gateway, stepped: SteppedClock
) -> None:
    effects = asyncio.Queue[Message]()
    timing = LinkTiming(silence=10 * LONG)
    async with linked(device, gateway, timing=timing) as link:
        moving = asyncio.create_task(
            link.request(numbered("move"), within=50, effect=effects.put_nowait)
        )
        request = await device.request()
        stepped.advance(30)
        assert not moving.done()
        stepped.advance(30)
        with pytest.raises(DeviceTimeout, match="within 50 s"):
            await moving
        device.send({"id": request["id"], "value": 1})
        assert (await effects.get())["value"] == 1


async def test_a_device_that_accepts_a_connection_and_says_nothing_is_not_there(
    device: Device, gateway: Gateway, stepped: SteppedClock
) -> None:
    device.answers_probes = False
    opening = asyncio.create_task(linked(device, gateway).__aenter__())
    await device.connection()
    stepped.advance(10)
    with pytest.raises(NotReady, match="no message for 2 s"):
        await opening


async def test_nobody_at_the_port_is_not_ready(device: Device, gateway: Gateway) -> None:
    device.port = 1
    with pytest.raises(NotReady, match="no connection"):
        await linked(device, gateway).__aenter__()


async def test_a_device_that_falls_silent_is_lost_and_found_again(
    device: Device, gateway: Gateway, stepped: SteppedClock
) -> None:
    async with linked(device, gateway, timing=LinkTiming(silence=60)) as link:
        device.answers_probes = False
        asking = asyncio.create_task(link.request(numbered("read"), within=LONG))
        await device.request()
        stepped.advance(70)
        with pytest.raises(AdapterUnavailable, match="no message for 60 s"):
            await asking
        await gateway.next("r1: no message for 60 s")
        device.answers_probes = True
        stepped.advance(1)
        await gateway.next("r1: restored", "r1: up")
        assert link.is_up


@pytest.mark.parametrize("line", [b"?\n", b"[1]\n", b"\xff\n", b"x" * (1 << 21) + b"\n"])
async def test_nonsense_ends_the_connection_with_the_reason(
    device: Device, gateway: Gateway, line: bytes
) -> None:
    async with linked(device, gateway):
        device.write(line)
        await gateway.next("r1: received something that is no message", "restored", "up")


@pytest.mark.parametrize("error", [KeyError, OSError, TimeoutError, asyncio.CancelledError])
async def test_a_fault_of_the_author_is_told_and_the_link_returns(
    device: Device, gateway: Gateway, error: type[BaseException]
) -> None:
    def handle(message: Message) -> None:
        raise error(message["x"])

    async with linked(device, gateway, handle) as link:
        asking = asyncio.create_task(link.request(numbered("read"), within=LONG))
        await device.request()
        device.send({"x": 1})
        await gateway.next("r1: fault of the backend", "restored", "up")
        with pytest.raises(AdapterUnavailable, match="fault of the backend"):
            await asking


async def test_a_fault_of_the_author_at_the_end_does_not_keep_the_link(
    device: Device, gateway: Gateway
) -> None:
    faulty, fault = False, asyncio.Event()

    def probe(number: int) -> Message:
        if faulty:
            fault.set()
            raise LookupError(number)
        return {"id": number, "do": "probe"}

    messages = Messages(probe, lambda message: message.get("id"), lambda _: None)
    connect = partial(json_lines, "127.0.0.1", device.port)
    timing = LinkTiming(silence=0.3, first_pause=0.01, longest_pause=0.04)
    async with asyncio.timeout(BOUND * 4):
        async with request_link(connect, messages, gateway, robot="r1", timing=timing):
            await gateway.next("r1: restored", "r1: up")
            faulty = True
            await fault.wait()
    told = [gateway.told.get_nowait() for _ in range(gateway.told.qsize())]
    assert all("fault of the backend" in one for one in told)  # it was not made again


@pytest.mark.parametrize("error", [KeyError, ValueError, asyncio.CancelledError])
async def test_a_fault_in_an_effect_costs_neither_the_answer_nor_the_link(
    device: Device, gateway: Gateway, error: type[BaseException]
) -> None:
    def effect(message: Message) -> None:
        raise error(message["id"])

    async with linked(device, gateway) as link:
        for value in (1, 2):
            asking = asyncio.create_task(link.request(numbered("move"), within=LONG, effect=effect))
            request = await device.request()
            device.send({"id": request["id"], "value": value})
            assert (await asking)["value"] == value
        assert link.is_up
        assert gateway.told.empty()


async def test_what_is_sent_on_a_closed_connection_is_an_error(device: Device) -> None:
    async with json_lines("127.0.0.1", device.port) as channel:
        channel.send({"do": "move"})
    with pytest.raises(ConnectionResetError):
        channel.send({"do": "move"})


async def test_requests_end_with_the_context(device: Device, gateway: Gateway) -> None:
    async with linked(device, gateway) as link:
        asking = asyncio.create_task(link.request(numbered("read"), within=LONG))
        await device.request()
    with pytest.raises(AdapterUnavailable, match="the link was closed"):
        await asking
    with pytest.raises(AdapterUnavailable, match="the link was closed"):
        await link.request(numbered("read"), within=LONG)


async def test_attempts_are_made_with_growing_pauses(device: Device, gateway: Gateway) -> None:
    began: list[float] = []
    fifth = asyncio.Event()
    available = True

    @asynccontextmanager
    async def connect() -> AsyncGenerator[Any]:
        began.append(asyncio.get_running_loop().time())
        if len(began) == 6:
            fifth.set()
        if not available:
            raise ConnectionRefusedError("nobody listens")
        async with json_lines("127.0.0.1", device.port) as channel:
            yield channel

    messages = Messages[Message](numbered("probe"), lambda one: one.get("id"), lambda _: None)
    async with (
        asyncio.timeout(BOUND),
        request_link(connect, messages, gateway, timing=QUICK),
    ):
        available = False
        device.cut()
        await fifth.wait()
    gaps = [after - before for before, after in pairwise(began[1:])]
    for gap, pause in zip(gaps, (0.02, 0.04, 0.04, 0.04), strict=True):
        assert gap >= 0.75 * pause
