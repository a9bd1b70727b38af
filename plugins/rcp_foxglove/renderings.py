"""How samples are written: in a robot's own bytes, as JSON, or as a well-known Foxglove type.

The time of a message is that of its receipt, or the recording's where it is replayed. Tails are shared by all subscribers of a channel, and renderings by those with equal numbers.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from functools import lru_cache
from typing import Any

import msgspec

from rcp_foxglove.frames import message_head
from rcp_foxglove_types import with_fields
from rcp_gateway.api import Rendering, Sample
from rcp_kernel.errors import Overrun, RcpError
from rcp_kernel.values import Encoding

__all__ = [
    "Tail",
    "as_json",
    "as_serialised",
    "as_well_known",
    "of_parameter",
    "of_subscription",
    "replayed",
]

Tail = Callable[[Sample], bytes]
_JSON = Encoding.JSON
_time = struct.Struct("<Q").pack
_TIME_SIZE, _LAST_TIME = 8, 2**64 - 1


def as_json(sample: Sample) -> bytes:
    """Write a value as JSON."""
    return _time(sample.received) + sample.encoded(_JSON)


def as_serialised(sample: Sample) -> bytes:
    """Write a value in the robot's own bytes.

    :raises Overrun: it has none.
    """
    native = sample.native
    if native is None:
        raise Overrun(f"a sample of {sample.entry.path} has no serialised form")
    return _time(sample.received) + native.data


@lru_cache(maxsize=64)
def replayed(tail: Tail) -> Tail:
    """Return what writes the samples of a recording, at the times that they had."""

    def at_its_time(sample: Sample) -> bytes:
        moment = min(max(sample.timestamp, 0), _LAST_TIME)
        return _time(moment) + memoryview(tail(sample))[_TIME_SIZE:]

    return at_its_time


@lru_cache(maxsize=64)
def as_well_known(convert: Callable[[Any, int], dict[str, Any]]) -> Tail:
    """Return what writes values as a well-known type; `convert` gets a value and its time in ns."""

    def tail(sample: Sample) -> bytes:
        value = with_fields(sample.value)
        try:
            data = msgspec.json.encode(convert(value, sample.timestamp))
        except (AttributeError, TypeError, ValueError, RcpError) as error:  # a part is missing
            raise Overrun(f"no well-known form of {sample.entry.path}: {error}") from error
        return _time(sample.received) + data

    return tail


@lru_cache(maxsize=4096)
def of_subscription(number: int, tail: Tail, write_interval: float) -> Rendering:
    """Return the messages of a subscription."""
    return Rendering(message_head(number), tail, write_interval=write_interval)


@lru_cache(maxsize=4096)
def of_parameter(name: str, mark: str | None) -> Rendering:
    """Return the updates of a parameter, with the mark of its type."""
    head = b'{"op":"parameterValues","parameters":[{"name":' + msgspec.json.encode(name)
    if mark is not None:
        head += b',"type":' + msgspec.json.encode(mark)
    return Rendering(head + b',"value":', _parameter_tail)


def _parameter_tail(sample: Sample) -> bytes:
    return sample.encoded(_JSON) + b"}]}"
