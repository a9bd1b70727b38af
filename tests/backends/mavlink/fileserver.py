"""An FTP server of MAVLink in memory, that loses, repeats and refuses when a test says so."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from typing import Any

_HEAD = struct.Struct("<HBBBBBxI")
PIECE = 239
BURST = 20  # pieces


class FileServer:
    """Files by path; to be put in a puppet's `on` under FILE_TRANSFER_PROTOCOL."""

    def __init__(self, send: Callable[..., None], files: dict[str, bytes]) -> None:
        self._send = send
        self.files = {path: bytearray(data) for path, data in files.items()}
        self.directories = {"/"}
        self.session: tuple[str, str] | None = None
        self.lose: Callable[[int], bool] = lambda _: False
        """Whether the n-th answer is lost."""
        self.bursts = True
        self.sums = True
        self.sizes = True
        """Whether it knows how long a file is before it is read."""
        self.answers = 0
        self.handled: list[int] = []
        self._last: tuple[int, bytes] | None = None

    def __call__(self, message: Any) -> None:
        raw = bytes(message.payload)
        seq, session, op, size, _, _, offset = _HEAD.unpack_from(raw)
        if self._last is not None and self._last[0] == seq:
            self.out(self._last[1])
            return
        self.handled.append(op)
        data = raw[12 : 12 + size]
        if op == 15 and self.bursts:
            self._burst(seq, offset)
            return
        answer = self.answer(op, offset, data, size)
        code = 129 if isinstance(answer, int) else 128
        body = bytes([answer]) if isinstance(answer, int) else answer
        packed = _HEAD.pack((seq + 1) & 0xFFFF, session, code, len(body), op, 0, offset) + body
        self._last = (seq, packed)
        self.out(packed)

    def out(self, packed: bytes) -> None:
        self.answers += 1
        if not self.lose(self.answers):
            self._send("FILE_TRANSFER_PROTOCOL", 0, 255, 190, packed.ljust(251, b"\0"))

    def _burst(self, seq: int, offset: int) -> None:
        assert self.session is not None
        content = self.files[self.session[0]]
        for n in range(BURST):
            seq, at = (seq + 1) & 0xFFFF, offset + n * PIECE
            piece = content[at : at + PIECE]
            if not piece:
                self.out(_HEAD.pack(seq, 0, 129, 1, 15, 0, at) + b"\x06")
                return
            last = n == BURST - 1
            self.out(_HEAD.pack(seq, 0, 128, len(piece), 15, last, at) + bytes(piece))

    def answer(self, op: int, offset: int, data: bytes, size: int) -> bytes | int:
        path = data.decode(errors="replace")
        match op:
            case 1 | 2:
                self.session = None
                return b""
            case 3:
                return self._list(path, offset)
            case 4 | 6 | 11:
                if self.session is not None:
                    return 5
                if op == 6:
                    self.files[path] = bytearray()
                if path not in self.files:
                    return 10
                self.session = (path, "r" if op == 4 else "w")
                return struct.pack("<I", len(self.files[path]) if self.sizes else 0)
            case 5:
                assert self.session is not None
                return bytes(self.files[self.session[0]][offset : offset + size]) or 6
            case 7:
                assert self.session is not None
                content = self.files[self.session[0]]
                content.extend(bytes(max(0, offset - len(content))))
                content[offset : offset + size] = data
                return struct.pack("<I", size)
            case 8:
                return b"" if self.files.pop(path, None) is not None else 10
            case 9:
                self.directories.add(path)
                return b""
            case 10 if path in self.directories:
                self.directories.remove(path)
                return b""
            case 13:
                old, _, new = path.partition("\0")
                if old not in self.files:
                    return 10
                self.files[new] = self.files.pop(old)
                return b""
            case 14 if self.sums:
                if path not in self.files:
                    return 10
                sum_ = zlib.crc32(self.files[path], 0xFFFFFFFF) ^ 0xFFFFFFFF
                return struct.pack("<I", sum_)
            case _:
                return 7

    def _list(self, path: str, offset: int) -> bytes | int:
        if path not in self.directories:
            return 10
        names = [b"D.", b"D..", b"Dlogs", b"S"]
        names += [
            f"F{name.removeprefix('/')}\t{len(data)}".encode()
            for name, data in sorted(self.files.items())
        ]
        out = b""
        for name in names[offset:]:
            if len(out) + len(name) + 1 > PIECE:
                break
            out += name + b"\0"
        return out or 6
