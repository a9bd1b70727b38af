"""Reads recordings as any other program does: with the stock reader."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from mcap.reader import make_reader

from rcp_recorder.channels import Channel, Message, Stream
from rcp_recorder.runs import ALWAYS

__all__ = ["CHANNEL", "Line", "lines", "message", "stream", "topics"]

CHANNEL = Channel(
    topic="/tenant/alpha/sensor/pose", kind="sample", path="/tenant/alpha/sensor/pose"
)


class Line(NamedTuple):
    topic: str
    log_time: int
    publish_time: int
    value: Any


def lines(*files: Path) -> list[Line]:
    return sorted((line for file in files for line in _lines(file)), key=lambda line: line.log_time)


def _lines(file: Path) -> Iterator[Line]:
    with file.open("rb") as data:
        for schema, channel, found in make_reader(data, validate_crcs=True).iter_messages():
            assert schema is not None
            assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
            json.loads(schema.data)
            value = json.loads(found.data)
            yield Line(channel.topic, found.log_time, found.publish_time, value)


def topics(*files: Path) -> set[str]:
    return {line.topic for line in lines(*files)}


def stream(name: str = ALWAYS) -> Stream:
    return Stream(name, "alpha", {"recording": name})


def message(number: int, time: int | None = None, size: int = 0) -> Message:
    data = json.dumps({"number": number, "filler": "x" * size}).encode()
    return Message(CHANNEL, number if time is None else time, number, number, data)
