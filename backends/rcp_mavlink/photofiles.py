"""Pictures that a camera has stored on board, fetched by MAVLink FTP."""

from __future__ import annotations

import re
import struct
from typing import NamedTuple

from rcp_kernel.errors import RcpError
from rcp_mavlink import messages as m
from rcp_mavlink.files import Files
from rcp_mavlink.hub import Hub
from rcp_mavlink.vehicle import Vehicle
from rcp_protocol.timeouts import timeout

__all__ = ["PhotoFiles"]

_URL = re.compile(r"mftp:(?://)?(?:\[;comp=(\d{1,3})\])?(/?[^/].*)\Z", re.DOTALL)
_MOST = 1 << 18  # bytes; a slow radio needs minutes for the pictures of a survey
_COMPONENTS = range(1, 256)
_PATIENCE = 10.0  # s, within the action's own time limit
_PNG = b"\x89PNG\r\n\x1a\n"
_FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}  # JPEG headers with the size


class Fetched(NamedTuple):
    """A picture, or why it was not fetched."""

    image: m.Image | None
    note: str = ""


class PhotoFiles:
    """The pictures of one vehicle's camera; `files` are those of its autopilot."""

    def __init__(self, hub: Hub, vehicle: Vehicle, files: Files) -> None:
        self._hub, self._vehicle = hub, vehicle
        self._by_component = {vehicle.component: files}

    async def fetch(self, url: str, component: int) -> Fetched:
        """Return the picture at a URL that a component has reported.

        The picture is taken: that it cannot be fetched is no failure of the command.
        """
        found = _URL.match(url)
        if found is None:
            why = "the camera stores it where the gateway does not read" if url else ""
            return Fetched(None, why)
        source = int(found[1]) if found[1] else component
        if source not in _COMPONENTS:
            return Fetched(None, f"not transferred: there is no component {source}")
        try:
            async with timeout(_PATIENCE):
                data = await self._files(source).fetch(found[2], _MOST)
            size = _dimensions(data)
        except TimeoutError:
            return Fetched(None, f"not transferred within {_PATIENCE:g} s")
        except RcpError as error:
            return Fetched(None, f"not transferred: {error.message}")
        except Exception as error:  # whatever a camera says, the picture is taken
            return Fetched(None, f"not transferred: {error!r}")
        if size is None:
            return Fetched(None, "neither PNG nor JPEG")
        return Fetched(m.Image(*size, data, "png" if data.startswith(_PNG) else "jpeg"))

    def _files(self, component: int) -> Files:
        files = self._by_component.get(component)
        if files is None:
            files = Files(self._hub, self._vehicle, component)
            self._by_component[component] = files
        return files


def _dimensions(data: bytes) -> tuple[int, int] | None:
    """Return width and height of a PNG or JPEG."""
    if data.startswith(_PNG) and len(data) >= 24:
        return struct.unpack_from(">II", data, 16)
    if not data.startswith(b"\xff\xd8"):
        return None
    at = 2
    while at + 9 <= len(data) and data[at] == 0xFF:
        if data[at + 1] in _FRAMES:
            height, width = struct.unpack_from(">HH", data, at + 5)
            return width, height
        at += 2 + struct.unpack_from(">H", data, at + 2)[0]
    return None
