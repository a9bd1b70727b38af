"""Messages of recordings in the order of time: only chunks that have some are read, one at a time.

A file that is being written has no index yet; it is found in the heads of its records.
"""

from __future__ import annotations

import heapq
import os
import struct
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack
from io import BytesIO
from pathlib import Path
from typing import IO, NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Channel, Chunk, Schema
from mcap.stream_reader import get_chunk_data_stream
from mcap.writer import MCAP0_MAGIC

from rcp_recordings.names import ACTIVE

__all__ = [
    "Damaged",
    "Gap",
    "Record",
    "Recording",
    "Track",
    "messages",
    "open_recordings",
    "records",
]

_HEAD = struct.Struct("<BQ")
_TIMES = struct.Struct("<QQ")
_INDEX = struct.Struct("<BQHI")
_ENTRY = struct.Struct("<QQ")
_MESSAGE = struct.Struct("<BQHIQQ")
_FOOTER = struct.Struct("<BQQQI8s")
_PIECE = 1 << 20  # bytes read at once for a checksum
_UNSUMMED = 12  # bytes at the end of a file that the checksum of its index is not of


class Damaged(McapError):
    """A part of a file does not have what was written."""

    def __init__(self, file: IO[bytes], part: str, reason: object) -> None:
        name = Path(str(getattr(file, "name", "the recording"))).name
        super().__init__(f"{name}: {part} is damaged: {reason}")


class Track(NamedTuple):
    """A channel with its schema."""

    channel: Channel
    schema: Schema | None

    @property
    def facts(self) -> Mapping[str, str]:
        """The channel's metadata."""
        return self.channel.metadata


class Record(NamedTuple):
    """A message."""

    log_time: int
    publish_time: int
    seq: int
    track: Track
    data: bytes


class Gap(NamedTuple):
    """A part that cannot be read."""

    start: int
    """Time of its first message, ns."""
    end: int
    """Time of its last message, ns."""
    error: Exception


class _Chunk(NamedTuple):
    start: int
    end: int
    offset: int
    indexes: dict[int, int]
    """Where the index of each channel is."""


class Recording:
    """One open file."""

    def __init__(self, file: IO[bytes], size: int | None) -> None:
        """Read the index; `size` limits a file that is being written to what is complete."""
        self._file = file
        self.tracks: dict[int, Track] = {}
        self.chunks: list[_Chunk] = []
        if size is None:
            self._read_summary()
        else:
            self._search(size)

    @property
    def start(self) -> int:
        """Time of the first message, ns."""
        return min((chunk.start for chunk in self.chunks), default=0)

    @property
    def end(self) -> int:
        """Time of the last message, ns."""
        return max((chunk.end for chunk in self.chunks), default=0)

    def keep(self, wanted: Callable[[Track], bool], start: int, end: int) -> None:
        """Forget what is not wanted of the index: that of many files would be long."""
        self.tracks = {number: track for number, track in self.tracks.items() if wanted(track)}
        self.chunks = [
            chunk._replace(indexes=indexes)
            for chunk in self.chunks
            if chunk.start < end
            and chunk.end >= start
            and (indexes := {n: at for n, at in chunk.indexes.items() if n in self.tracks})
        ]

    def span(self, wanted: Mapping[int, Track]) -> tuple[int, int]:
        """Return the times of the first and of the last message of some channels, ns."""
        chunks = [one for one in self.chunks if not wanted.keys().isdisjoint(one.indexes)]
        if not chunks:
            return self.start, self.start
        first, last = (self._entries(chunk, wanted) for chunk in (chunks[0], chunks[-1]))
        return min(time for time, *_ in first), max(time for time, *_ in last)

    def _entries(
        self, chunk: _Chunk, wanted: Mapping[int, Track]
    ) -> Iterator[tuple[int, int, Track]]:
        """Iterate over the times and places of the wanted messages of a chunk."""
        for number, offset in chunk.indexes.items():
            if (track := wanted.get(number)) is None:
                continue
            self._file.seek(offset)
            head = self._file.read(_INDEX.size)
            opcode, length, of, size = _INDEX.unpack(head) if len(head) == _INDEX.size else (0,) * 4
            is_whole = length == size + _INDEX.size - _HEAD.size and size % _ENTRY.size == 0
            if opcode != Opcode.MESSAGE_INDEX or of != number or not is_whole:
                raise self._damaged(chunk.offset, "its index is not there")
            for time, place in _ENTRY.iter_unpack(self._file.read(size)):
                if not chunk.start <= time <= chunk.end:
                    raise self._damaged(chunk.offset, "its index has another time")
                yield time, place, track

    def _read_summary(self) -> None:
        try:
            _check_index(self._file)
            summary = SeekingReader(self._file).get_summary()
        except Exception as error:  # parsers raise what they like
            raise Damaged(self._file, "the index at its end", error) from error
        if summary is None:
            self._search(os.fstat(self._file.fileno()).st_size)
            return
        for channel in summary.channels.values():
            self.tracks[channel.id] = Track(channel, summary.schemas.get(channel.schema_id))
        self.chunks = [
            _Chunk(
                one.message_start_time,
                one.message_end_time,
                one.chunk_start_offset,
                one.message_index_offsets,
            )
            for one in summary.chunk_indexes
        ]

    def _search(self, size: int) -> None:
        """Find chunks by the heads of records; open only those in which a channel begins."""
        offset, unread = len(MCAP0_MAGIC), list[int]()
        schemas: dict[int, Schema] = {}
        while offset + _HEAD.size <= size:
            self._file.seek(offset)
            opcode, length = _HEAD.unpack(self._file.read(_HEAD.size))
            if offset + _HEAD.size + length > size:
                return
            if opcode == Opcode.CHUNK:
                start, end = _TIMES.unpack(self._file.read(_TIMES.size))
                self.chunks.append(_Chunk(start, end, offset, {}))
                unread.append(offset)
            elif opcode == Opcode.MESSAGE_INDEX:
                (number,) = struct.unpack("<H", self._file.read(2))
                self.chunks[-1].indexes[number] = offset
                if number not in self.tracks:
                    for place in unread:
                        self._learn(place, schemas)
                    unread.clear()
            elif opcode == Opcode.DATA_END:
                return
            offset += _HEAD.size + length

    def _learn(self, offset: int, schemas: dict[int, Schema]) -> None:
        data, at = self._chunk(offset), 0
        while at < len(data):
            opcode, length = _HEAD.unpack_from(data, at)
            at += _HEAD.size
            if opcode == Opcode.SCHEMA:
                schema = Schema.read(ReadDataStream(BytesIO(data[at : at + length])))
                schemas[schema.id] = schema
            elif opcode == Opcode.CHANNEL:
                channel = Channel.read(ReadDataStream(BytesIO(data[at : at + length])))
                self.tracks[channel.id] = Track(channel, schemas.get(channel.schema_id))
            at += length

    def _chunk(self, offset: int) -> bytes:
        self._file.seek(offset)
        try:
            if self._file.read(_HEAD.size)[:1] != bytes((Opcode.CHUNK,)):
                raise ValueError("it is not there")
            chunk = Chunk.read(ReadDataStream(self._file))
            stream, size = get_chunk_data_stream(chunk, validate_crc=True)
            return stream.read(size)
        except Exception as error:  # decompressors and parsers raise what they like
            raise self._damaged(offset, error) from error

    def _damaged(self, offset: int, reason: object) -> Damaged:
        return Damaged(self._file, f"the chunk at byte {offset}", reason)

    def read(
        self, chunk: _Chunk, wanted: Mapping[int, Track], start: int, end: int
    ) -> Iterator[Record]:
        """Iterate over the wanted messages of a chunk in a span of time, each channel in order."""
        found = self._entries(chunk, wanted)
        places = [one for one in found if start <= one[0] < end]
        if not places:
            return
        data = self._chunk(chunk.offset)
        for time, place, track in sorted(places, key=lambda found: found[1]):
            stop = place + _MESSAGE.size
            if stop > len(data):
                raise self._damaged(chunk.offset, "its index leads beyond it")
            opcode, length, of, seq, log_time, publish_time = _MESSAGE.unpack_from(data, place)
            if (opcode, of, log_time) != (Opcode.MESSAGE, track.channel.id, time):
                raise self._damaged(chunk.offset, "its index leads to another message")
            body = data[stop : place + _HEAD.size + length]
            yield Record(log_time, publish_time, seq, track, body)


def _check_index(file: IO[bytes]) -> None:
    """Check that a file ends as a recording, and has the index that was written.

    :raises ValueError: it has not.
    """
    size = file.seek(0, os.SEEK_END)
    file.seek(max(0, size - _FOOTER.size))
    end = file.read(_FOOTER.size)
    if len(end) < _FOOTER.size or not end.endswith(MCAP0_MAGIC) or end[0] != Opcode.FOOTER:
        raise ValueError("the file is cut off, or no recording")
    *_, start, _, checksum, _ = _FOOTER.unpack(end)
    if start and checksum and _checksum(file, start, size - _UNSUMMED) != checksum:
        raise ValueError("it has another checksum")
    file.seek(0)


def _checksum(file: IO[bytes], start: int, end: int) -> int:
    """Return the CRC-32 of a part of a file, of which a damaged one may say that it is nearly all of it."""
    found = 0
    file.seek(start)
    while (left := end - file.tell()) > 0 and (data := file.read(min(left, _PIECE))):
        found = zlib.crc32(data, found)
    return found


def open_recordings(
    files: Iterable[tuple[Path, int | None]], stack: ExitStack
) -> Iterator[Recording]:
    """Open files, of which some may have been completed or deleted since they were listed."""
    for path, size in files:
        for place, limit in ((path, size), (path.with_name(path.name.removesuffix(ACTIVE)), None)):
            if place.exists():
                yield Recording(stack.enter_context(place.open("rb")), limit)
                break


def messages(
    recordings: Iterable[Recording],
    wanted: Callable[[Track], bool],
    start: int = 0,
    end: int = 2**64 - 1,
) -> Iterator[Record]:
    """Iterate over messages in the order of `log_time`, from `start` until before `end`.

    What several recordings have of a resource is returned once. What cannot be read ends it with
    the error of that, after all that is before it.
    """
    for one in records(recordings, wanted, start, end):
        if isinstance(one, Gap):
            raise one.error
        yield one


def records(
    recordings: Iterable[Recording],
    wanted: Callable[[Track], bool],
    start: int = 0,
    end: int = 2**64 - 1,
) -> Iterator[Record | Gap]:
    """Iterate as `messages`, with a gap in the place of what cannot be read.

    Parts between which nothing can be read are one gap.
    """
    waiting: list[tuple[int, int, Record]] = []
    last: dict[str, tuple[int, int, bytes]] = {}
    gap: Gap | None = None
    count = 0
    for chunk, recording, tracks in _chunks(recordings, wanted, start, end):
        if gap is not None and waiting and waiting[0][0] < chunk.start:
            yield gap
            gap = None
        while waiting and waiting[0][0] < chunk.start:
            yield from _once(heapq.heappop(waiting)[2], last)
        try:
            for record in recording.read(chunk, tracks, start, end):
                count += 1
                heapq.heappush(waiting, (record.log_time, count, record))
        except Exception as error:  # decompressors and parsers raise what they like
            first = Gap(max(chunk.start, start), chunk.end, error) if gap is None else gap
            gap = first._replace(end=max(first.end, chunk.end))
    if gap is not None:
        yield gap
    while waiting:
        yield from _once(heapq.heappop(waiting)[2], last)


def _chunks(
    recordings: Iterable[Recording], wanted: Callable[[Track], bool], start: int, end: int
) -> list[tuple[_Chunk, Recording, dict[int, Track]]]:
    """List what has to be read, in the order of time, each with the channels that are wanted."""
    chunks: list[tuple[_Chunk, Recording, dict[int, Track]]] = []
    for recording in recordings:
        tracks = {number: track for number, track in recording.tracks.items() if wanted(track)}
        chunks.extend(
            (chunk, recording, tracks)
            for chunk in recording.chunks
            if chunk.start < end
            and chunk.end >= start
            and not tracks.keys().isdisjoint(chunk.indexes)
        )
    return sorted(chunks, key=lambda found: found[0].start)


def _once(record: Record, last: dict[str, tuple[int, int, bytes]]) -> Iterator[Record]:
    topic = record.track.channel.topic
    key = (record.publish_time, record.seq, record.data)
    if last.get(topic) != key:
        last[topic] = key
        yield record
