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
from rcp_ground_stations.stops import stop_of
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
        self.sent: list[float | None] = []
        self.refuses: set[str] = set()
        self.refuses_once: dict[str, str] = {}
        self.free, self.controlled, self.asking = asyncio.Event(), asyncio.Event(), asyncio.Event()
        self.free.set()
        self.controlled.set()

    async def request(self, _session: Any, request: Any) -> Any:
        body = msgspec.msgpack.decode(request.body)
        what = body.get("do", request.type)
        if what == "acquire":
            self.asking.set()
            await self.controlled.wait()
        if what == "write":
            if stop_of(parsed(body["data"])) is None:
                await self.free.wait()
            self.sent.append(request.timestamp)
            self.written.append(body["data"])
        self.asked.append(what)
        code = "lease_lost" if what in self.refuses else self.refuses_once.pop(what, None)
        error = None if code is None else {"code": code}
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


def parsed(data: bytes) -> Frame:
    """Return a frame."""
    (found,) = Framer(MESSAGES, None).datagram(data)
    return found


def arm(on: float = 1.0) -> Frame:
    """Return a command."""
    return frame(M.MAVLink_command_long_message(1, 1, 400, 0, on, *[0.0] * 6))


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


async def until_refused(refused: list[Refusal]) -> None:
    async def told() -> bool:
        return bool(refused)

    await eventually(told, "a refusal")


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


async def test_a_stop_passes_by_what_waits_and_is_never_too_old() -> None:
    async with flying() as (pilot, gateway, refused):
        gateway.free.clear()  # the robot is slow
        pilot.take(arm())
        await gateway.asking.wait()
        for _ in range(600):
            pilot.take(arm())
        full = len(refused)
        assert full
        pilot.take(arm(0.0))
        await until(gateway, 2)
        assert gateway.written == [arm(0.0).data]
        assert gateway.sent == [None]
        assert {one.code for one in refused[full:]} == {"cancelled"}
        gateway.free.set()
        pilot.take(arm())
        await until(gateway, 3)
        assert gateway.written.count(arm(0.0).data) == 1


async def test_what_waited_for_control_when_a_stop_came_does_not_follow_it() -> None:
    async with flying() as (pilot, gateway, refused):
        gateway.controlled.clear()
        pilot.take(arm())
        await gateway.asking.wait()
        pilot.take(arm(0.0))
        await until(gateway, 1)
        assert gateway.written == [arm(0.0).data]
        gateway.controlled.set()
        await until_refused(refused)
        assert gateway.written == [arm(0.0).data]
        assert [one.code for one in refused] == ["cancelled"]


async def test_a_stop_waits_for_no_lease() -> None:
    async with flying() as (pilot, gateway, _):
        gateway.controlled.clear()  # whoever decides about leases does not answer
        pilot.take(arm(0.0))
        await until(gateway, 1)
        assert gateway.asked == ["write"]


@pytest.mark.parametrize("code", ["lease_required", "lease_lost"])
async def test_a_stop_that_needs_a_lease_acquires_one(code: str) -> None:
    async with flying() as (pilot, gateway, refused):
        gateway.refuses_once["write"] = code
        pilot.take(arm(0.0))
        await until(gateway, 3)
        assert gateway.asked == ["write", "acquire", "write"]
        assert not refused


@pytest.mark.parametrize(
    ("number", "first", "stops"),
    [
        (400, 0, True),
        (400, 1, False),
        (185, 1, True),
        (185, 0, False),
        (193, 0, True),
        (193, 1, False),
        (17, 0, True),
        (22, 0, False),
    ],
)
def test_stops_are_known_by_their_command(number: int, first: float, stops: bool) -> None:  # noqa: FBT001
    given = frame(M.MAVLink_command_long_message(1, 1, number, 0, first, *[0.0] * 6))
    assert (stop_of(given) is not None) is stops
