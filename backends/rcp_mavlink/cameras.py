"""The camera: by the camera protocol (v2) if supported, otherwise by the legacy trigger."""

from __future__ import annotations

import asyncio
import itertools
from typing import Any

from msgspec.structs import replace

from rcp_kernel.errors import DeviceRejected, DeviceTimeout, RcpError
from rcp_kernel.spi import Progress
from rcp_mavlink import messages as m
from rcp_mavlink.commands import Command, Commands
from rcp_mavlink.frames import Frame
from rcp_mavlink.hub import Hub
from rcp_mavlink.photofiles import PhotoFiles
from rcp_mavlink.vehicle import Vehicle

__all__ = ["Cameras"]

_TAKING = 10.0  # s
_REQUEST, _START_CAPTURE, _TRIGGER = 512, 2000, 203
_INFORMATION, _CAPTURED = "CAMERA_INFORMATION", "CAMERA_IMAGE_CAPTURED"
_FEEDBACK = "CAMERA_FEEDBACK"
_CAN_CAPTURE = 2
_CAMERA = 30  # MAV_TYPE


class Cameras:
    """The camera of one vehicle."""

    def __init__(
        self, hub: Hub, vehicle: Vehicle, commands: Commands, pictures: PhotoFiles
    ) -> None:
        self._hub, self._vehicle, self._commands = hub, vehicle, commands
        self._pictures = pictures
        self._camera: int | None = None
        self._sequence = itertools.count(1)

    async def photo(self, given: m.ByCamera | None, progress: Progress) -> m.Photo:
        """Take a picture; completes when the camera confirms it."""
        wanted = None if given is None else given.camera
        camera = await self.find() if wanted is None else wanted
        if camera is None:
            return await self._taken(Command(_TRIGGER, x=1.0), None)
        sequence = float(next(self._sequence))
        return await self._taken(
            Command(_START_CAPTURE, (0.0, 0.0, 1.0, sequence), component=camera), wanted
        )

    async def find(self) -> int | None:
        """Return the component id of a camera that takes pictures; None if there is none."""
        if self._camera is None:
            self._camera = await self._search()
        return self._camera

    async def _search(self) -> int | None:
        """Return the component id of a camera that takes pictures; None if there is none."""
        dialect = self._hub.dialect.by_name
        if _INFORMATION not in dialect or _CAPTURED not in dialect:
            return None
        parts = self._vehicle.components.items()
        for component in [*(n for n, type_ in parts if type_ == _CAMERA), self._vehicle.component]:
            if await self._takes_pictures(component):
                return component
        return None

    async def _takes_pictures(self, component: int) -> bool:
        found: list[Frame] = []

        def take(frame: Frame) -> None:
            if frame.component == component:
                found.append(frame)

        number = float(self._hub.dialect.by_name[_INFORMATION].id)
        request = Command(_REQUEST, (number, 0.0, 0.0, 0.0), component=component)
        with self._vehicle.listening(_INFORMATION, take, anybody=True):
            try:
                await self._commands.send(request, "camera request")
            except RcpError:
                self._vehicle.check()
                return False
            await self._vehicle.until(lambda: bool(found), self._hub.config.timeout)
        return bool(found) and bool(found[0].fields()["flags"] & _CAN_CAPTURE)

    async def _taken(self, command: Command, camera: int | None) -> m.Photo:
        """Send a command and return the picture that the camera confirms, or any if None is given."""
        reply: asyncio.Future[Frame] = asyncio.get_running_loop().create_future()

        def take(frame: Frame) -> None:
            if not reply.done() and camera in (None, frame.component):
                reply.set_result(frame)

        vehicle = self._vehicle
        with (
            vehicle.listening(_CAPTURED, take, anybody=True),
            vehicle.listening(_FEEDBACK, take, anybody=True),
        ):
            await self._commands.send(command, "photo")
            if not await vehicle.until(reply.done, _TAKING):
                raise DeviceTimeout("photo: accepted, but the camera does not confirm it")
        frame = reply.result()
        photo = _photo(frame.fields(), v2=frame.definition.name == _CAPTURED)
        image, note = await self._pictures.fetch(photo.url, frame.component)
        return replace(photo, image=image, note=note)


def _photo(f: dict[str, Any], *, v2: bool) -> m.Photo:
    if not v2:
        return m.Photo(f["img_idx"], f["lat"] / 1e7, f["lng"] / 1e7, f["alt_rel"])
    if f["capture_result"] != 1:
        raise DeviceRejected("photo: the camera could not take it")
    url = f["file_url"].split(b"\0", 1)[0].decode("utf-8", "replace")
    place = (f["lat"] / 1e7, f["lon"] / 1e7, f["relative_alt"] / 1e3)
    return m.Photo(f["image_index"], *place, url)
