"""A link whose other end takes nothing: what waits is bounded, and a stop has room beside it."""

from __future__ import annotations

import asyncio
import os
import socket
import tty
from typing import Any

import anyio
import pytest

from backends.mavlink.puppet import ARDUPILOT, PX4, Puppet, station
from rcp_gateway.testing import eventually
from rcp_mavlink.dialect import dialect
from rcp_mavlink.frames import Framer
from rcp_mavlink.links import Link

FRAME, STOP = b"." * 60, b"STOP"
FLOOD = 3_000_000  # bytes


def fill(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave every link room for what is urgent alone."""
    real = Link.send

    def send(link: Link, frame: bytes, address: Any, *, urgent: bool = False) -> None:
        if urgent:
            real(link, frame, address)

    monkeypatch.setattr(Link, "send", send)


class Aloft(Puppet):
    """In the air, in a mode in which it goes to targets."""

    def __init__(self, autopilot: int, mode: int) -> None:
        super().__init__(autopilot=autopilot)
        self.armed, self.landed, self.mode = True, 2, mode
        self.results[176] = self.set_mode
        self.results[192] = lambda _: 0

    def set_mode(self, message: Any) -> int:
        self.mode = int(message.param2)
        if self.autopilot == PX4:
            self.mode = int(message.param2) << 16 | int(message.param3) << 24
        return 0


@pytest.mark.parametrize(("autopilot", "mode"), [(ARDUPILOT, 4), (PX4, 4 << 16 | 4 << 24)])
async def test_a_hold_has_room_on_a_full_link(
    autopilot: int, mode: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    puppet = Aloft(autopilot, mode)
    async with station(puppet) as found:
        await eventually(lambda: _is(found.robot.vehicle.landed is False), "aloft")
        fill(monkeypatch)
        await found.robot.motion.hold()
        assert puppet.mode != mode
        if autopilot == PX4:
            await eventually(lambda: _is(puppet.commands(192)), "it stays there")


async def test_a_cancellation_has_room_on_a_full_link(monkeypatch: pytest.MonkeyPatch) -> None:
    puppet = Puppet()
    puppet.results[211] = lambda _: 5
    async with station(puppet) as found:
        path, body = "/tenant/t/service/command", {"command": "DO_GRIPPER"}
        begun = asyncio.Event()
        with found.robot.vehicle.listening(
            "COMMAND_ACK", lambda ack: begun.set() if ack.fields()["command"] == 211 else None
        ):
            await found.client.send(type="execute", path=path, body=body)
            await asyncio.wait_for(begun.wait(), 60.0)  # only what has begun can be cancelled
        fill(monkeypatch)
        await found.client.request("cancel", path)
        await eventually(lambda: _is(puppet.messages("UNKNOWN_80")), "it is told")


async def test_sticks_are_released_on_a_full_link(monkeypatch: pytest.MonkeyPatch) -> None:
    puppet = Aloft(ARDUPILOT, 5)
    async with station(puppet, sticks=True) as found:
        await eventually(lambda: _is(found.robot.vehicle.landed is False), "aloft")
        done = await found.write("actuator/sticks", {"pitch": 0.5}, valid_for=20.0)
        assert done["status"] == "completed", done
        fill(monkeypatch)
        await found.write("actuator/sticks", {})
        await eventually(lambda: _is(puppet.messages("RC_CHANNELS_OVERRIDE")), "released")


async def opened(text: str) -> Link:
    link = Link(0, text, lambda: Framer(dialect("ardupilotmega"), None), lambda *_: None)
    joined = asyncio.Event()
    link.joined = joined.set
    await link.open()
    with anyio.fail_after(60):
        await joined.wait()
    return link


def flood(link: Link) -> None:
    """Send far more than fits, and then a stop."""
    for _ in range(FLOOD // len(FRAME)):
        link.send(FRAME, None)
    link.send(STOP, None, urgent=True)


async def test_a_stop_does_not_wait_behind_a_full_serial_line() -> None:
    ours, theirs = os.openpty()
    tty.setraw(ours)
    link = await opened(f"serial:{os.ttyname(theirs)}:57600")
    try:
        flood(link)
        got = b""
        with anyio.fail_after(60):
            while STOP not in got:
                got += await anyio.to_thread.run_sync(os.read, ours, 4096)
        beside = 2 * 4096  # of the system, in a pair of terminals
        assert got.index(STOP) < 2880 + len(FRAME) + beside
        stats = link.framer.stats
        assert stats.dropped == FLOOD // len(FRAME) + 1 - stats.sent > 0
    finally:
        await link.close()
        os.close(ours)
        os.close(theirs)


async def test_a_stop_does_not_wait_behind_a_connection_that_was_not_read() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 8192)
        server.setblocking(False)
        link = await opened(f"tcp:127.0.0.1:{server.getsockname()[1]}")
        loop: Any = asyncio.get_running_loop()
        peer, _ = await loop.sock_accept(server)
        try:
            flood(link)
            got = b""
            with peer, anyio.fail_after(60):
                while STOP not in got:
                    got += await loop.sock_recv(peer, 65_536)
            assert got.index(STOP) < 65_536 + 3 * 16_384 + 65_536
        finally:
            await link.close()


async def _is(truth: object) -> bool:
    return bool(truth)
