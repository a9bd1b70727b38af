"""Pictures: files pass, pixels become JPEG, a stream shows the newest and never piles up."""

from __future__ import annotations

import asyncio
import re
import sys
from collections.abc import AsyncIterator, Callable
from typing import Any

import httpx
import msgspec
import numpy as np
import pytest
import simplejpeg

from rcp_dashboard.picture import picture
from rcp_kernel.errors import AdapterUnavailable, DeviceRejected
from rcp_kernel.model import Pattern, Resource
from transports.robot import KEY, Site, until

pytestmark = pytest.mark.anyio
CAMERA = "/dashboard/api/camera"
BLOB = {"path": "/tenant/alpha/sensor/blob"}
EYE = {"path": "/tenant/alpha/sensor/eye"}
PNG = b"\x89PNG\r\n\x1a\nrest"


class Eye(msgspec.Struct):
    """Raw pixels, as ROS has them."""

    height: int
    width: int
    encoding: str
    step: int
    data: bytes


def jpeg(shade: int) -> bytes:
    pixels = np.full((16, 16, 3), shade, np.uint8)
    return simplejpeg.encode_jpeg(pixels, quality=90)


def eye(encoding: str, pixels: np.ndarray[Any, Any], pad: int = 0) -> Eye:
    height, width = pixels.shape[:2]
    rows = pixels.reshape(height, -1)
    padded = np.pad(rows, ((0, 0), (0, pad)))
    return Eye(height, width, encoding, padded.shape[1], padded.tobytes())


def declare_eye(gateway: Site) -> Callable[[Eye], None]:
    host = gateway.robot.host
    host.declare(Resource(name="sensor/eye", description="Raw pixels.", value=Eye, live=True))
    return lambda value: host.publish("sensor/eye", value)


@pytest.mark.parametrize(("data", "media"), [(jpeg(9), "image/jpeg"), (PNG, "image/png")])
async def test_a_file_passes_as_it_is(
    http: httpx.AsyncClient, gateway: Site, data: bytes, media: str
) -> None:
    gateway.robot.host.publish("sensor/blob", data)
    answer = await http.get(CAMERA, params=BLOB)
    assert answer.content == data
    assert answer.headers["content-type"] == media
    assert answer.headers["cache-control"] == "no-store"
    assert answer.headers["x-rcp-state"] == "fresh"
    assert 0 <= float(answer.headers["x-rcp-age"]) < 60


@pytest.mark.parametrize(
    ("encoding", "order", "depth"),
    [("rgb8", (0, 1, 2), 3), ("bgr8", (2, 1, 0), 3), ("bgra8", (2, 1, 0), 4), ("mono8", None, 1)],
)
async def test_pixels_become_a_jpeg_of_their_colours(
    http: httpx.AsyncClient, gateway: Site, encoding: str, order: tuple[int, ...] | None, depth: int
) -> None:
    colour = np.array([200, 120, 40, 255], np.uint8)
    channels = np.zeros(depth, np.uint8)
    for place, source in enumerate(order or (0,)):
        channels[place] = colour[source]
    declare_eye(gateway)(eye(encoding, np.tile(channels, (24, 32, 1)), pad=5))
    answer = await http.get(CAMERA, params=EYE | {"quality": "95"})
    assert answer.headers["content-type"] == "image/jpeg"
    seen = simplejpeg.decode_jpeg(answer.content, "RGB")
    assert seen.shape == (24, 32, 3)
    expected = colour[:3] if order else np.full(3, 200)
    assert np.abs(seen.astype(int) - expected).max() < 8


@pytest.mark.parametrize(
    ("value", "word"),
    [
        (b"no image", "not an image"),
        ({"data": "text"}, "not an image"),
        (7, "not an image"),
        ({"data": b"x" * 9, "encoding": "32FC1", "width": 3, "height": 3}, "'32FC1'"),
        ({"data": b"x" * 9, "encoding": "rgb8", "width": 3, "height": 3}, "9 bytes"),
        ({"data": b"x" * 9, "encoding": "mono8", "width": 3, "height": 3, "step": 2}, "rows of 2"),
        ({"data": b"x" * 9, "encoding": "mono8", "width": 0, "height": 3}, "0 pixels"),
    ],
)
def test_what_no_picture_is_made_of_is_refused(value: Any, word: str) -> None:
    with pytest.raises(DeviceRejected, match=word) as raised:
        picture(value, 75)
    assert raised.value.remedy


@pytest.mark.parametrize(
    ("encoding", "kind", "least"),
    [("16UC1", "<u2", 0), ("32FC1", "<f4", np.nan), ("32FC1", ">f4", np.inf)],
)
def test_depths_become_greys_with_the_near_ones_bright(
    encoding: str, kind: str, least: float
) -> None:
    row = np.array([least] * 8 + [500] * 8 + [4000] * 8).astype(kind)
    data = np.tile(row, (16, 1)).tobytes()
    value = {"width": 24, "height": 16, "encoding": encoding, "data": data}
    value |= {"is_bigendian": kind[0] == ">", "step": len(data) // 16}
    made = picture(value, 95)
    grey = simplejpeg.decode_jpeg(made.data, "GRAY")[8, [3, 11, 19], 0].astype(int)
    assert list(abs(grey - [0, 255, 40]) < 12) == [True] * 3
    empty = picture({**value, "data": bytes(len(data))}, 95)
    assert simplejpeg.decode_jpeg(empty.data, "GRAY").max() < 12


def test_without_the_library_the_remedy_names_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "simplejpeg", None)
    value = {"data": b"x" * 9, "encoding": "mono8", "width": 3, "height": 3}
    with pytest.raises(AdapterUnavailable) as raised:
        picture(value, 75)
    assert "rcp-gateway[dashboard]" in (raised.value.remedy or "")


def watching(gateway: Site, path: str = BLOB["path"]) -> int:
    """Count the subscriptions to a camera."""
    (entry,) = gateway.server.gateway.registry.match(Pattern(path, None))
    return len(entry.listeners)


async def parts(answer: httpx.Response) -> AsyncIterator[bytes]:
    """Take a multipart stream apart."""
    held = b""
    async for chunk in answer.aiter_raw():
        held += chunk
        while match := re.search(
            rb"--frame\r\n.*?content-length: (\d+)\r\n.*?\r\n\r\n", held, re.DOTALL
        ):
            length = int(match[1])
            if len(held) < match.end() + length:
                break
            yield held[match.end() : match.end() + length]
            held = held[match.end() + length :]


async def test_a_stream_shows_every_picture_to_who_keeps_up(
    http: httpx.AsyncClient, gateway: Site
) -> None:
    gateway.robot.host.publish("sensor/blob", jpeg(0))
    async with asyncio.timeout(60), http.stream("GET", f"{CAMERA}/stream", params=BLOB) as answer:
        assert answer.headers["content-type"] == "multipart/x-mixed-replace; boundary=frame"
        shade = 0
        async for data in parts(answer):
            assert data == jpeg(shade)
            shade += 1
            if shade == 20:
                break
            gateway.robot.host.publish("sensor/blob", jpeg(shade))


async def test_who_is_slow_gets_the_newest_and_no_backlog(
    http: httpx.AsyncClient, gateway: Site
) -> None:
    publish = declare_eye(gateway)
    noise = np.random.default_rng(1).integers(0, 255, (480, 640, 3), np.uint8)
    publish(eye("rgb8", noise))
    async with asyncio.timeout(60), http.stream("GET", f"{CAMERA}/stream", params=EYE) as answer:
        coming = parts(answer)
        await anext(coming)
        for _ in range(60):
            publish(eye("rgb8", noise))
        publish(eye("rgb8", np.zeros((480, 640, 3), np.uint8)))
        count = 0
        async for data in coming:
            count += 1
            if simplejpeg.decode_jpeg(data).max() < 10:
                break
        assert count < 10


async def test_a_client_that_leaves_lets_go_of_the_camera(
    http: httpx.AsyncClient, gateway: Site
) -> None:
    gateway.robot.host.publish("sensor/blob", jpeg(0))
    async with asyncio.timeout(60), http.stream("GET", f"{CAMERA}/stream", params=BLOB) as answer:
        await anext(parts(answer))
        assert watching(gateway) == 1
    await until(lambda: watching(gateway) == 0)


async def test_who_takes_nothing_does_not_keep_the_stream_from_others(
    gateway: Site, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rcp_dashboard.camera.STALLED", 0.5)
    publish = declare_eye(gateway)
    noise = np.random.default_rng(1).integers(0, 255, (480, 640, 3), np.uint8)
    publish(eye("rgb8", noise))
    url = httpx.URL(gateway.url)
    ask = f"GET {CAMERA}/stream?path=/tenant/alpha/sensor/eye&quality=100 HTTP/1.1\r\n"
    head = f"{ask}Host: {url.host}:{url.port}\r\nAuthorization: Bearer {KEY}\r\n\r\n"
    reader, writer = await asyncio.open_connection(url.host, url.port, limit=1024)
    try:
        writer.write(head.encode())
        await reader.readuntil(b"\r\n\r\n")  # and not a byte more
        await until(lambda: watching(gateway, EYE["path"]) == 1)

        def left() -> bool:
            publish(eye("rgb8", noise))
            return watching(gateway, EYE["path"]) == 0

        await until(left)
    finally:
        writer.transport.abort()


async def test_a_stream_ends_with_the_right_to_it(http: httpx.AsyncClient, gateway: Site) -> None:
    gateway.robot.host.publish("sensor/blob", jpeg(0))
    async with asyncio.timeout(60), http.stream("GET", f"{CAMERA}/stream", params=BLOB) as answer:
        coming = parts(answer)
        await anext(coming)
        kernel = gateway.server.gateway
        kernel.reconfigure(msgspec.structs.replace(kernel.settings.config, keys=()))
        assert [data async for data in coming] == []
    assert watching(gateway) == 0


async def test_a_stream_ends_where_the_resource_is_no_picture(
    http: httpx.AsyncClient, gateway: Site
) -> None:
    async with asyncio.timeout(60), http.stream("GET", f"{CAMERA}/stream", params=BLOB) as answer:
        assert [data async for data in parts(answer)] == []
    refused = await http.get(CAMERA, params=BLOB)
    assert refused.json()["error"]["code"] == "device_rejected"
