"""Gimbals and cameras by the protocols of today: done when they say so themselves."""

from __future__ import annotations

import base64
import math
from functools import partial
from io import BytesIO
from typing import Any

import pytest
from PIL import Image

from backends.mavlink.fileserver import FileServer
from backends.mavlink.puppet import Puppet, station
from rcp_gateway.testing import eventually

CAMERA, GIMBAL = 100, 154


class Equipped(Puppet):
    """With a gimbal manager and a camera, on the autopilot's component or on ones of their own."""

    def __init__(self, *, apart: bool) -> None:
        super().__init__()
        self.apart = apart
        self.angles = (0.0, 0.0)
        self.earth = False
        self.stuck = False
        self.capture_result = 1
        self.configured: list[Any] = []
        self.results = {1001: self._configure, 1000: self._turn, 2000: self._capture}
        self.photos = 0
        self.url = b""
        self.also.append(self._report)

    def say_as(self, component: int, name: str, *fields: Any) -> None:
        self.out.srcComponent = component if self.apart else 1
        self.send(name, *fields)
        self.out.srcComponent = 1

    def take(self, message: Any) -> None:
        target = getattr(message, "target_component", 1)
        if message.get_type() == "COMMAND_LONG" and self.apart and target in (CAMERA, GIMBAL):
            self.got.append(message)
            if message.command == 512:
                self.request(int(message.param1))
                result = 0
            else:
                result = self.command(message)
            self.say_as(target, "COMMAND_ACK", message.command, result, 0, 0, 255, 190)
            return
        super().take(message)

    def request(self, number: int) -> int:
        if number == 280:
            self.say_as(GIMBAL, "GIMBAL_MANAGER_INFORMATION", 0, 0, 7, 0, 0, -1.5, 0.5, -3.2, 3.2)
            return 0
        if number == 259:
            none = [0] * 32
            self.say_as(
                CAMERA, "CAMERA_INFORMATION", 0, none, none, 0, 0, 0, 0, 0, 0, 0, 2, 0, b""
            )  # fmt: skip
            return 0
        return super().request(number)

    def _configure(self, command: Any) -> int:
        self.configured.append(command)
        return 0

    def _turn(self, command: Any) -> int:
        assert command.param7 == 7
        if not self.stuck:
            self.angles = (math.radians(command.param1), math.radians(command.param2))
        return 0

    def _capture(self, command: Any) -> int:
        self.photos += 1
        place = (470000000, 80000000, 400000, 12500)
        self.say_as(
            CAMERA, "CAMERA_IMAGE_CAPTURED", 0, 0, 0, *place, [1.0, 0, 0, 0], self.photos,
            self.capture_result, self.url,
        )  # fmt: skip
        return 0

    def _report(self) -> None:
        pitch, yaw = self.angles
        flags = 32
        if self.earth:  # it looks at the same place as seen from the earth, the vehicle to east
            self.send("ATTITUDE", self.clock, 0, 0, math.pi / 2, 0, 0, 0)
            yaw, flags = yaw + math.pi / 2, 64
        cp, sp, cy, sy = (f(a / 2) for a in (pitch, yaw) for f in (math.cos, math.sin))
        q = [cp * cy, -sp * sy, sp * cy, cp * sy]
        self.say_as(
            GIMBAL, "GIMBAL_DEVICE_ATTITUDE_STATUS", 0, 0, self.clock, flags, q, 0, 0, 0, 0
        )  # fmt: skip
        if self.apart:
            self.say_as(CAMERA, "HEARTBEAT", 30, 8, 0, 0, 4, 3)
            self.say_as(GIMBAL, "HEARTBEAT", 26, 8, 0, 0, 4, 3)


@pytest.mark.parametrize("apart", [False, True])
@pytest.mark.parametrize("earth", [False, True])
async def test_a_gimbal_is_turned_by_its_manager(*, apart: bool, earth: bool) -> None:
    puppet = Equipped(apart=apart)
    puppet.earth = earth
    async with station(puppet) as found:
        reply = await found.do("action/gimbal", {"pitch": -0.5, "yaw": 0.75})
        assert reply["status"] == "completed", reply
        assert reply["body"]["pitch"] == pytest.approx(-0.5, abs=0.01)
        assert reply["body"]["yaw"] == pytest.approx(0.75, abs=0.01)
        assert puppet.configured[0].param1 == 255
        beyond = await found.do("action/gimbal", {"pitch": 1.2})
        assert beyond["error"]["code"] == "out_of_range"
        assert not puppet.commands(205)


async def test_a_gimbal_that_does_not_turn_is_told() -> None:
    puppet = Equipped(apart=False)
    puppet.stuck = True
    async with station(puppet) as found:
        reply = await found.do("action/gimbal", {"pitch": -0.5})
        assert reply["error"]["code"] == "device_timeout"
        assert "it points to 0.00, 0.00 rad" in reply["message"].replace("-0.00", "0.00")


@pytest.mark.parametrize("apart", [False, True])
async def test_a_photo_is_taken_when_the_camera_says_so(*, apart: bool) -> None:
    puppet = Equipped(apart=apart)
    async with station(puppet) as found:
        if apart:
            parts = found.robot.vehicle.components
            await eventually(lambda: _is(CAMERA in parts), "the camera is heard")
        for number in (1, 2):
            reply = await found.do("action/camera/photo")
            assert reply["status"] == "completed", reply
            assert reply["body"] == {
                "number": number, "latitude": 47.0, "longitude": 8.0, "altitude": 12.5,
                "url": "", "image": None, "note": "",
            }  # fmt: skip
        orders = puppet.commands(2000)
        assert [order.param4 for order in orders] == [1, 2], "none is taken twice"
        assert {order.target_component for order in orders} == {CAMERA if apart else 1}
        puppet.capture_result = 0
        failed = await found.do("action/camera/photo")
        assert failed["error"]["code"] == "device_rejected"


def _picture() -> bytes:
    made = BytesIO()
    Image.new("RGB", (64, 48), (200, 30, 30)).save(made, "JPEG")
    return made.getvalue()


@pytest.mark.parametrize(
    ("apart", "url"),
    [(False, "mftp:///a.jpg"), (True, "mftp:/a.jpg"), (True, "mftp://[;comp=100]/a.jpg")],
)
async def test_the_picture_comes_with_the_photo(*, apart: bool, url: str) -> None:
    puppet = Equipped(apart=apart)
    puppet.url = url.encode()
    server = FileServer(partial(puppet.say_as, CAMERA), {"/a.jpg": _picture()})
    puppet.on["FILE_TRANSFER_PROTOCOL"] = server
    async with station(puppet) as found:
        if apart:
            parts = found.robot.vehicle.components
            await eventually(lambda: _is(CAMERA in parts), "the camera is heard")
        image = (await found.do("action/camera/photo"))["body"]["image"]
        assert (image["width"], image["height"], image["format"]) == (64, 48, "jpeg")
        assert base64.b64decode(image["data"]) == _picture()
        targets = {
            m.target_component for m in puppet.got if m.get_type() == "FILE_TRANSFER_PROTOCOL"
        }
        assert targets == {CAMERA if apart else 1}


@pytest.mark.parametrize(
    ("url", "why"),
    [
        ("http://10.0.0.1/1.jpg", "where the gateway does not read"),
        ("mftp:///missing.jpg", "no such file"),
        ("mftp:///large.jpg", "it has 300000 bytes"),
        ("mftp:///text.txt", "neither PNG nor JPEG"),
        ("mftp:///cut.jpg", "neither PNG nor JPEG"),
        ("mftp://[;comp=77]/a.jpg", "not transferred"),
        ("mftp://[;comp=999]/a.jpg", "there is no component 999"),
        ("mftp://[;comp=0]/a.jpg", "there is no component 0"),
    ],
)
async def test_a_photo_is_taken_although_its_picture_does_not_come(url: str, why: str) -> None:
    puppet = Equipped(apart=False)
    puppet.url = url.encode()
    server = FileServer(
        puppet.send,
        {"/large.jpg": bytes(300_000), "/text.txt": b"hello", "/cut.jpg": _picture()[:30]},
    )
    puppet.on["FILE_TRANSFER_PROTOCOL"] = lambda m: server(m) if m.target_component == 1 else None
    async with station(puppet) as found:
        reply = await found.do("action/camera/photo")
        assert reply["status"] == "completed", reply
        assert reply["body"]["image"] is None
        assert why in reply["body"]["note"]
        assert reply["body"]["url"] == url


async def test_whatever_goes_wrong_with_the_picture_the_photo_is_taken(monkeypatch: Any) -> None:
    async def odd(*_: Any) -> bytes:
        raise ValueError("odd")

    monkeypatch.setattr("rcp_mavlink.files.Files.fetch", odd)
    puppet = Equipped(apart=False)
    puppet.url = b"mftp:///a.jpg"
    async with station(puppet) as found:
        reply = await found.do("action/camera/photo")
        assert reply["status"] == "completed", reply
        assert reply["body"]["note"] == "not transferred: ValueError('odd')"


async def _is(truth: bool) -> bool:  # noqa: FBT001 - for `eventually`, which awaits
    return truth
