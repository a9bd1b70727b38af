"""The last samples before a moment: what was known then."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from rcp_recordings.names import PATH
from rcp_recordings.reading import Record, Recording, Track

__all__ = ["Lead", "Room", "last_before"]

_Known = dict[tuple[int, int, bytes], Record]


class Room:
    """Bytes for samples that are offered by their rank, the newest of each resource first.

    One that is too long is left out, and all that is older of its resource: what is there has no gaps.
    """

    def __init__(self, size: int) -> None:
        self._left = size
        self.left_out: set[str] = set()
        """Resources of which something is missing."""

    def takes(self, path: str, size: int) -> bool:
        """Return whether a sample of a resource fits in."""
        if path in self.left_out:
            return False
        if size > self._left:
            self.left_out.add(path)
            return False
        self._left -= size
        return True


class Lead(NamedTuple):
    """What was found."""

    records: list[Record]
    """By rank: the newest of each resource, then the one before it of each, and so on."""
    left_out: set[str]
    """Resources of which some did not fit."""


class _Found:
    """What was found until now, of which only so much is kept that it fits into the room."""

    def __init__(self, count: int, size: int) -> None:
        self._count = count
        self._size = size
        self._held = 0
        self._known: dict[str, _Known] = {}
        self._oldest: dict[str, int] = {}
        """Of the resources that have all they may, the time before which nothing is wanted."""
        self._gaps: dict[str, int] = {}
        """Of those that had to leave one out, the time of the newest one left out."""

    def wants(self, path: str, until: int) -> bool:
        """Return whether something of a resource that ends at a time may be missing."""
        return until > max(self._oldest.get(path, 0), self._gaps.get(path, -1))

    def add(self, record: Record) -> None:
        """Take in a record."""
        path = record.track.facts[PATH]
        if record.log_time <= self._gaps.get(path, -1):
            return
        known = self._known.setdefault(path, {})
        key = record.publish_time, record.seq, record.data
        if key not in known:
            known[key] = record
            self._held += len(record.data)

    def trim(self, paths: Iterable[str]) -> None:
        """Forget what is too old of some resources, or too much of all."""
        for path in paths:
            known = self._known.get(path, {})
            if len(known) >= self._count:
                order = sorted(known, key=lambda key: known[key].log_time)
                for key in order[: -self._count]:
                    self._held -= len(known.pop(key).data)
                self._oldest[path] = known[order[-self._count]].log_time
        if self._held > self._size:
            self._squeeze()

    def _squeeze(self) -> None:
        room, kept = Room(self._size), dict[str, _Known]()
        for path, record in self._ranked():
            if room.takes(path, len(record.data)):
                key = record.publish_time, record.seq, record.data
                kept.setdefault(path, {})[key] = record
            else:
                self._gaps[path] = max(record.log_time, self._gaps.get(path, -1))
        self._known = kept
        self._held = sum(len(key[2]) for known in kept.values() for key in known)

    def _ranked(self) -> list[tuple[str, Record]]:
        ranked = [
            (place, path, record)
            for path, known in self._known.items()
            for place, record in enumerate(_newest_first(known))
        ]
        ranked.sort(key=lambda one: one[0])
        return [(path, record) for _, path, record in ranked]

    def lead(self) -> Lead:
        """Return what there is."""
        return Lead([record for _, record in self._ranked()], set(self._gaps))


def last_before(recordings: Iterable[Recording], moment: int, count: int, size: int) -> Lead:
    """Return the last `count` messages of each resource before a moment (ns), `size` bytes of all.

    The recordings keep only what is wanted (`Recording.keep`). Chunks are read from the newest on, and only those that have what is still missing.
    """
    found = _Found(count, size)
    chunks = [
        (chunk, recording)
        for recording in recordings
        for chunk in recording.chunks
        if chunk.start < moment
    ]
    chunks.sort(key=lambda one: one[0].end, reverse=True)
    for chunk, recording in chunks:
        tracks = recording.tracks
        missing = {
            number: tracks[number]
            for number in chunk.indexes
            if found.wants(_path(tracks[number]), chunk.end)
        }
        for record in recording.read(chunk, missing, 0, moment):
            found.add(record)
        found.trim({_path(track) for track in missing.values()})
    return found.lead()


def _path(track: Track) -> str:
    return track.facts[PATH]


def _newest_first(known: _Known) -> list[Record]:
    return sorted(known.values(), key=lambda record: record.log_time, reverse=True)
