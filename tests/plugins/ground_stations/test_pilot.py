"""How a ground station has control: by its commands alone, for as long as it commands, and what it sent last."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager, suppress
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest

from rcp_gateway.testing import eventually
from rcp_ground_stations.answers import Refusal
from rcp_ground_stations.config import StationConfig
from rcp_ground_stations.pilot import Pilot
from rcp_mavlink.dialect import dialect
from rcp_mavlink.frames import Frame, Framer

pytestmark = pytest.mark.anyio
MESSAGES = dialect("ardupilotmega")
M = MESSAGES.module
CONFIG = StationConfig(link="udpin:127.0.0.1:0", robot="/tenant/alpha", token="t", hold=600.0)


class Gateway:
    """Answers as the gateway does, and keeps what it was asked; its time is the test's."""

    def __init__(self) -> None:
        self.now = 0.0
        self.loop = SimpleNamespace(time=lambda: self.now)
        self.asked: list[str] = []
        self.written: list[bytes] = []
        self.refuses: set[str] = set()
        self.free = asyncio.Event()
        self.free.set()

    async def request(self, _session: Any, request: Any) -> Any:
        body = msgspec.msgpack.decode(request.body)
        what = body.get("do", request.type)
        if what == "write":
            await self.free.wait()
            self.written.append(body["data"])
        self.asked.append(what)
        error = {"code": "lease_lost"} if what in self.refuses else None
        return SimpleNamespace(error=error, body={"lease": "one"})


def frame(message: Any) -> Frame:
    """Return a message as it is received."""

    class Sink:
        data = b""

        def write(self, data: bytes) -> None:
            self.data = bytes(data)

    sink = Sink()
    M.MAVLink(sink, 245, 190).send(message)
    (found,) = Framer(MESSAGES, None).datagram(sink.data)
    return found


def arm() -> Frame:
    """Return a command."""
    return frame(M.MAVLink_command_long_message(1, 1, 400, 0, 1.0, *[0.0] * 6))


def ask() -> Frame:
    """Return what only asks."""
    return frame(M.MAVLink_param_request_list_message(1, 1))


def stick(x: int) -> Frame:
    """Return the sticks."""
    return frame(M.MAVLink_manual_control_message(1, x, 0, 500, 0, 0))


@asynccontextmanager
async def flying() -> AsyncGenerator[tuple[Pilot, Gateway, list[Refusal]]]:
    """Run a pilot while entered."""
    gateway, refused = Gateway(), list[Refusal]()
    api: Any = gateway
    pilot = Pilot(CONFIG, api, SimpleNamespace(), lambda _, told: refused.append(told))  # pyright: ignore[reportArgumentType] - a session that only the double gets
    task = asyncio.create_task(pilot.run())
    try:
        yield pilot, gateway, refused
    finally:
        task.cancel()
        with suppress(asyncio.CancelledError):
            await task


async def until(gateway: Gateway, count: int) -> None:
    async def asked() -> bool:
        return len(gateway.asked) >= count

    await eventually(asked, f"{count} requests: {gateway.asked}")


async def test_control_that_was_lost_is_asked_for_by_a_command_alone() -> None:
    async with flying() as (pilot, gateway, _):
        pilot.take(arm())
        await until(gateway, 2)
        gateway.refuses.add("renew")  # a stop has ended the lease
        gateway.now += 3.0
        pilot.take(ask())
        await until(gateway, 4)
        gateway.now += 3.0
        pilot.take(ask())
        await until(gateway, 5)
        assert gateway.asked == ["acquire", "write", "execute", "renew", "execute"]
        pilot.take(arm())
        await until(gateway, 7)
        assert gateway.asked[5:] == ["acquire", "write"]


async def test_control_is_kept_while_the_station_only_asks() -> None:
    async with flying() as (pilot, gateway, _):
        pilot.take(arm())
        await until(gateway, 2)
        for _ in range(3):
            gateway.now += 3.0
            pilot.take(ask())
            await until(gateway, len(gateway.asked) + 2)
        assert gateway.asked[2:] == ["execute", "renew"] * 3


async def test_of_sticks_that_wait_only_the_newest_is_sent() -> None:
    async with flying() as (pilot, gateway, refused):
        pilot.take(arm())
        await until(gateway, 2)
        gateway.free.clear()  # the robot is slow
        pilot.take(arm())
        for x in range(100):
            pilot.take(stick(x))
        gateway.free.set()
        await until(gateway, 4)
        assert gateway.written[2:] == [stick(99).data]
        assert not refused


async def test_a_frame_that_fails_takes_no_other_with_it() -> None:
    async with flying() as (pilot, gateway, _):
        broken: Any = SimpleNamespace(definition=SimpleNamespace(name="X"), system=1)
        pilot.take(broken)
        pilot.take(arm())
        await until(gateway, 2)
