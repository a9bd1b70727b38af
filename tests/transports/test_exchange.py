"""The head of a response: one field for each that an application sends, and none besides."""

from __future__ import annotations

import asyncio
import logging
from typing import Any, cast

import pytest
from uvicorn.protocols.http.flow_control import FlowControl

from rcp_asgi.exchange import Exchange

pytestmark = pytest.mark.anyio


class Wire(asyncio.Transport):
    """Keeps what is written."""

    def __init__(self) -> None:
        super().__init__()
        self.data = b""
        self.closed = False

    def write(self, data: Any) -> None:
        self.data += data

    def close(self) -> None:
        self.closed = True


def exchange(wire: Wire, method: str = "GET", *, keep_alive: bool = True) -> Exchange:
    silent = logging.getLogger("test")
    return Exchange(
        scope=cast("Any", {"type": "http", "method": method}),
        transport=wire,
        flow=FlowControl(wire),
        logger=silent,
        access_logger=silent,
        access_log=False,
        default_headers=[(b"date", b"today")],
        message_event=asyncio.Event(),
        expect_100_continue=False,
        keep_alive=keep_alive,
        on_response=lambda: None,
    )


async def answer(one: Exchange, headers: list[tuple[bytes, bytes]], body: bytes = b"hi") -> None:
    await one.send({"type": "http.response.start", "status": 200, "headers": headers})
    await one.send({"type": "http.response.body", "body": body})


async def test_a_known_length_is_told_and_kept_to() -> None:
    wire = Wire()
    await answer(exchange(wire), [(b"Content-Length", b"2"), (b"ETag", b'"1"')])
    lines = b'HTTP/1.1 200 OK\r\ndate: today\r\ncontent-length: 2\r\netag: "1"\r\n\r\nhi'
    assert wire.data == lines
    assert not wire.closed
    with pytest.raises(RuntimeError):
        await answer(exchange(Wire()), [(b"content-length", b"1")])


async def test_without_a_length_the_body_goes_in_chunks() -> None:
    wire = Wire()
    await answer(exchange(wire), [])
    assert wire.data.endswith(b"transfer-encoding: chunked\r\n\r\n2\r\nhi\r\n0\r\n\r\n")


async def test_the_answer_to_head_has_no_body() -> None:
    wire = Wire()
    await answer(exchange(wire, "HEAD"), [(b"content-length", b"2")])
    assert wire.data.endswith(b"content-length: 2\r\n\r\n")


@pytest.mark.parametrize("named", [b"close", b"Close", b"keep-alive, close"])
async def test_a_connection_that_is_to_close_says_so_once(named: bytes) -> None:
    wire = Wire()
    await answer(exchange(wire), [(b"content-length", b"2"), (b"connection", named)])
    assert wire.closed
    assert wire.data.count(b"connection:") == 1
    wire = Wire()
    await answer(exchange(wire, keep_alive=False), [(b"content-length", b"2")])
    assert wire.closed
    assert b"connection: close\r\n" in wire.data


@pytest.mark.parametrize(
    ("name", "value"),
    [(b"x", b"a\r\nset-cookie: b"), (b"x\r\ny", b"a"), (b"x: y", b"a"), (b"x", b"a\x00b")],
)
async def test_what_would_be_another_field_is_refused(name: bytes, value: bytes) -> None:
    for _ in range(2):  # also when it comes again
        wire = Wire()
        with pytest.raises(ValueError, match="header"):
            await answer(exchange(wire), [(name, value)])
        assert wire.data == b""
