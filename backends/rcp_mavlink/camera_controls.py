"""Zoom, focus and video of a camera, seen in what it reports."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Annotated, Any

from msgspec import Meta, Struct

from rcp_kernel.errors import DeviceTimeout, NotImplementedByRobot, PreconditionFailed, RcpError
from rcp_kernel.model import Resource
from rcp_kernel.spi import Progress
from rcp_mavlink.cameras import Cameras
from rcp_mavlink.commands import Command, Commands
from rcp_mavlink.frames import Frame
from rcp_mavlink.hub import Hub
from rcp_mavlink.vehicle import Vehicle

__all__ = ["CameraControls"]

_REQUEST = 512
_ZOOM, _FOCUS = 531, 532
_RANGE, _AUTO = 2.0, 4.0  # CAMERA_ZOOM_TYPE and SET_FOCUS_TYPE
_VIDEO_START, _VIDEO_STOP = 2500, 2501
_SETTINGS, _CAPTURE = "CAMERA_SETTINGS", "CAMERA_CAPTURE_STATUS"
_ATTEMPTS = 10
_CLOSE = 1.0  # percent

Component = Annotated[int, Meta(ge=1, le=255, extra_json_schema={"unit": "1"})]
Share = Annotated[float, Meta(ge=0, le=1, extra_json_schema={"unit": "1"})]


class Zoom(Struct, frozen=True, forbid_unknown_fields=True):
    """How far a camera zooms in."""

    level: Share
    """0 is the widest view, 1 the closest."""
    camera: Component | None = None
    """Component id; default: the one that takes pictures."""


class Focus(Struct, frozen=True, forbid_unknown_fields=True):
    """Where a camera focuses."""

    level: Share | None = None
    """0 is the nearest, 1 the farthest; default: the camera focuses by itself."""
    camera: Component | None = None
    """Component id; default: the one that takes pictures."""


class Video(Struct, frozen=True, forbid_unknown_fields=True):
    """Whether a camera records."""

    on: bool
    camera: Component | None = None
    """Component id; default: the one that takes pictures."""


class CameraControls:
    """The cameras of one vehicle."""

    def __init__(self, hub: Hub, vehicle: Vehicle, commands: Commands, cameras: Cameras) -> None:
        self._hub, self._vehicle = hub, vehicle
        self._commands, self._cameras = commands, cameras

    def verbs(self) -> dict[str, Callable[[Any, Progress], Awaitable[Any]]]:
        """Return the handler of each path."""
        return {
            "action/camera/photo": self._cameras.photo,
            "service/camera/zoom": self.zoom,
            "service/camera/focus": self.focus,
            "service/camera/video": self.video,
        }

    @staticmethod
    def resources() -> list[Resource]:
        """List what it serves."""
        return [
            Resource(name="service/camera/zoom", description="Zoom in or out; completes when the camera reports it.", input=Zoom, output=Zoom, examples=({"level": 0.5},), timeout=30),
            Resource(name="service/camera/focus", description="Focus; completes when the camera reports it, by itself when it accepts it.", input=Focus, output=Focus, examples=({"level": 1.0}, {}), timeout=30),
            Resource(name="service/camera/video", description="Start or end a video; completes when the camera reports that it records, or no longer does.", input=Video, output=Video, examples=({"on": True}, {"on": False}), timeout=30),
        ]  # fmt: skip

    # One camera

    async def zoom(self, given: Zoom, _: Progress) -> Zoom:
        """Zoom in or out."""
        camera, percent = await self._camera(given.camera), given.level * 100
        command = Command(_ZOOM, (_RANGE, percent, 0.0, 0.0), component=camera)
        await self._commands.send(command, "zoom")
        await self._shown(camera, _SETTINGS, lambda f: _near(f["zoomLevel"], percent), "zoom")
        return given

    async def focus(self, given: Focus, _: Progress) -> Focus:
        """Focus at a distance, or have the camera do it."""
        camera = await self._camera(given.camera)
        if given.level is None:
            command = Command(_FOCUS, (_AUTO, 0.0, 0.0, 0.0), component=camera)
            await self._commands.send(command, "focus")
            return given
        percent = given.level * 100
        command = Command(_FOCUS, (_RANGE, percent, 0.0, 0.0), component=camera)
        await self._commands.send(command, "focus")
        await self._shown(camera, _SETTINGS, lambda f: _near(f["focusLevel"], percent), "focus")
        return given

    async def video(self, given: Video, _: Progress) -> Video:
        """Start or end a video."""
        camera = await self._camera(given.camera)
        number = _VIDEO_START if given.on else _VIDEO_STOP
        await self._commands.send(Command(number, component=camera), "video")
        await self._shown(camera, _CAPTURE, lambda f: bool(f["video_status"]) == given.on, "video")
        return given

    async def _camera(self, component: int | None) -> int:
        """Return the component of a camera.

        :raises PreconditionFailed: there is none.
        """
        found = await self._cameras.find() if component is None else component
        if found is None:
            raise PreconditionFailed(
                "the vehicle has no camera with the camera protocol",
                remedy="Give its component id as `camera`, or command it by service/command.",
            )
        return found

    async def _shown(
        self, camera: int, message: str, holds: Callable[[dict[str, Any]], bool], what: str
    ) -> None:
        """Have the camera report, until it shows what it has accepted.

        :raises NotImplementedByRobot: it does not report that.
        :raises DeviceTimeout: it reports something else.
        """
        reports: list[dict[str, Any]] = []

        def take(frame: Frame) -> None:
            if frame.component == camera:
                reports.append(frame.fields())

        number = float(self._hub.dialect.by_name[message].id)
        request = Command(_REQUEST, (number, 0.0, 0.0, 0.0), component=camera)
        with self._vehicle.listening(message, take, anybody=True):
            for _ in range(_ATTEMPTS):
                before = len(reports)
                try:
                    await self._commands.send(request, f"{what}: request for {message}")
                except RcpError as error:
                    self._vehicle.check()
                    raise NotImplementedByRobot(
                        f"{what}: accepted, but the camera does not report it",
                        remedy="Look at its picture, or command it by service/command.",
                    ) from error
                await self._vehicle.until(
                    lambda before=before: len(reports) > before, self._hub.config.timeout
                )
                if reports and holds(reports[-1]):
                    return
        raise DeviceTimeout(f"{what}: accepted, but {message} does not show it")


def _near(value: float, wanted: float) -> bool:
    return abs(value - wanted) <= _CLOSE
