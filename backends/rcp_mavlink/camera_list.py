"""The cameras of a vehicle, with their storage and the addresses of their video streams."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Annotated, Any, Literal

from msgspec import Meta, Struct

from rcp_kernel.errors import RcpError
from rcp_kernel.model import READS, Resource
from rcp_kernel.spi import Progress
from rcp_mavlink.commands import Command, Commands
from rcp_mavlink.frames import Frame, text_of
from rcp_mavlink.hub import Hub
from rcp_mavlink.vehicle import Vehicle

__all__ = ["CameraList"]

_REQUEST = 512
_INFORMATION, _STORAGE = "CAMERA_INFORMATION", "STORAGE_INFORMATION"
_STREAM = "VIDEO_STREAM_INFORMATION"
_TYPE = 30  # MAV_TYPE_CAMERA
_VIDEO, _PICTURES, _ZOOMS, _FOCUSES, _STREAMS = 1, 2, 64, 128, 256
"""CAMERA_CAP_FLAGS."""
_RUNS, _THERMAL = 1, 2
_MOST = 16  # cameras, and stores and streams of each
_MEBIBYTE = 2**20
_PROTOCOLS = {0: "rtsp", 1: "rtp", 2: "tcp", 3: "mpeg_ts", 4: "whep"}
_STATES = {0: "empty", 1: "unformatted", 2: "ready", 3: "unknown"}

Number = Annotated[int, Meta(ge=0, extra_json_schema={"unit": "1"})]
Bytes = Annotated[int, Meta(ge=0, extra_json_schema={"unit": "By"})]
Pixels = Annotated[int, Meta(ge=0, extra_json_schema={"unit": "1"})]


class VideoStream(Struct, frozen=True):
    """A video stream, which a client opens by itself."""

    number: Number
    name: str
    address: str
    """A URI, or for `rtp` the port to which the camera sends."""
    protocol: Literal["rtsp", "rtp", "tcp", "mpeg_ts", "whep", "unknown"]
    running: bool
    thermal: bool
    width: Pixels
    height: Pixels
    rate: Annotated[float, Meta(ge=0, extra_json_schema={"unit": "Hz"})]
    bit_rate: Annotated[int, Meta(ge=0, extra_json_schema={"unit": "bit/s"})]


class Store(Struct, frozen=True):
    """A memory card, or memory of the camera's own."""

    number: Number
    state: Literal["empty", "unformatted", "ready", "unknown"]
    total: Bytes | None
    """None in the states in which the camera does not know it; the other two likewise."""
    used: Bytes | None
    available: Bytes | None


class Camera(Struct, frozen=True):
    """One camera, and what it can do."""

    camera: Number
    """Its component id, by which the other commands name it."""
    vendor: str
    model: str
    takes_pictures: bool
    records_video: bool
    zooms: bool
    focuses: bool
    width: Pixels
    height: Pixels
    streams: list[VideoStream]
    stores: list[Store]


class CameraList:
    """The cameras of one vehicle that speak the camera protocol."""

    def __init__(self, hub: Hub, vehicle: Vehicle, commands: Commands) -> None:
        self._hub, self._vehicle, self._commands = hub, vehicle, commands

    def verbs(self) -> dict[str, Callable[[Any, Progress], Awaitable[Any]]]:
        """Return the handler of each path."""
        return {"service/camera/list": self.list}

    @staticmethod
    def resources() -> list[Resource]:
        """List what it serves."""
        return [
            Resource(name="service/camera/list", meta=READS, description="List the cameras with the camera protocol: what they can do, their storage, and the addresses of their video streams.", output=list[Camera], timeout=60),
        ]  # fmt: skip

    async def list(self, _: None, __: Progress) -> list[Camera]:
        """Ask every component that may be a camera; those that do not answer are left out."""
        parts = self._vehicle.components.items()
        candidates = [self._vehicle.component, *(n for n, type_ in parts if type_ == _TYPE)]
        found = [await self._camera(component) for component in dict.fromkeys(candidates[:_MOST])]
        return [camera for camera in found if camera is not None]

    async def _camera(self, component: int) -> Camera | None:
        told = await self._told(component, _INFORMATION, None)
        if not told:
            return None
        f = told[0]
        flags = f["flags"]
        streams = await self._told(component, _STREAM, "count") if flags & _STREAMS else []
        stores = await self._told(component, _STORAGE, "storage_count")
        return Camera(
            camera=component,
            vendor=text_of(bytes(f["vendor_name"])),
            model=text_of(bytes(f["model_name"])),
            takes_pictures=bool(flags & _PICTURES),
            records_video=bool(flags & _VIDEO),
            zooms=bool(flags & _ZOOMS),
            focuses=bool(flags & _FOCUSES),
            width=f["resolution_h"],
            height=f["resolution_v"],
            streams=[_stream(one) for one in _by(streams, "stream_id")],
            stores=[_store(one) for one in _by(stores, "storage_id")],
        )

    async def _told(self, component: int, message: str, count: str | None) -> list[dict[str, Any]]:
        """Return the messages that a component sends on request: as many as `count` in them says.

        Those that came in time are returned; none where it does not know the request.
        """
        definition = self._hub.dialect.by_name.get(message)
        if definition is None:
            return []
        found: list[dict[str, Any]] = []

        def take(frame: Frame) -> None:
            if frame.component == component and len(found) < _MOST:
                found.append(frame.fields())

        def whole() -> bool:
            return bool(found) and len(found) >= (1 if count is None else found[0][count])

        request = Command(_REQUEST, (float(definition.id), 0.0, 0.0, 0.0), component=component)
        with self._vehicle.listening(message, take, anybody=True):
            try:
                await self._commands.send(request, f"request for {message}")
            except RcpError:
                self._vehicle.check()
                return []
            await self._vehicle.until(whole, self._hub.config.timeout)
        return found


def _by(told: list[dict[str, Any]], field: str) -> list[dict[str, Any]]:
    """Return one message of each number, the latest, in order."""
    latest = {one[field]: one for one in told}
    return [latest[number] for number in sorted(latest)]


def _stream(f: dict[str, Any]) -> VideoStream:
    protocol: Any = _PROTOCOLS.get(f["type"], "unknown")
    return VideoStream(
        f["stream_id"], text_of(f["name"]), text_of(f["uri"]), protocol, bool(f["flags"] & _RUNS),
        bool(f["flags"] & _THERMAL), f["resolution_h"], f["resolution_v"], f["framerate"], f["bitrate"],
    )  # fmt: skip


def _store(f: dict[str, Any]) -> Store:
    state: Any = _STATES.get(f["status"], "unknown")
    sizes = (f["total_capacity"], f["used_capacity"], f["available_capacity"])
    if state != "ready":
        return Store(f["storage_id"], state, None, None, None)
    return Store(f["storage_id"], state, *(round(size * _MEBIBYTE) for size in sizes))
