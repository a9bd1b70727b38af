"""MAVLink FTP server: sessions, and replies like ArduPilot's."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import msgspec

from rcp_mavlink_sim.wire import mav

if TYPE_CHECKING:
    from rcp_mavlink_sim.vehicle import Vehicle

__all__ = ["Ftp"]

_HEAD = struct.Struct("<HBBBBBxI")
_ROOM = 239  # bytes of data in one message
_ACK, _NAK = 128, 129
_FAIL, _BAD_SIZE, _NO_SESSION, _EOF, _UNKNOWN, _EXISTS, _NOT_FOUND = 1, 3, 4, 6, 7, 8, 10
_BURST = 500  # messages per burst
_A_TURN = 8  # maximum number of sessions
_SILENT = 3.0  # s without a request after which a session may be taken over


class _Refused(Exception):
    def __init__(self, code: int) -> None:
        self.code = code


class _Request(msgspec.Struct, frozen=True):
    number: int
    session: int
    opcode: int
    size: int
    offset: int
    data: bytes

    @property
    def path(self) -> str:
        text = self.data[: self.size].split(b"\0")[0].decode("utf-8", "replace")
        return text.strip("/") if text.strip("/") != "." else ""


class _Session(msgspec.Struct):
    path: str
    writes: bool
    content: bytes
    """The content when the file was opened for reading."""
    used: float


class _Burst(msgspec.Struct):
    request: _Request
    number: int
    offset: int
    sent: int = 0


class Ftp:
    """The FTP server for one peer."""

    def __init__(self, vehicle: Vehicle, send: Callable[[Any], None]) -> None:
        self._vehicle, self._send = vehicle, send
        self._sessions: dict[int, _Session] = {}
        self._burst: _Burst | None = None
        self._answered: tuple[int, int, int, bytes] | None = None
        self._client = (0, 0)
        self._doers: dict[int, Callable[[_Request], bytes]] = {
            0: lambda _: b"",
            1: self._end,
            2: self._end_all,
            3: self._list,
            4: self._open,
            5: self._read,
            6: self._create,
            7: self._write,
            8: lambda request: _done(self._files.remove(request.path), _NOT_FOUND),
            9: self._make_folder,
            10: lambda request: _done(self._files.remove_folder(request.path), _FAIL),
            11: self._open_to_write,
            12: lambda request: _done(
                self._files.truncate(request.path, request.offset), _NOT_FOUND
            ),
            13: self._rename,
            14: self._checksum,
        }

    @property
    def _files(self) -> Any:
        return self._vehicle.files

    def take(self, message: Any) -> None:
        """Handle a request; a repeated request gets the same reply."""
        head = bytes(message.payload[: _HEAD.size])
        number, session, opcode, size, _, _, offset = _HEAD.unpack(head)
        data = bytes(message.payload[_HEAD.size :])
        request = _Request(number, session, opcode, min(size, _ROOM), offset, data)
        self._client = (message.get_srcSystem(), message.get_srcComponent())
        key = (number, session, opcode)
        if self._answered is not None and self._answered[:3] == key:
            self._push(self._answered[3])
            return
        self._burst = None
        if opcode == 15:
            self._begin_burst(request)
            return
        do = self._doers.get(opcode)
        try:
            if do is None:
                raise _Refused(_UNKNOWN)
            reply = _packed(request, number + 1, _ACK, do(request))
        except _Refused as refused:
            reply = _packed(request, number + 1, _NAK, bytes((refused.code,)))
        self._answered = (*key, reply)
        self._push(reply)

    def turn(self) -> None:
        """Continue a burst."""
        for _ in range(_A_TURN):
            if self._burst is None:
                return
            self._next(self._burst)

    def _push(self, payload: bytes) -> None:
        padded = list(payload.ljust(_HEAD.size + _ROOM, b"\0"))
        self._send(mav.MAVLink_file_transfer_protocol_message(0, *self._client, padded))

    # Sessions

    def _session(self, request: _Request, *, writes: bool) -> _Session:
        session = self._sessions.get(request.session)
        if session is None or session.writes != writes:
            raise _Refused(_NO_SESSION if session is None else _FAIL)
        session.used = self._vehicle.wall
        return session

    def _begin(self, request: _Request, *, writes: bool, content: bytes) -> None:
        held = self._sessions.get(request.session)
        if held is not None and self._vehicle.wall - held.used < _SILENT:
            raise _Refused(_FAIL)
        self._sessions[request.session] = _Session(
            request.path, writes, content, self._vehicle.wall
        )

    def _end(self, request: _Request) -> bytes:
        self._sessions.pop(request.session, None)
        return b""

    def _end_all(self, _: _Request) -> bytes:
        self._sessions.clear()
        return b""

    def _open(self, request: _Request) -> bytes:
        content = self._files.read(request.path)
        if content is None:
            raise _Refused(_NOT_FOUND)
        self._begin(request, writes=False, content=content)
        return struct.pack("<I", len(content))

    def _create(self, request: _Request) -> bytes:
        self._begin(request, writes=True, content=b"")
        if not self._files.create(request.path):
            del self._sessions[request.session]
            raise _Refused(_FAIL)
        return b""

    def _open_to_write(self, request: _Request) -> bytes:
        content = self._files.read(request.path)
        if content is None or request.path.startswith("@"):
            raise _Refused(_NOT_FOUND if content is None else _FAIL)
        self._begin(request, writes=True, content=b"")
        return struct.pack("<I", len(content))

    # Content

    def _read(self, request: _Request) -> bytes:
        content = self._session(request, writes=False).content
        if request.offset >= len(content):
            raise _Refused(_EOF)
        return content[request.offset : request.offset + min(request.size or _ROOM, _ROOM)]

    def _write(self, request: _Request) -> bytes:
        session = self._session(request, writes=True)
        if not self._files.exists(session.path):
            raise _Refused(_NOT_FOUND)
        return _done(
            self._files.write(session.path, request.offset, request.data[: request.size]), _FAIL
        )

    def _begin_burst(self, request: _Request) -> None:
        try:
            self._session(request, writes=False)
        except _Refused as refused:
            self._push(_packed(request, request.number + 1, _NAK, bytes((refused.code,))))
            return
        self._answered = None
        self._burst = _Burst(request, request.number + 1, request.offset)

    def _next(self, burst: _Burst) -> None:
        session = self._sessions.get(burst.request.session)
        if session is None:
            self._burst = None
            return
        session.used = self._vehicle.wall
        most = min(burst.request.size or _ROOM, _ROOM)
        piece = session.content[burst.offset : burst.offset + most]
        if not piece:
            reply = _packed(burst.request, burst.number, _NAK, bytes((_EOF,)), burst.offset)
            self._burst = None
        else:
            burst.sent += 1
            last = burst.sent >= _BURST
            reply = _packed(burst.request, burst.number, _ACK, piece, burst.offset, last=last)
            burst.offset += len(piece)
            burst.number += 1
            if last:
                self._burst = None
        self._push(reply)

    def _checksum(self, request: _Request) -> bytes:
        content = self._files.read(request.path)
        if content is None:
            raise _Refused(_NOT_FOUND)
        return struct.pack("<I", checksum(content))

    # Directories

    def _list(self, request: _Request) -> bytes:
        if not self._files.folder(request.path):
            raise _Refused(_NOT_FOUND)
        entries = self._files.listed(request.path)[request.offset :]
        if not entries:
            raise _Refused(_EOF)
        found = b""
        for name, size in entries:
            entry = (f"D{name}" if size is None else f"F{name}\t{size}").encode() + b"\0"
            if len(found) + len(entry) > _ROOM:
                break
            found += entry
        return found

    def _make_folder(self, request: _Request) -> bytes:
        if self._files.exists(request.path):
            raise _Refused(_EXISTS)
        return _done(self._files.make_folder(request.path), _FAIL)

    def _rename(self, request: _Request) -> bytes:
        names = request.data[: request.size].split(b"\0")
        if len(names) < 2:
            raise _Refused(_BAD_SIZE)
        old, new = (name.decode("utf-8", "replace").strip("/") for name in names[:2])
        if not self._files.exists(old):
            raise _Refused(_NOT_FOUND)
        return _done(self._files.rename(old, new), _FAIL)


def checksum(content: bytes) -> int:
    """Return MAVLink's CRC-32 of a file: it starts from 0 and is not inverted at the end."""
    return zlib.crc32(content, 0xFFFFFFFF) ^ 0xFFFFFFFF


def _done(done: bool, code: int) -> bytes:  # noqa: FBT001 - the outcome, as a reply
    if not done:
        raise _Refused(code)
    return b""


def _packed(
    request: _Request,
    number: int,
    opcode: int,
    data: bytes,
    offset: int | None = None,
    *,
    last: bool = False,
) -> bytes:
    at = request.offset if offset is None else offset
    head = (number & 0xFFFF, request.session, opcode, len(data), request.opcode, last, at)
    return _HEAD.pack(*head) + data
