"""Messages that a client sends as pictures, with every filter of a PNG and with every mistake."""

from __future__ import annotations

import base64
import json
import random
import struct
import zlib
from collections.abc import AsyncGenerator, Callable, Generator
from typing import Any

import pytest

from plugins.rosbridge.rig import OPEN, ROVER, Page, page, site
from rcp_kernel.errors import RcpError
from rcp_rosbridge.png import to_png
from rcp_rosbridge.png_reader import read_png

Predict = Callable[[int, int, int], int]
TEXT = json.dumps({"op": "publish", "topic": "/x", "msg": {"data": "ü" * 300}}).encode()


def read(data: str) -> bytes:
    """Read a picture to its end."""

    def run() -> Generator[None, None, bytes]:
        return (yield from read_png(data))

    steps = run()
    while True:
        try:
            next(steps)
        except StopIteration as end:
            return end.value


def paeth(left: int, up: int, corner: int) -> int:
    guess = left + up - corner
    return min((left, up, corner), key=lambda one: abs(guess - one))


FILTERS: dict[int, Predict] = {
    0: lambda _left, _up, _corner: 0,
    1: lambda left, _up, _corner: left,
    2: lambda _left, up, _corner: up,
    3: lambda left, up, _corner: (left + up) // 2,
    4: paeth,
}


def picture(text: bytes, *, filter_: int = 0, colour: int = 2, width: int = 20, **head: int) -> str:
    """Write a text as a PNG."""
    pixel = {0: 1, 2: 3, 4: 2, 6: 4, 3: 1}[colour]
    row = width * pixel
    padded = text.ljust(-(-len(text) // row) * row, b"\n")
    packed, above = b"", bytes(row)
    for at in range(0, len(padded), row):
        line = padded[at : at + row]
        out = bytearray()
        for place, byte in enumerate(line):
            left, corner = (line[place - pixel], above[place - pixel]) if place >= pixel else (0, 0)
            out.append((byte - FILTERS[filter_](left, above[place], corner)) & 0xFF)
        packed += bytes([head.get("kind", filter_)]) + out
        above = line
    height = head.get("height", len(padded) // row)
    facts = struct.pack(
        ">IIBBBBB", width, height, head.get("depth", 8), colour, 0, 0, head.get("interlaced", 0)
    )
    chunks = ((b"IHDR", facts), (b"IDAT", zlib.compress(packed)), (b"IEND", b""))
    body = b"".join(
        struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))
        for name, data in chunks
    )
    return base64.b64encode(b"\x89PNG\r\n\x1a\n" + body).decode()


@pytest.mark.parametrize("filter_", FILTERS)
@pytest.mark.parametrize("colour", [0, 2])
def test_every_filter_is_undone(filter_: int, colour: int) -> None:
    assert read(picture(TEXT, filter_=filter_, colour=colour)) == TEXT


def test_what_the_gateway_writes_it_reads() -> None:
    assert read(json.loads(to_png(TEXT))["data"]) == TEXT


def test_alpha_is_no_text() -> None:
    with_alpha = b"".join(TEXT[at : at + 3].ljust(3) + b"\xff" for at in range(0, len(TEXT), 3))
    assert read(picture(with_alpha, colour=6)).startswith(TEXT[:290])


@pytest.mark.parametrize(
    ("data", "told"),
    [
        ("", "not a PNG"),
        ("%%%", "cannot be read"),
        (base64.b64encode(b"GIF89a").decode(), "not a PNG"),
        (picture(TEXT, colour=3), "8 bits per channel"),
        (picture(TEXT, depth=16), "8 bits per channel"),
        (picture(TEXT, interlaced=1), "8 bits per channel"),
        (picture(TEXT, height=0), "8 bits per channel"),
        (picture(TEXT, height=100), "ends too early"),
        (picture(TEXT, height=2**31), "too large"),
        (picture(b"a" * 100_000, width=25_000, colour=6), "too large"),
        ("A" * 3_000_000, "too large"),
        (picture(TEXT, kind=9), "unknown filter 9"),
        (picture(TEXT)[:120], "ends too early"),
    ],
)
def test_other_pictures_are_refused_with_the_reason(data: str, told: str) -> None:
    with pytest.raises(RcpError, match=told):
        read(data)


def test_a_picture_that_unpacks_to_gigabytes_is_not_unpacked() -> None:
    with pytest.raises(RcpError, match="too large"):
        read(picture(b"\n" * 2_000_000, width=2000))


@pytest.fixture
async def client() -> AsyncGenerator[Page]:
    async with site(OPEN, ROVER) as gateway, page(gateway) as made:
        yield made


async def test_a_call_in_a_picture_is_answered_in_its_order(client: Page) -> None:
    call: dict[str, Any] = {"op": "call_service", "id": "p", "service": "/rosapi/get_time"}
    noise = random.Random(1).randbytes(150_000)  # so that the message and that in it are long
    call["args"] = {"padding": base64.b64encode(noise).decode()}
    await client.send(op="png", data=picture(json.dumps(call).encode(), filter_=4))
    await client.send(op="call_service", id="next", service="/rosapi/get_time")
    answers = [(await client.op("service_response"))["id"] for _ in range(2)]
    assert answers == ["p", "next"]


async def test_a_picture_of_a_picture_is_refused(client: Page) -> None:
    inner = json.dumps({"op": "png", "data": "x"}).encode()
    await client.send(op="png", data=picture(inner))
    await client.status("picture of a picture")
    await client.send(op="png", data=picture(b"garbage" * 10))
    await client.status("not an operation")
    await client.values("/rosapi/get_time")
