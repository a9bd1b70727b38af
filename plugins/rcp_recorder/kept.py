"""A complete file, as its last bytes and its metadata describe it."""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import IO

import msgspec
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Footer, Metadata, MetadataIndex, Statistics
from mcap.writer import MCAP0_MAGIC

from rcp_recordings.names import FACTS, KIND, NATIVE, PATH, RECOVERY, SAMPLE

__all__ = ["INCIDENT", "PIN", "Kept", "read"]

PIN = ".pin"
"""What is appended to the name of a file for the mark that it is pinned."""
INCIDENT = "incident"
_HEAD = struct.Struct("<BQ")
_FOOTER = _HEAD.size + 20 + len(MCAP0_MAGIC)  # bytes


class Kept(msgspec.Struct, frozen=True, kw_only=True):
    """A complete file."""

    file: str
    name: str
    tenant: str
    start: int
    end: int
    bytes: int
    messages: int
    samples: frozenset[str]
    """Resources with samples."""
    others: frozenset[str]
    """Resources with nothing but commands and events."""
    recovered: bool
    pinned: bool
    reason: str | None = None
    robot: str | None = None
    at: str | None = None
    """Of an incident: when it happened."""

    @property
    def order(self) -> tuple[bool, int]:
        """By what files leave: incidents after all others, the oldest first."""
        return self.name == INCIDENT, self.end


def read(path: Path) -> Kept | None:
    """Describe a file; None: it is not one of ours.

    The places of its chunks, which are most of its index, are passed over: thousands of them would keep
    the event loop waiting.
    """
    channels: list[Channel] = []
    metadata: dict[str, dict[str, str]] = {}
    numbers: Statistics | None = None
    with path.open("rb") as file:
        for opcode, record in _summary(file):
            stream = ReadDataStream(BytesIO(record))
            if opcode == Opcode.CHANNEL:
                channels.append(Channel.read(stream))
            elif opcode == Opcode.STATISTICS:
                numbers = Statistics.read(stream)
            elif opcode == Opcode.METADATA_INDEX:
                file.seek(MetadataIndex.read(stream).offset + _HEAD.size)
                found = Metadata.read(ReadDataStream(file))
                metadata[found.name] = found.metadata
    facts = metadata.get(FACTS)
    if numbers is None or facts is None:
        return None
    paths: dict[bool, set[str]] = {True: set(), False: set()}
    for channel in channels:
        if KIND in channel.metadata and PATH in channel.metadata:
            is_read = channel.metadata[KIND] in (SAMPLE, NATIVE)
            paths[is_read].add(channel.metadata[PATH])
    return Kept(
        file=path.name,
        name=facts["recording"],
        tenant=facts["tenant"],
        start=numbers.message_start_time,
        end=numbers.message_end_time,
        bytes=path.stat().st_size,
        messages=numbers.message_count,
        samples=frozenset(paths[True]),
        others=frozenset(paths[False]),
        recovered=RECOVERY in metadata,
        pinned=path.with_name(f"{path.name}{PIN}").exists(),
        reason=facts.get("reason"),
        robot=facts.get("robot"),
        at=facts.get("at"),
    )


def _summary(file: IO[bytes]) -> Iterator[tuple[int, bytes]]:
    """Iterate over the records of the summary but for the places of chunks.

    :raises ValueError: the file has no summary.
    """
    size = file.seek(0, os.SEEK_END)
    file.seek(max(0, size - _FOOTER))
    end = file.read(_FOOTER)
    if len(end) < _FOOTER or not end.endswith(MCAP0_MAGIC) or end[0] != Opcode.FOOTER:
        raise ValueError("it does not end as a recording")
    start = Footer.read(ReadDataStream(BytesIO(end[_HEAD.size :]))).summary_start
    file.seek(start)
    data, at = file.read(size - _FOOTER - start) if start else b"", 0
    while at < len(data):
        opcode, length = _HEAD.unpack_from(data, at)
        at += _HEAD.size
        if opcode != Opcode.CHUNK_INDEX:
            yield opcode, data[at : at + length]
        at += length
