"""The end of a file: what is in it, where its chunks are, and what belongs to all of it."""

from __future__ import annotations

import struct
import zlib
from collections import defaultdict
from collections.abc import Mapping
from typing import NamedTuple

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Channel, DataEnd, MetadataIndex, Schema, Statistics
from mcap.writer import MCAP0_MAGIC

__all__ = ["ChunkPlace", "Summary"]

_HEAD = struct.Struct("<BQ")
_PLACE = struct.Struct("<QQQQI")
_FOOTER = struct.Struct("<BQQQ")  # without its checksum, which is of all before it


class ChunkPlace(NamedTuple):
    """Where a chunk and the indexes of its messages are."""

    start: int
    """Time of its first message, ns."""
    end: int
    offset: int
    length: int
    """Of its record."""
    indexes: Mapping[int, int]
    """By channel, where the index of its messages is."""
    indexes_length: int
    compression: str
    compressed: int
    size: int
    """Of its records, before they were compressed."""

    def encode(self) -> bytes:
        """Return the record; `ChunkIndex` of the package takes a call for each number."""
        flat = [number for pair in self.indexes.items() for number in pair]
        places = struct.pack("<" + "HQ" * len(self.indexes), *flat)
        name = self.compression.encode()
        body = b"".join(
            (
                _PLACE.pack(self.start, self.end, self.offset, self.length, len(places)),
                places,
                struct.pack("<QI", self.indexes_length, len(name)),
                name,
                struct.pack("<QQ", self.compressed, self.size),
            )
        )
        return _HEAD.pack(Opcode.CHUNK_INDEX, len(body)) + body


class Summary:
    """Collects it while a file is written, or read again."""

    def __init__(self) -> None:
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self.counts: dict[int, int] = defaultdict(int)
        """Messages of each channel."""
        self.metadata: list[MetadataIndex] = []
        self._chunks: list[bytes] = []
        self.start: int | None = None
        """Time of the first message, ns; None: there is none."""
        self.end = 0

    @property
    def messages(self) -> int:
        """How many there are."""
        return sum(self.counts.values())

    def add(self, chunk: ChunkPlace) -> None:
        """Take in a chunk."""
        self._chunks.append(chunk.encode())
        self.start = chunk.start if self.start is None else min(self.start, chunk.start)
        self.end = max(self.end, chunk.end)

    def encode(self, offset: int) -> bytes:
        """Return all that follows the data of a file, which ends at `offset`."""
        out = RecordBuilder()
        DataEnd(0).write(out)
        end = out.end()
        summary = offset + len(end)
        for record in (*self.schemas.values(), *self.channels.values()):
            record.write(out)
        Statistics(
            attachment_count=0,
            channel_count=len(self.channels),
            channel_message_counts=dict(self.counts),
            chunk_count=len(self._chunks),
            message_count=self.messages,
            message_end_time=self.end,
            message_start_time=self.start or 0,
            metadata_count=len(self.metadata),
            schema_count=len(self.schemas),
        ).write(out)
        for index in self.metadata:
            index.write(out)
        index = b"".join((out.end(), *self._chunks))
        footer = _FOOTER.pack(Opcode.FOOTER, 20, summary, 0)
        checksum = zlib.crc32(footer, zlib.crc32(index))
        return b"".join((end, index, footer, checksum.to_bytes(4, "little"), MCAP0_MAGIC))
