"""What a query returns of one resource: its samples, one of each interval, or a summary of each."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

from rcp_recordings.columns import numbers, part
from rcp_recordings.names import PATH
from rcp_recordings.reading import Record
from rcp_recordings.values import Decode, decoder

__all__ = ["Interval", "Row", "intervals", "samples"]


class Row(NamedTuple):
    """One sample."""

    received: int
    """ns since the epoch, as all times."""
    timestamp: int
    seq: int
    value: Any
    path: str


class Interval(NamedTuple):
    """The numbers of one interval, by the names of their fields."""

    start: int
    samples: int
    """How many are in it."""
    least: dict[str, float]
    most: dict[str, float]
    mean: dict[str, float]


class _Decoders:
    """Decoders of channels: a resource may have several, in several files."""

    def __init__(self) -> None:
        self._known: dict[int, Decode] = {}

    def value(self, record: Record) -> Any:
        key = id(record.track.channel)  # which its recording keeps
        decode = self._known.get(key)
        if decode is None:
            decode = self._known[key] = decoder(record.track)
        return decode(record.data)


def samples(
    records: Iterable[Record], fields: tuple[str, ...], every: int | None = None
) -> Iterator[Row]:
    """Iterate over samples; with `every` (ns), the first of each resource in each interval."""
    decoders, due = _Decoders(), dict[str, int]()
    for record in records:
        path = record.track.facts[PATH]
        if every is not None:
            place = record.log_time // every
            if place == due.get(path):
                continue
            due[path] = place
        value = decoders.value(record)
        if fields:
            value = _projected(value, fields)
        yield Row(record.log_time, record.publish_time, record.seq, value, path)


def intervals(records: Iterator[Record], fields: tuple[str, ...], every: int) -> Iterator[Interval]:
    """Iterate over intervals of `every` ns that have samples."""
    decoders = _Decoders()
    place, count = -1, 0
    found: dict[str, list[float]] = {}  # least, most, sum, count
    for record in records:
        here = record.log_time // every
        if here != place:
            if count:
                yield _summary(place * every, count, found)
            place, count, found = here, 0, {}
        count += 1
        value = decoders.value(record)
        if fields:
            value = _projected(value, fields)
        for name, number in numbers(value):
            known = found.get(name)
            if known is None:
                found[name] = [number, number, number, 1]
                continue
            if number < known[0]:
                known[0] = number
            elif number > known[1]:
                known[1] = number
            known[2] += number
            known[3] += 1
    if count:
        yield _summary(place * every, count, found)


def _summary(start: int, count: int, found: dict[str, list[float]]) -> Interval:
    return Interval(
        start,
        count,
        {name: one[0] for name, one in found.items()},
        {name: one[1] for name, one in found.items()},
        {name: one[2] / one[3] for name, one in found.items()},
    )


def _projected(value: Any, fields: tuple[str, ...]) -> Any:
    out: dict[str, Any] = {}
    for name in fields:
        found = part(value, name)
        if found is None:
            continue
        place = out
        *names, last = name.split(".")
        for key in names:
            place = place.setdefault(key, {})
        place[last] = found
    return out
