"""The files on board as services: listed, read and written in ranges, removed, compared."""

from __future__ import annotations

import zlib
from collections.abc import Awaitable, Callable
from typing import Annotated, Any, Literal

from msgspec import Meta, Struct

from rcp_kernel.errors import DeviceRejected, InvalidValue, NotImplementedByRobot
from rcp_kernel.spi import Progress
from rcp_mavlink.ftp import PIECE, Ftp, Op
from rcp_mavlink.gaps import Gaps
from rcp_mavlink.hub import Hub
from rcp_mavlink.vehicle import Vehicle

__all__ = ["Check", "Entry", "FilePath", "FilePiece", "FileRange", "FileWrite", "Files", "Remove", "Rename", "Written", "checksum"]  # fmt: skip

Verb = Callable[[Any, Progress], Awaitable[Any]]

MOST = 4 << 20  # bytes per request
_MOST_ENTRIES = 10_000
_END = 6
_COUNTING = 3.0  # s for the vehicle to compute a CRC before the request is repeated
_LARGEST = 2**32 - 1

Path = Annotated[
    str,
    Meta(
        min_length=1,
        max_length=PIECE - 1,
        pattern=r"^[^\x00]+$",
        examples=["/APM/scripts/hello.lua", "@SYS/threads.txt"],
    ),
]
Bytes = Annotated[int, Meta(ge=0, le=_LARGEST, extra_json_schema={"unit": "By"})]
Sum = Annotated[int, Meta(ge=0, le=_LARGEST, extra_json_schema={"unit": "1"})]


class FilePath(Struct, frozen=True, forbid_unknown_fields=True):
    """Path of a file or directory on board."""

    path: Path


class Entry(Struct, frozen=True):
    """One file or directory."""

    name: str
    kind: Literal["file", "directory"]
    size: Bytes
    """0 for a directory."""


class FileRange(Struct, frozen=True, forbid_unknown_fields=True):
    """A range of a file."""

    path: Path
    offset: Bytes = 0
    count: Annotated[int, Meta(ge=1, le=MOST, extra_json_schema={"unit": "By"})] = MOST


class FilePiece(Struct, frozen=True):
    """A part of a file."""

    path: str
    offset: Bytes
    end: bool
    """Whether the file ends here."""
    data: bytes


class FileWrite(Struct, frozen=True, forbid_unknown_fields=True):
    """Data and offset; offset 0 creates the file, any other requires that it exists."""

    path: Path
    data: Annotated[bytes, Meta(max_length=MOST)]
    offset: Bytes = 0


class Written(Struct, frozen=True):
    """Length of the file as written so far."""

    path: str
    size: Bytes
    crc: Sum | None
    """CRC of the whole file on board; None if the vehicle does not compute it."""


class Check(Struct, frozen=True):
    """The CRC-32 of a file, with initial value 0 and no final inversion."""

    path: str
    crc: Sum


class Remove(Struct, frozen=True, forbid_unknown_fields=True):
    """What to remove."""

    path: Path
    directory: bool = False
    """Whether it is an empty directory instead of a file."""


class Rename(Struct, frozen=True, forbid_unknown_fields=True):
    """A file to rename."""

    path: Path
    to: Path


def checksum(data: bytes) -> int:
    """Return the CRC-32 as vehicles compute it: initial value 0, no final inversion."""
    return zlib.crc32(data, 0xFFFFFFFF) ^ 0xFFFFFFFF


class Files:
    """The files of one vehicle, or of one of its other components."""

    def __init__(self, hub: Hub, vehicle: Vehicle, component: int | None = None) -> None:
        self._ftp = Ftp(hub, vehicle, component)

    def verbs(self) -> dict[str, Verb]:
        """Return the handler of each path."""
        return {
            "service/ftp/list": self.list,
            "service/ftp/read": self.read,
            "service/ftp/write": self.write,
            "service/ftp/crc": self.crc,
            "service/ftp/remove": self.remove,
            "service/ftp/mkdir": self.mkdir,
            "service/ftp/rename": self.rename,
        }

    async def list(self, given: FilePath, _: Progress) -> list[Entry]:
        """List a directory; request further entries until there are none left."""
        found: list[Entry] = []
        path, what, at = _encoded(given.path), f"listing {given.path}", 0
        async with self._ftp.turn():
            while len(found) < _MOST_ENTRIES:
                reply = await self._ftp.request(Op.LIST, 0, at, path)
                if reply.error == _END:
                    break
                if reply.error:
                    reply = await self._ftp.do(Op.LIST, what, path, at)
                names = [name for name in reply.data.split(b"\0") if name]
                if not names:
                    break
                at += len(names)
                found += [entry for name in names if (entry := _entry(name)) is not None]
        return sorted(found, key=lambda entry: entry.name)

    async def read(self, given: FileRange, progress: Progress) -> FilePiece:
        """Return a part of a file."""
        what, path = f"reading {given.path}", _encoded(given.path)
        ftp = self._ftp
        async with ftp.turn(), ftp.opened(Op.OPEN_TO_READ, path, what) as (session, size):
            # The size of a file that is generated when read may be reported as 0, or too large.
            stop = given.offset + given.count
            gaps = Gaps(given.offset, min(stop, size) if size else stop)
            await ftp.read(session, gaps, what, lambda part: progress(fraction=part))
        data = gaps.data
        last = given.offset + len(data)
        return FilePiece(given.path, given.offset, last < stop or last == size, data)

    async def fetch(self, path: str, most: int) -> bytes:
        """Return a whole file.

        :raises InvalidValue: it is larger than `most` bytes.
        """
        what = f"reading {path}"
        ftp = self._ftp
        async with ftp.turn(), ftp.opened(Op.OPEN_TO_READ, _encoded(path), what) as (session, size):
            if size > most:
                raise InvalidValue(f"it has {size} bytes")
            gaps = Gaps(0, size or most)
            await ftp.read(session, gaps, what, lambda _: None)
        return gaps.data

    async def write(self, given: FileWrite, progress: Progress) -> Written:
        """Write a part of a file; completes when the vehicle's CRC matches, if it computes one."""
        what, path = f"writing {given.path}", _encoded(given.path)
        ftp, data = self._ftp, given.data
        op = Op.OPEN_TO_WRITE if given.offset else Op.CREATE
        async with ftp.turn():
            async with ftp.opened(op, path, what) as (session, _):
                await ftp.write(
                    session, given.offset, data, what, lambda part: progress(fraction=part)
                )
            crc = await self._crc(path, what)
        if crc is not None and not given.offset and crc != checksum(data):
            raise DeviceRejected(f"{what}: the file on board differs from the data sent")
        return Written(given.path, given.offset + len(data), crc)

    async def _crc(self, path: bytes, what: str) -> int | None:
        try:
            reply = await self._ftp.do(Op.CRC, what, path, wait=_COUNTING)
        except NotImplementedByRobot:
            return None
        return int.from_bytes(reply.data[:4], "little")

    async def crc(self, given: FilePath, _: Progress) -> Check:
        """Return the CRC of a file from the vehicle."""
        what = f"CRC of {given.path}"
        async with self._ftp.turn():
            reply = await self._ftp.do(Op.CRC, what, _encoded(given.path), wait=_COUNTING)
        return Check(given.path, int.from_bytes(reply.data[:4], "little"))

    async def remove(self, given: Remove, _: Progress) -> None:
        """Remove a file, or an empty directory."""
        op = Op.REMOVE_DIRECTORY if given.directory else Op.REMOVE
        await self._simple(op, f"removing {given.path}", _encoded(given.path))

    async def mkdir(self, given: FilePath, _: Progress) -> None:
        """Make a directory."""
        await self._simple(
            Op.MAKE_DIRECTORY, f"creating directory {given.path}", _encoded(given.path)
        )

    async def rename(self, given: Rename, _: Progress) -> None:
        """Rename a file."""
        both = _encoded(given.path) + b"\0" + _encoded(given.to)
        if len(both) > PIECE:
            raise InvalidValue(f"both paths together are longer than {PIECE - 1} bytes")
        await self._simple(Op.RENAME, f"renaming {given.path}", both)

    async def _simple(self, op: int, what: str, data: bytes) -> None:
        async with self._ftp.turn():
            await self._ftp.do(op, what, data)


def _encoded(path: str) -> bytes:
    data = path.encode()
    if len(data) > PIECE - 1:
        raise InvalidValue(
            f"a path can have at most {PIECE - 1} bytes", details={"pointer": "/path"}
        )
    return data


def _entry(text: bytes) -> Entry | None:
    """Parse `Fname<tab>size` or `Dname`; None for entries to skip, such as the parent directory."""
    kind, (name, _, size) = text[:1], text[1:].decode("utf-8", "replace").partition("\t")
    if kind == b"D" and name not in (".", ".."):
        return Entry(name, "directory", 0)
    if kind == b"F":
        return Entry(name, "file", int(size) if size.isdigit() else 0)
    return None
