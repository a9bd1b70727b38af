"""Cameras are listed with their storage and streams, and each can be told apart from the others."""

from __future__ import annotations

from typing import Any

import pytest

from backends.mavlink.puppet import Puppet, station
from rcp_gateway.testing import eventually

FIRST, SECOND = 100, 101
GIB = 1024.0
NAME = list(b"Nightsight".ljust(32, b"\0"))
VENDOR = list(b"Acme".ljust(32, b"\0"))


class TwoCameras(Puppet):
    """Two cameras on components of their own, of which the second streams, in two pieces."""

    def __init__(self) -> None:
        super().__init__()
        self.lost = 0  # of its streams
        self.pictures: list[int] = []
        self.also.append(self._beat)

    def say_as(self, component: int, name: str, *fields: Any) -> None:
        self.out.srcComponent = component
        self.send(name, *fields)
        self.out.srcComponent = 1

    def _beat(self) -> None:
        for camera in (FIRST, SECOND):
            self.say_as(camera, "HEARTBEAT", 30, 8, 0, 0, 4, 3)

    def take(self, message: Any) -> None:
        target = getattr(message, "target_component", 1)
        if message.get_type() == "COMMAND_LONG" and target in (FIRST, SECOND):
            result = self._told(target, message)
            self.say_as(target, "COMMAND_ACK", message.command, result, 0, 0, 255, 190)
            return
        super().take(message)

    def _told(self, camera: int, message: Any) -> int:
        if message.command == 2000:
            self.pictures.append(camera)
            place = (470000000, 80000000, 400000, 12500)
            for one in (FIRST, SECOND):  # the other one has been told by somebody else
                self.say_as(
                    one, "CAMERA_IMAGE_CAPTURED", 0, 0, 0, *place, [1.0, 0, 0, 0], one, 1, b""
                )  # fmt: skip
            return 0
        if message.command != 512:
            return 3
        return self._asked(camera, int(message.param1))

    def _asked(self, camera: int, number: int) -> int:
        if number == 259:
            flags = 2 if camera == FIRST else 1 | 2 | 64 | 256
            self.say_as(
                camera, "CAMERA_INFORMATION", 0, VENDOR, NAME, 0, 0, 0, 0, 640, 480, 0, flags, 0, b""
            )  # fmt: skip
        elif number == 269 and camera == SECOND:
            for stream in range(1, 3 - self.lost):
                address = f"rtsp://10.0.0.2/{stream}".encode()
                self.say_as(
                    camera, "VIDEO_STREAM_INFORMATION", stream, 2, 0, 2 * (stream - 1) | 1, 30.0,
                    1280, 720, 4_000_000, 0, 60, f"stream {stream}".encode(), address,
                )  # fmt: skip
        elif number == 261 and camera == SECOND:
            for store, status in ((1, 2), (2, 0)):
                self.say_as(
                    camera, "STORAGE_INFORMATION", 0, store, 2, status, 32 * GIB, GIB, 31 * GIB, 0, 0
                )  # fmt: skip
        else:
            return 3
        return 0


async def heard(found: Any) -> None:
    async def both() -> bool:
        return {FIRST, SECOND} <= found.robot.vehicle.components.keys()

    await eventually(both, "both cameras are heard")


async def test_cameras_are_listed_with_what_they_have() -> None:
    async with station(TwoCameras()) as found:
        await heard(found)
        reply = await found.do("service/camera/list")
        first, second = reply["body"]
        assert (first["camera"], first["vendor"], first["model"]) == (FIRST, "Acme", "Nightsight")
        assert (first["takes_pictures"], first["records_video"]) == (True, False)
        assert first["streams"] == first["stores"] == []
        assert (second["camera"], second["zooms"], second["focuses"]) == (SECOND, True, False)
        assert [one["address"] for one in second["streams"]] == [
            "rtsp://10.0.0.2/1",
            "rtsp://10.0.0.2/2",
        ]
        assert [one["thermal"] for one in second["streams"]] == [False, True]
        assert [one["protocol"] for one in second["streams"]] == ["rtsp", "rtsp"]
        card, empty = second["stores"]
        assert (card["state"], card["total"], card["available"]) == ("ready", 2**35, 31 * 2**30)
        assert (empty["state"], empty["total"]) == ("empty", None)


async def test_what_does_not_come_is_left_out() -> None:
    cameras = TwoCameras()
    cameras.lost = 1
    async with station(cameras) as found:
        await heard(found)
        _, second = (await found.do("service/camera/list"))["body"]
        assert [one["number"] for one in second["streams"]] == [1]


@pytest.mark.parametrize("camera", [FIRST, SECOND])
async def test_a_picture_is_that_of_the_camera_that_was_asked(camera: int) -> None:
    cameras = TwoCameras()
    async with station(cameras) as found:
        await heard(found)
        reply = await found.do("action/camera/photo", {"camera": camera})
        assert reply["status"] == "completed", reply
        assert reply["body"]["number"] == camera
        assert cameras.pictures == [camera]
