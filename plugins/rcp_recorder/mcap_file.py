"""One open file: used by the writer's thread only."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path
from typing import IO, NamedTuple

from rcp_kernel.contract.version import gateway_version
from rcp_recorder.channels import Channel, Message, Stream
from rcp_recorder.mcap_writer import McapWriter
from rcp_recordings.names import FACTS, KIND, NATIVE, PATH, ROBOT, SAMPLE

__all__ = ["OpenFile", "Progress"]


class Progress(NamedTuple):
    """What has been written so far."""

    start: int
    bytes: int
    messages: int
    samples: frozenset[str]
    """Resources with samples."""
    others: frozenset[str]
    """Resources with commands and events."""


class OpenFile:
    """Writes messages; everything until the last flush can be read, whatever happens."""

    def __init__(self, path: Path, stream: Stream, opened: float) -> None:
        self.path = path
        self.stream = stream
        self.opened = opened
        self.flushed = opened
        self.start = 0
        self.end = 0
        self.messages = 0
        self.progress: Progress | None = None
        """What is flushed, for other threads; replaced as a whole."""
        self._samples: set[str] = set()
        self._others: set[str] = set()
        self._ids: dict[Channel, int] = {}
        self._schemas: dict[tuple[str, bytes], int] = {}
        self._file: IO[bytes] = path.open("xb")
        self._writer = McapWriter(self._file, f"rcp-gateway {gateway_version()}")
        self._writer.add_metadata(FACTS, {"tenant": stream.tenant, **stream.facts})
        for robot, facts in stream.robots.items():
            self._writer.add_metadata(ROBOT, {"path": robot, **facts})

    @property
    def size(self) -> int:
        """Bytes written so far."""
        return self._file.tell()

    def add(self, message: Message) -> None:
        """Write a message; it is safe after the next `flush`."""
        channel, log_time, publish_time, seq, data = message
        number = self._ids.get(channel)
        if number is None:
            number = self._register(channel)
        if not self.messages:
            self.start = log_time
        self.messages += 1
        self.end = log_time
        # The format has unsigned numbers of 64 and 32 bits.
        self._writer.add(number, max(0, log_time), max(0, publish_time), seq & 0xFFFFFFFF, data)

    def flush(self, now: float) -> None:
        """Hand everything to the operating system."""
        self._writer.flush()
        self.flushed = now
        samples, others = frozenset(self._samples), frozenset(self._others)
        self.progress = Progress(self.start, self.size, self.messages, samples, others)

    def finish(self) -> Path:
        """Write the index, and give the file its final name."""
        self._writer.finish()
        self._file.flush()
        os.fsync(self._file.fileno())
        self._file.close()
        return self.path.rename(self.path.with_suffix(""))

    def abandon(self) -> None:
        """Close it as it is: there is no space for more."""
        with contextlib.suppress(OSError):
            self._file.close()

    def _register(self, channel: Channel) -> int:
        key = (channel.schema_name, channel.schema)
        schema = self._schemas.get(key)
        if schema is None:
            schema = self._schemas[key] = self._writer.register_schema(
                channel.schema_name, channel.schema_encoding, channel.schema
            )
        facts = {KIND: channel.kind, **channel.facts}
        if channel.path is not None:
            facts[PATH] = channel.path
            is_read = channel.kind in (SAMPLE, NATIVE)
            (self._samples if is_read else self._others).add(channel.path)
        number = self._ids[channel] = self._writer.register_channel(
            channel.topic, channel.encoding, schema, facts
        )
        return number
