"""However fast frames come, one turn of the loop parses few of them."""

from __future__ import annotations

from typing import Any

import pytest

import rcp_asgi.socket
from rcp_web import socket_client
from transports.raw import PING, PONG, TEXT, Raw, frame, opened
from transports.robot import Site

pytestmark = pytest.mark.anyio
ASK = frame(TEXT, b'{"type":"ping","id":"p"}', masked=False)
STORM = 100_000  # short requests: 4 MB, of which the system keeps some before they are read
AT_ONCE = 16 * 1024 // len(ASK)


def masked(data: bytes) -> bytes:
    """Mask a short frame with zeros, which changes no byte of it."""
    return data[:1] + bytes((data[1] | 0x80,)) + bytes(4) + data[2:]


@pytest.fixture
def parsed(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Count the frames that came out of each read of any WebSocket."""
    counts = [0]
    usual = rcp_asgi.socket.Socket.on_ws_frame

    def on_ws_frame(self: Any, transport: Any, frame: Any) -> None:
        counts[-1] += 1
        if frame.last_in_buffer:
            counts.append(0)
        usual(self, transport, frame)

    monkeypatch.setattr(rcp_asgi.socket.Socket, "on_ws_frame", on_ws_frame)
    return counts


async def test_a_storm_of_short_requests_does_not_make_the_reads_grow(
    gateway: Site, parsed: list[int]
) -> None:
    async with opened(gateway) as raw:
        raw.send(masked(ASK) * STORM)
        for _ in range(STORM):
            await raw.frame()
    assert sum(parsed) >= STORM
    assert max(parsed) <= AT_ONCE


async def test_of_many_pings_that_come_together_the_latest_is_answered(gateway: Site) -> None:
    async with opened(gateway) as raw:
        raw.send(*(frame(PING, b"%d" % number) for number in range(1000)))
        pongs = [await pong(raw)]
        while pongs[-1] != b"999":
            pongs.append(await pong(raw))
        assert len(pongs) < 100


async def pong(raw: Raw) -> bytes:
    first, payload = await raw.frame()
    assert first == 0x80 | PONG
    return payload


async def test_frames_that_are_no_messages_use_up_a_turn_too(
    gateway: Site, monkeypatch: pytest.MonkeyPatch
) -> None:
    pauses = list[int]()
    usual = rcp_asgi.socket.Socket.pause_reading

    def pause_reading(self: Any) -> None:
        pauses.append(1)
        usual(self)

    monkeypatch.setattr(rcp_asgi.socket.Socket, "pause_reading", pause_reading)
    monkeypatch.setattr(socket_client, "_TURN", -1.0)
    async with opened(gateway) as raw:
        raw.send(frame(PING, b"a"), frame(PING, b"b"), frame(PING, b"c"))
        while await pong(raw) != b"c":
            pass
        assert pauses
        raw.ask(type="ping", id="alive")
        assert (await raw.reply())["id"] == "alive"


async def test_empty_fragments_without_end_take_no_room(gateway: Site) -> None:
    parts = set[int]()
    usual = rcp_asgi.socket.Socket._fragment  # noqa: SLF001 - a bound of memory

    def fragment(self: Any, *given: Any) -> None:
        usual(self, *given)
        parts.add(len(self._parts or ()))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(rcp_asgi.socket.Socket, "_fragment", fragment)
        async with opened(gateway) as raw:
            raw.send(frame(TEXT, b'{"type":"ping",', fin=False))
            raw.send(frame(0, b"", fin=False) * 1000, frame(0, b'"id":"p"}'))
            assert (await raw.reply())["id"] == "p"
    assert parts <= {0, 1}
