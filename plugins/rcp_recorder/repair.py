"""Completes a file whose gateway ended without closing it.

Nothing that was written is written again: whatever follows the last complete chunk is cut off, and the
missing index is added. If that is interrupted, the next start does it again. A file with damage before its
end, as after a power failure, is kept beside what could be read of it: more of it may be readable. Until there
is room for that, it keeps its name, and the next beginning tries again.
"""

from __future__ import annotations

import contextlib
import errno
import os
import struct
from collections.abc import Callable, Iterator
from io import BytesIO
from pathlib import Path
from typing import Any

import structlog
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, MessageIndex, Metadata, MetadataIndex, Schema
from mcap.stream_reader import get_chunk_data_stream
from mcap.writer import MCAP0_MAGIC
from zstandard import ZstdError

from rcp_recorder.summary import ChunkPlace, Summary
from rcp_recorder.turns import take_turns
from rcp_recordings.names import ACTIVE, RECOVERY

__all__ = ["DAMAGED", "repair"]

log = structlog.get_logger("rcp.recorder")
DAMAGED = ".damaged"
"""What is appended to the name of a file that has damage before its end."""

_HEAD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQ")
_WRONG = (McapError, ValueError, EOFError, struct.error, ZstdError, OverflowError, MemoryError)
"""Errors of records with other content than was written; lengths may be any number."""
_PIECE = 1 << 20  # bytes
_LONGEST = 4 << 20  # bytes of the last record, which was not written to its end
_FULL = frozenset((errno.ENOSPC, errno.EDQUOT))
_ZSTD = b"\x28\xb5\x2f\xfd"
"""How the data of a chunk begins."""
_CHUNK_LENGTH = 36  # bytes of a chunk before the length of its data
_DATA = frozenset((Opcode.HEADER, Opcode.CHUNK, Opcode.MESSAGE_INDEX, Opcode.METADATA))


class _Part:
    """One record of the file."""

    def __init__(self, opcode: int, offset: int, length: int) -> None:
        self.opcode = opcode
        self.offset = offset
        self.length = length
        """Including its head."""


class _Found(Summary):
    """What is left of a file."""

    def __init__(self) -> None:
        super().__init__()
        self.indexes: dict[int, MessageIndex] = {}
        """Those of the last chunk, which may be missing in part."""
        self.data_end = len(MCAP0_MAGIC)
        """Where the last complete chunk ends."""
        self.rest = 0
        """Where what nobody looked at begins."""
        self._last: ChunkPlace | None = None
        self._places: dict[int, int] = {}
        self._length = 0

    def begin(self, chunk: ChunkPlace, indexes: dict[int, MessageIndex], end: int) -> None:
        """Take in a chunk, whose indexes follow."""
        self.end_chunk(self._places, self._length)
        self._last, self.indexes, self.data_end = chunk, indexes, end
        self._places, self._length = {}, 0

    def indexed(self, channel: int, part: _Part) -> None:
        """Take in an index of the last chunk."""
        self._places[channel] = part.offset
        self._length += part.length

    def end_chunk(self, places: dict[int, int], length: int) -> None:
        """Add the last chunk, with the places of its indexes and their length."""
        if self._last is not None:
            self.add(self._last._replace(indexes=places, indexes_length=length))


def repair(path: Path, room: Callable[[int], bool] = lambda _: True) -> Path | None:
    """Complete a file and give it its final name; None: it has no message and is deleted, unless it is damaged.

    `room` tells whether there is room for so many bytes of another file: a damaged one stays as it is until then.

    :raises OSError: it cannot be written.
    """
    final = path.with_name(path.name.removesuffix(ACTIVE))
    with path.open("r+b") as file:
        found = _search(file)
        damaged = _has_data(file, found.rest)
        if found.messages and not damaged:
            file.truncate(found.data_end)
            _complete(file, found)
    if not damaged:
        if found.messages:
            return path.rename(final)
        path.unlink()
        return None
    return _set_aside(path, final, found, room)


def _set_aside(path: Path, final: Path, found: _Found, room: Callable[[int], bool]) -> Path | None:
    part = final.with_name(f"{final.name}.part")
    part.unlink(missing_ok=True)  # of an attempt that was interrupted
    copied = False
    if found.messages:
        if not room(found.data_end):
            log.error("recording_not_recovered", file=path.name, error="no room for a copy")
            return None
        try:
            _copy(path, part, found)
        except OSError as error:
            part.unlink(missing_ok=True)
            log.error("recording_not_recovered", file=path.name, error=str(error))
            if error.errno in _FULL:
                return None
        else:
            part.rename(final)
            copied = True
    aside = path.with_name(f"{path.name}{DAMAGED}")
    log.error("recording_damaged", file=path.name, read=found.data_end, aside=aside.name)
    path.rename(aside)
    return final if copied else None


def _complete(file: Any, found: _Found) -> None:
    file.seek(found.data_end)
    file.write(_rest(found))
    file.flush()
    os.fsync(file.fileno())


def _copy(path: Path, target: Path, found: _Found) -> None:
    """Write what could be read of a file into another one."""
    with path.open("rb") as source, target.open("wb") as file:
        for start in range(0, found.data_end, _PIECE):
            file.write(source.read(min(_PIECE, found.data_end - start)))
        _complete(file, found)


def _search(file: Any) -> _Found:
    found = _Found()
    begin = file.read(len(MCAP0_MAGIC))
    if begin != MCAP0_MAGIC:
        found.rest = len(begin) if MCAP0_MAGIC.startswith(begin) else 0
        return found
    # Whatever ends it was not written, or only in part.
    with contextlib.suppress(*_WRONG):
        for part in _parts(file, found):
            _take(found, part, file)
    return found


def _parts(file: Any, found: _Found) -> Iterator[_Part]:
    """Iterate over the complete records of the data section; note where what follows begins."""
    found.rest = size = os.fstat(file.fileno()).st_size
    offset = len(MCAP0_MAGIC)
    while offset + _HEAD.size <= size:
        file.seek(offset)
        opcode, length = _HEAD.unpack(file.read(_HEAD.size))
        if opcode not in _DATA:
            found.rest = size if opcode == Opcode.DATA_END else offset
            return
        if offset + _HEAD.size + length > size:  # not written to its end, or its length is wrong
            torn = size - offset < _LONGEST and _is_torn(opcode, length, file.read())
            found.rest = size if torn else offset
            return
        found.rest = offset + _HEAD.size + length
        yield _Part(opcode, offset, _HEAD.size + length)
        offset += _HEAD.size + length
    found.rest = size


def _is_torn(opcode: int, length: int, rest: bytes) -> bool:
    """Return whether a record whose length leads beyond the file was not written to its end.

    Otherwise the length is wrong, and there may be chunks in the rest.
    """
    if opcode == Opcode.CHUNK:
        whole, at = _CHUNK_LENGTH + 8, _CHUNK_LENGTH
        return len(rest) < whole or length == whole + int.from_bytes(rest[at:whole], "little")
    return _ZSTD not in rest


def _has_data(file: Any, start: int) -> bool:
    """Return whether anything but zeros follows: blocks that the system did not write read as zeros."""
    file.seek(start)
    while piece := file.read(_PIECE):
        if piece.count(0) < len(piece):
            return True
    return False


def _take(found: _Found, part: _Part, file: Any) -> None:
    # No more than the record has, whatever lengths it claims for its parts.
    stream = ReadDataStream(BytesIO(file.read(part.length - _HEAD.size)))
    match part.opcode:
        case Opcode.CHUNK:
            chunk = Chunk.read(stream)
            indexes = _open_chunk(found, chunk)
            found.begin(_place(chunk, part), indexes, part.offset + part.length)
        case Opcode.MESSAGE_INDEX:
            found.indexed(MessageIndex.read(stream).channel_id, part)
        case Opcode.METADATA:
            metadata = Metadata.read(stream)
            found.metadata.append(MetadataIndex(part.offset, part.length, metadata.name))
        case _:
            pass


def _place(chunk: Chunk, part: _Part) -> ChunkPlace:
    return ChunkPlace(
        start=chunk.message_start_time,
        end=chunk.message_end_time,
        offset=part.offset,
        length=part.length,
        indexes={},
        indexes_length=0,
        compression=chunk.compression,
        compressed=len(chunk.data),
        size=chunk.uncompressed_size,
    )


def _open_chunk(found: _Found, chunk: Chunk) -> dict[int, MessageIndex]:
    """Find schemas and channels, and index messages without decoding them."""
    stream, size = get_chunk_data_stream(chunk, validate_crc=True)
    data, offset, count = stream.read(size), 0, 0
    indexes: dict[int, MessageIndex] = {}
    while offset < size:
        start = offset
        opcode, length = _HEAD.unpack_from(data, offset)
        offset += _HEAD.size
        if opcode == Opcode.MESSAGE:
            channel_id, _, log_time = _MESSAGE.unpack_from(data, offset)
            index = indexes.setdefault(channel_id, MessageIndex(channel_id, []))
            index.records.append((log_time, start))
            count += 1
            take_turns(count)
        elif opcode == Opcode.SCHEMA:
            schema = Schema.read(ReadDataStream(BytesIO(data[offset : offset + length])))
            found.schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            channel = Channel.read(ReadDataStream(BytesIO(data[offset : offset + length])))
            found.channels[channel.id] = channel
        offset += length
    for channel_id, index in indexes.items():
        found.counts[channel_id] += len(index.records)
    return indexes


def _rest(found: _Found) -> bytes:
    """Return what has to follow the last chunk: its index, metadata, the summary and the footer."""
    out = RecordBuilder()
    places: dict[int, int] = {}
    for channel_id, index in found.indexes.items():
        places[channel_id] = found.data_end + out.count
        index.write(out)
    found.end_chunk(places, out.count)
    start = out.count
    Metadata(name=RECOVERY, metadata={"messages": str(found.messages)}).write(out)
    found.metadata.append(MetadataIndex(found.data_end + start, out.count - start, RECOVERY))
    rest = out.end()
    return rest + found.encode(found.data_end + len(rest))
