"""Completes a file whose gateway ended without closing it.

Nothing that was written is written again: whatever follows the last complete chunk is cut off, and the
missing index is added. If that is interrupted, the next start does it again.
"""

from __future__ import annotations

import contextlib
import os
import struct
from collections import defaultdict
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Any

from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
)
from mcap.stream_reader import get_chunk_data_stream
from mcap.writer import MCAP0_MAGIC
from zstandard import ZstdError

from rcp_recorder.mcap_file import ACTIVE, RECOVERY

__all__ = ["repair"]

_HEAD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQ")
_DATA = frozenset((Opcode.HEADER, Opcode.CHUNK, Opcode.MESSAGE_INDEX, Opcode.METADATA))


class _Part:
    """One record of the file."""

    def __init__(self, opcode: int, offset: int, length: int) -> None:
        self.opcode = opcode
        self.offset = offset
        self.length = length
        """Including its head."""


class _Found:
    """What is left of a file."""

    def __init__(self) -> None:
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self.chunks: list[ChunkIndex] = []
        self.metadata: list[MetadataIndex] = []
        self.counts: dict[int, int] = defaultdict(int)
        self.last: dict[int, MessageIndex] = {}
        """The index of the last chunk, which may be missing in part."""
        self.end = len(MCAP0_MAGIC)
        """Where the last complete chunk ends."""

    @property
    def messages(self) -> int:
        """How many messages there are."""
        return sum(self.counts.values())


def repair(path: Path) -> Path | None:
    """Complete a file and give it its final name; None: it has no message and is deleted.

    :raises OSError: it cannot be written.
    """
    with path.open("r+b") as file:
        found = _search(file)
        if found.messages:
            file.truncate(found.end)
            file.seek(found.end)
            file.write(_rest(found))
            file.flush()
            os.fsync(file.fileno())
    if not found.messages:
        path.unlink()
        return None
    return path.rename(path.with_name(path.name.removesuffix(ACTIVE)))


def _search(file: Any) -> _Found:
    found = _Found()
    if file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
        return found
    # Whatever ends it was not written, or only in part.
    with contextlib.suppress(McapError, ValueError, EOFError, struct.error, ZstdError):
        for part in _parts(file):
            _take(found, part, file)
    return found


def _parts(file: Any) -> Iterator[_Part]:
    """Iterate over the complete records of the data section."""
    size = os.fstat(file.fileno()).st_size
    offset = len(MCAP0_MAGIC)
    while offset + _HEAD.size <= size:
        file.seek(offset)
        opcode, length = _HEAD.unpack(file.read(_HEAD.size))
        if opcode not in _DATA or offset + _HEAD.size + length > size:
            return
        yield _Part(opcode, offset, _HEAD.size + length)
        offset += _HEAD.size + length


def _take(found: _Found, part: _Part, file: Any) -> None:
    stream = ReadDataStream(file)
    match part.opcode:
        case Opcode.CHUNK:
            chunk = Chunk.read(stream)
            found.last = _open_chunk(found, chunk)
            found.end = part.offset + part.length
            found.chunks.append(_indexed(chunk, part))
        case Opcode.MESSAGE_INDEX:
            index = MessageIndex.read(stream)
            found.chunks[-1].message_index_offsets[index.channel_id] = part.offset
            found.chunks[-1].message_index_length += part.length
        case Opcode.METADATA:
            metadata = Metadata.read(stream)
            found.metadata.append(MetadataIndex(part.offset, part.length, metadata.name))
        case _:
            pass


def _indexed(chunk: Chunk, part: _Part) -> ChunkIndex:
    return ChunkIndex(
        chunk_length=part.length,
        chunk_start_offset=part.offset,
        compression=chunk.compression,
        compressed_size=len(chunk.data),
        message_end_time=chunk.message_end_time,
        message_index_length=0,
        message_index_offsets={},
        message_start_time=chunk.message_start_time,
        uncompressed_size=chunk.uncompressed_size,
    )


def _open_chunk(found: _Found, chunk: Chunk) -> dict[int, MessageIndex]:
    """Find schemas and channels, and index messages without decoding them."""
    stream, size = get_chunk_data_stream(chunk, validate_crc=True)
    data, offset = stream.read(size), 0
    indexes: dict[int, MessageIndex] = {}
    while offset < size:
        start = offset
        opcode, length = _HEAD.unpack_from(data, offset)
        offset += _HEAD.size
        if opcode == Opcode.MESSAGE:
            channel_id, _, log_time = _MESSAGE.unpack_from(data, offset)
            index = indexes.setdefault(channel_id, MessageIndex(channel_id, []))
            index.records.append((log_time, start))
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
    last = found.chunks[-1]
    for channel_id, index in found.last.items():
        last.message_index_offsets[channel_id] = found.end + out.count
        index.write(out)
    last.message_index_length = out.count
    start = out.count
    Metadata(name=RECOVERY, metadata={"messages": str(found.messages)}).write(out)
    found.metadata.append(MetadataIndex(found.end + start, out.count - start, RECOVERY))
    DataEnd(0).write(out)
    summary = found.end + out.count
    for record in (*found.schemas.values(), *found.channels.values()):
        record.write(out)
    Statistics(
        attachment_count=0,
        channel_count=len(found.channels),
        channel_message_counts=dict(found.counts),
        chunk_count=len(found.chunks),
        message_count=found.messages,
        message_end_time=max(chunk.message_end_time for chunk in found.chunks),
        message_start_time=min(chunk.message_start_time for chunk in found.chunks),
        metadata_count=len(found.metadata),
        schema_count=len(found.schemas),
    ).write(out)
    for index in (*found.chunks, *found.metadata):
        index.write(out)
    Footer(summary_start=summary, summary_offset_start=0, summary_crc=0).write(out)
    return out.end() + MCAP0_MAGIC
