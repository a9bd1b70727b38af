"""Writes MCAP, holding the interpreter for a fraction of a millisecond at a time.

The writer of the package `mcap` takes several calls for each number, and so milliseconds for the index of
a chunk; the event loop, and with it an e-stop, would wait for them.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping
from typing import IO

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Channel, Header, Metadata, MetadataIndex, Schema
from mcap.writer import MCAP0_MAGIC
from zstandard import ZstdCompressor

from rcp_recorder.summary import ChunkPlace, Summary

__all__ = ["McapWriter"]

_CHUNK = 256 * 1024  # bytes of records
_MESSAGE = struct.Struct("<BQHIQQ")
_BODY = _MESSAGE.size - 9  # bytes of a message before its data
_INDEX = struct.Struct("<BQHI")
_CHUNK_HEAD = struct.Struct("<BQQQQII4sQ")
_COMPRESSION = "zstd"


class McapWriter:
    """Writes one file."""

    def __init__(self, file: IO[bytes], library: str) -> None:
        self._file = file
        self._compress = ZstdCompressor().compress
        self._summary = Summary()
        self._chunk = bytearray()
        """Records of the chunk that is not written yet."""
        self._indexes: dict[int, list[int]] = {}
        """Of its messages, by channel: time and place, by turns."""
        self._start = self._end = 0
        file.write(MCAP0_MAGIC)
        self._write(Header("", library))

    def add_metadata(self, name: str, facts: Mapping[str, str]) -> None:
        """Write metadata; before the first message."""
        offset = self._file.tell()
        length = self._write(Metadata(name, dict(facts)))
        self._summary.metadata.append(MetadataIndex(offset, length, name))

    def register_schema(self, name: str, encoding: str, data: bytes) -> int:
        """Add a schema; return its number."""
        known = self._summary.schemas
        schema = known[len(known) + 1] = Schema(
            id=len(known) + 1, data=data, encoding=encoding, name=name
        )
        self._chunk += _encoded(schema)
        return schema.id

    def register_channel(
        self, topic: str, encoding: str, schema: int, facts: Mapping[str, str]
    ) -> int:
        """Add a channel; return its number."""
        known = self._summary.channels
        channel = known[len(known) + 1] = Channel(
            id=len(known) + 1,
            topic=topic,
            message_encoding=encoding,
            schema_id=schema,
            metadata=dict(facts),
        )
        self._chunk += _encoded(channel)
        return channel.id

    def add(self, channel: int, log_time: int, publish_time: int, seq: int, data: bytes) -> None:
        """Add a message to the chunk; a chunk that is full is written."""
        chunk, indexes = self._chunk, self._indexes
        if not indexes:
            self._start = self._end = log_time
        elif log_time > self._end:
            self._end = log_time
        elif log_time < self._start:
            self._start = log_time
        index = indexes.get(channel)
        if index is None:
            index = indexes[channel] = []
        index += (log_time, len(chunk))
        chunk += _MESSAGE.pack(
            Opcode.MESSAGE, _BODY + len(data), channel, seq, log_time, publish_time
        )
        chunk += data
        if len(chunk) > _CHUNK:
            self._end_chunk()

    def flush(self) -> None:
        """Hand everything to the operating system."""
        self._end_chunk()
        self._file.flush()

    def finish(self) -> None:
        """Write the index of the file."""
        self._end_chunk()
        self._file.write(self._summary.encode(self._file.tell()))

    def _end_chunk(self) -> None:
        """Write the chunk and the indexes of its messages, if it has any."""
        if not self._indexes:
            return
        records, file = self._chunk, self._file
        compressed = self._compress(records)  # this and the checksum let others run
        offset = file.tell()
        file.write(
            _CHUNK_HEAD.pack(
                Opcode.CHUNK,
                _CHUNK_HEAD.size - 9 + len(compressed),
                self._start,
                self._end,
                len(records),
                zlib.crc32(records),
                len(_COMPRESSION),
                _COMPRESSION.encode(),
                len(compressed),
            )
        )
        file.write(compressed)
        length = _CHUNK_HEAD.size + len(compressed)
        places, written = self._write_indexes(offset + length)
        self._summary.add(
            ChunkPlace(
                self._start,
                self._end,
                offset,
                length,
                places,
                written,
                _COMPRESSION,
                len(compressed),
                len(records),
            )
        )
        self._indexes = {}
        self._chunk = bytearray()

    def _write_indexes(self, offset: int) -> tuple[dict[int, int], int]:
        """Write where the messages of each channel are; return where that is, and its length."""
        places: dict[int, int] = {}
        parts: list[bytes] = []
        begin = offset
        for channel, index in self._indexes.items():
            places[channel] = offset
            size = 8 * len(index)
            parts += (
                _INDEX.pack(Opcode.MESSAGE_INDEX, size + 6, channel, size),
                struct.pack(f"<{len(index)}Q", *index),
            )
            offset += _INDEX.size + size
            self._summary.counts[channel] += len(index) // 2
        self._file.write(b"".join(parts))
        return places, offset - begin

    def _write(self, record: Header | Metadata) -> int:
        data = _encoded(record)
        self._file.write(data)
        return len(data)


def _encoded(record: Header | Metadata | Schema | Channel) -> bytes:
    out = RecordBuilder()
    record.write(out)
    return out.end()
