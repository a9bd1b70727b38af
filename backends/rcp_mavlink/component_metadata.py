"""The metadata that a vehicle offers of itself, over MAVLink FTP: those of its parameters."""

from __future__ import annotations

import lzma
import re
from typing import Any

import msgspec

from rcp_kernel.errors import RcpError, UnsupportedOperation
from rcp_mavlink.commands import Command, Commands
from rcp_mavlink.files import Files, checksum
from rcp_mavlink.frames import Frame, text_of
from rcp_mavlink.hub import Hub
from rcp_mavlink.vehicle import Vehicle

__all__ = ["ComponentMetadata"]

_REQUEST = 512
_MESSAGES = (
    ("COMPONENT_METADATA", 397, "uri", "file_crc"),
    ("COMPONENT_INFORMATION", 395, "general_metadata_uri", "general_metadata_file_crc"),
)
_PARAMETERS = 1  # COMP_METADATA_TYPE
_URL = re.compile(r"mftp:(?://)?(?:\[;comp=(\d{1,3})\])?(/?[^/].*)\Z", re.DOTALL)
_XZ = b"\xfd7zXZ\0"
_LARGEST, _UNPACKED = 8 << 20, 32 << 20  # bytes


class _Entry(msgspec.Struct):
    type: int
    uri: str = ""
    fileCrc: int | None = None  # noqa: N815 - the format's own name
    uriFallback: str = ""  # noqa: N815
    fileCrcFallback: int | None = None  # noqa: N815


class _General(msgspec.Struct):
    version: int
    metadataTypes: list[_Entry]  # noqa: N815


class ComponentMetadata:
    """What one vehicle's autopilot tells of itself."""

    def __init__(self, hub: Hub, vehicle: Vehicle, commands: Commands, files: Files) -> None:
        self._hub, self._vehicle = hub, vehicle
        self._commands, self._files = commands, files

    async def parameters(self) -> bytes:
        """Return the file about its parameters.

        :raises RcpError: it offers none, or the file does not come.
        :raises ValueError: a file is damaged, or lies where the gateway does not read.
        """
        uri, crc = await self._where()
        data = _plain(await self._fetch(uri, crc))
        try:
            general = msgspec.json.decode(data, type=_General)
        except msgspec.MsgspecError as error:
            raise ValueError(f"{uri} is no list of metadata: {error}") from error
        entry = next((one for one in general.metadataTypes if one.type == _PARAMETERS), None)
        if entry is None:
            raise UnsupportedOperation("the vehicle offers no metadata of its parameters")
        try:
            return await self._fetch(entry.uri, entry.fileCrc)
        except (ValueError, RcpError):
            self._vehicle.check()
            if not entry.uriFallback:
                raise
            return await self._fetch(entry.uriFallback, entry.fileCrcFallback)

    async def _where(self) -> tuple[str, int | None]:
        """Return the address of the list of its metadata, with its checksum if that is told."""
        for name, number, uri, crc in _MESSAGES:
            found: list[dict[str, Any]] = []

            def take(frame: Frame, found: list[dict[str, Any]] = found) -> None:
                found.append(frame.fields())

            request = Command(_REQUEST, (float(number), 0.0, 0.0, 0.0))
            with self._vehicle.listening(name, take):
                try:
                    await self._commands.send(request, f"request for {name}")
                except RcpError:
                    self._vehicle.check()
                    continue
                if await self._vehicle.until(lambda f=found: bool(f), self._hub.config.timeout):
                    return text_of(bytes(found[-1][uri])), found[-1][crc] or None
        raise UnsupportedOperation("the vehicle offers no metadata")

    async def _fetch(self, uri: str, crc: int | None) -> bytes:
        """Return a file as it is stored on board, if it has its checksum."""
        found = _URL.match(uri)
        if found is None or int(found[1] or self._vehicle.component) != self._vehicle.component:
            raise ValueError(f"the gateway does not read {uri or 'a file without an address'}")
        data = await self._files.fetch(found[2], _LARGEST)
        if crc is not None and checksum(data) != crc:
            raise ValueError(f"{uri} is damaged: its checksum is not the one that was told")
        return data


def _plain(data: bytes) -> bytes:
    """Unpack a file."""
    if data[:6] != _XZ:
        return data
    try:
        return lzma.LZMADecompressor().decompress(data, _UNPACKED)
    except lzma.LZMAError as error:
        raise ValueError(f"a packed file is damaged: {error}") from error
