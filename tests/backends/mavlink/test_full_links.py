"""A link whose other end takes nothing: what waits is bounded, and a stop has room beside it."""

from __future__ import annotations

import asyncio
import os
import socket
import tty
from typing import Any

import anyio

from rcp_mavlink.dialect import dialect
from rcp_mavlink.frames import Framer
from rcp_mavlink.links import Link

FRAME, STOP = b"." * 60, b"STOP"
FLOOD = 3_000_000  # bytes


async def opened(text: str) -> Link:
    link = Link(0, text, lambda: Framer(dialect("ardupilotmega"), None), lambda *_: None)
    joined = asyncio.Event()
    link.joined = joined.set
    await link.open()
    with anyio.fail_after(20):
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
        with anyio.fail_after(20):
            while STOP not in got:
                got += await anyio.to_thread.run_sync(os.read, ours, 4096)
        beside = 2 * 4096  # of the system, in a pair of terminals
        assert got.index(STOP) < 2880 + len(FRAME) + beside
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
            with peer, anyio.fail_after(20):
                while STOP not in got:
                    got += await loop.sock_recv(peer, 65_536)
            assert got.index(STOP) < 65_536 + 3 * 16_384 + 65_536
        finally:
            await link.close()
