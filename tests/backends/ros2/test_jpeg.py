"""Cameras as JPEG: every encoding of colours, no other; only for those who ask, and not too often."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
import rclpy
import simplejpeg
from rclpy.context import Context
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import CompressedImage, Image

from backends.ros2.robot import fresh_domain, robot_of
from rcp_kernel.errors import DeviceRejected
from rcp_ros2.cdr import Codec
from rcp_ros2.jpeg import SUPPORTED, compress, wrapped

pytestmark = pytest.mark.anyio

WIDTH, HEIGHT = 32, 16
RED, BLUE = (220, 30, 40), (20, 60, 200)
MAP: dict[str, Any] = {"/sensor/camera": {"topic": "/camera", "type": "sensor_msgs/msg/Image"}}


def luma(colour: tuple[int, int, int]) -> int:
    return round(0.299 * colour[0] + 0.587 * colour[1] + 0.114 * colour[2])


def chroma(colour: tuple[int, int, int]) -> tuple[int, int]:
    y = luma(colour)
    return round(128 + 0.564 * (colour[2] - y)), round(128 + 0.713 * (colour[0] - y))


def row_of(encoding: str, line: int) -> bytes:
    """Write one line, red in its left half and blue in its right one."""
    out = bytearray()
    for x in range(WIDTH):
        r, g, b = colour = RED if x < WIDTH // 2 else BLUE
        if encoding.startswith("bayer"):
            pattern = encoding[6:10]
            values = ({"r": r, "g": g, "b": b}[pattern[(line % 2) * 2 + x % 2]],)
        elif encoding in ("uyvy", "yuv422"):
            values = (chroma(colour)[x % 2], luma(colour))
        elif encoding in ("yuyv", "yuv422_yuy2"):
            values = (luma(colour), chroma(colour)[x % 2])
        else:
            values = {
                "rgb": (r, g, b),
                "bgr": (b, g, r),
                "rgba": (r, g, b, 255),
                "bgra": (b, g, r, 255),
                "8UC3": (b, g, r),
                "8UC4": (b, g, r, 255),
                "8UC1": (luma(colour),),
                "mono": (luma(colour),),
            }[encoding if "UC" in encoding else encoding.rstrip("0123456789")]
        for value in values:
            out += bytes((7, value)) if encoding.endswith("16") else bytes((value,))
    return bytes(out)


def image_of(encoding: str, *, padding: int = 0) -> Image:
    """Make an image, 16-bit ones little-endian, with some bytes behind each line."""
    rows = [row_of(encoding, line) + bytes(padding) for line in range(HEIGHT)]
    return Image(
        encoding=encoding, width=WIDTH, height=HEIGHT, step=len(rows[0]), data=b"".join(rows)
    )


@pytest.mark.parametrize("padding", [0, 5])
@pytest.mark.parametrize("encoding", SUPPORTED)
def test_every_encoding_keeps_its_colours_in_their_places(encoding: str, padding: int) -> None:
    grey = encoding.startswith("mono") or encoding == "8UC1"
    found = simplejpeg.decode_jpeg(compress(image_of(encoding, padding=padding), 95))
    assert found.shape == (HEIGHT, WIDTH, 3)
    for place, colour in ((slice(2, 12), RED), (slice(20, 30), BLUE)):
        wanted = (luma(colour),) * 3 if grey else colour
        mean = found[2:-2, place].reshape(-1, 3).mean(axis=0)
        assert np.abs(mean - wanted).max() < 6, mean


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"encoding": "32FC1"}, "32FC1"),
        ({"encoding": "16UC1"}, "16UC1"),
        ({"encoding": ""}, "''"),
        ({"step": 10}, "rows of 10"),
        ({"data": b"123"}, "3 bytes"),
        ({"width": 0}, "0 x 16"),
        ({"height": 70_000}, "70000"),
        ({"encoding": "bayer_rggb8", "width": 1}, "Bayer"),
        ({"encoding": "yuyv", "width": 1}, "two columns"),
    ],
)
def test_what_has_no_colours_or_contradicts_itself_is_refused(
    changes: dict[str, Any], words: str
) -> None:
    image = image_of("rgb8")
    for name, value in changes.items():
        setattr(image, name, value)
    with pytest.raises(DeviceRejected, match=words):
        compress(image, 80)


@pytest.mark.parametrize("frame", ["", "a", "cam", "camera", "camera_optical_frame"])
def test_the_message_around_it_is_one_that_ros_reads(frame: str) -> None:
    image = image_of("rgb8")
    image.header.frame_id = frame
    image.header.stamp.sec = 12
    made = wrapped(serialize_message(image), b"\xff\xd8 jpeg")
    message = deserialize_message(made, CompressedImage)
    assert message.header == image.header
    assert (message.format, bytes(message.data)) == ("jpeg", b"\xff\xd8 jpeg")
    assert Codec(CompressedImage).decode(made).data == b"\xff\xd8 jpeg"


@contextmanager
def camera(domain: int, image: Image) -> Iterator[None]:
    """Publish an image a hundred times a second, from a node of its own."""
    context, ended = Context(), threading.Event()
    rclpy.init(context=context, domain_id=domain)
    node = rclpy.create_node("camera", context=context)
    publisher = node.create_publisher(Image, "/camera", 5)
    data = serialize_message(image)

    def publish() -> None:
        while not ended.wait(0.01):
            publisher.publish(data)

    thread = threading.Thread(target=publish)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()
        node.destroy_node()
        context.try_shutdown()


async def test_a_camera_is_a_jpeg_for_who_asks_and_no_more_often_than_allowed() -> None:
    domain = fresh_domain()
    async with robot_of(domain, map=MAP, jpeg={"rate": 4.0}) as robot:
        await robot.until(lambda: "sensor/camera/jpeg" in robot.resources)
        subscriptions = robot.backend.catalog.shared.subscriptions
        with camera(domain, image_of("rgb8")):
            assert "/camera" not in subscriptions.by_topic
            async with robot.backend.watch("sensor/camera/jpeg", None):
                await robot.first("sensor/camera/jpeg")
                since, begun = time.monotonic(), len(robot.samples)
                await robot.until(lambda: len(robot.samples) >= begun + 7)
                # Six periods of 0.25 s between seven, less what a busy machine is late with the first;
                # without a limit, seven frames take 0.07 s.
                assert time.monotonic() - since > 0.7
            first = robot.of("sensor/camera/jpeg")[0]
            assert first.format == "jpeg"
            assert simplejpeg.decode_jpeg(first.data).shape == (HEIGHT, WIDTH, 3)
            native = robot.samples[0][1].data
            assert bytes(deserialize_message(native, CompressedImage).data) == first.data
            again = await robot.read("sensor/camera/jpeg")
            assert again.data == first.data


async def test_a_depth_image_is_refused_in_words() -> None:
    domain = fresh_domain()
    async with robot_of(domain, map=MAP) as robot:
        await robot.until(lambda: "sensor/camera/jpeg" in robot.resources)
        depth = Image(encoding="32FC1", width=2, height=1, step=8, data=bytes(8))
        with camera(domain, depth):
            with pytest.raises(DeviceRejected, match="32FC1"):
                await robot.read("sensor/camera/jpeg")
            async with robot.backend.watch("sensor/camera/jpeg", None):
                await robot.until(lambda: any("32FC1" in (r or "") for r in robot.reports))
            await robot.until(lambda: robot.reports[-1] is None)
        assert robot.samples == []
