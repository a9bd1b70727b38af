"""Plays messages by the recording's time. Files are read on a thread, a little ahead."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from itertools import islice
from typing import Any, TypeVar

import structlog

from rcp_protocol.timeouts import timeout
from rcp_recordings.reading import Gap, Record, Recording, Track, records

__all__ = ["Player"]

log = structlog.get_logger("rcp.replay")
_AHEAD = 256  # records read at a time
_TURN = 64  # records published before others have the event loop
_BACK = 64  # chunks searched for what was the case at a moment
_NS = 1_000_000_000
_SHORTEST = 0.05  # s that one round of a loop takes at least, however short the recording is
_Read = TypeVar("_Read", bound=Record | Gap)


class Player:
    """Publishes records when they are due; for the event loop's thread."""

    def __init__(
        self,
        recordings: list[Recording],
        wanted: Callable[[Track], bool],
        publish: Callable[[Record], None],
        *,
        speed: float,
        loop: bool,
        paused: bool,
    ) -> None:
        self._recordings = recordings
        self._wanted = wanted
        self._publish = publish
        self.start = min((one.start for one in recordings if one.chunks), default=0)
        self.end = max((one.end for one in recordings), default=0)
        self.speed = speed
        self.loop = loop
        self.paused = paused
        self.published = 0
        self.ended = False
        self.jumps = 0
        """How often its time was set: by a seek, or to begin again."""
        self.on_jump: Callable[[], None] = lambda: None
        """Called when its time was set, before anything of then is published, and at the end."""
        self.on_gap: Callable[[Gap], None] = lambda _: None
        """Called when it has paused where a part cannot be read; playing on passes over that."""
        self.on_doubt: Callable[[Gap], None] = lambda _: None
        """Called after a seek, if what was the case then may be in a part that cannot be read."""
        self._position = self.start
        self._since: float | None = None
        """Time of the loop at `_position`, while the recording's time goes on."""
        self._records: Iterator[Record | Gap] = iter(())
        self._ready: deque[Record | Gap] = deque()
        self._changed = asyncio.Event()
        self._reader = ThreadPoolExecutor(1, "replay")
        """One reads at a time: a seek that is cancelled has its thread go on for a moment."""
        self._turn = asyncio.Lock()
        """One who reads, publishes or moves at a time."""
        self._rewind(self.start)

    @property
    def position(self) -> int:
        """The recording's time, ns."""
        if self._since is None:
            return self._position
        passed = asyncio.get_running_loop().time() - self._since
        return min(self.end, self._position + int(passed * self.speed * _NS))

    def change(
        self, *, paused: bool | None = None, speed: float | None = None, loop: bool | None = None
    ) -> None:
        """Change how it is played, from now on."""
        self._hold()
        if speed is not None:
            self.speed = speed
        if loop is not None:
            self.loop = loop
        if paused is not None:
            self.paused = paused
        self._changed.set()

    async def seek(self, moment: int) -> None:
        """Go to a moment, and publish what was the case then."""
        async with self._turn:
            moment = min(max(moment, self.start), self.end)
            self._hold()
            self._rewind(moment)
            self.on_jump()
            found = await self._read_by(self._before, moment)
            for record in found:
                if isinstance(record, Record):
                    self._send(record)
            gap = next((one for one in found if isinstance(one, Gap)), None)
            if gap is not None:
                self.on_doubt(gap)
        self._changed.set()

    async def step(self, count: int) -> None:
        """Publish the next records, and pause."""
        self.change(paused=True)
        async with self._turn:
            for _ in range(count):
                record = await self._next()
                if record is None:
                    self.ended = True
                    break
                if isinstance(record, Gap):
                    self._pause_at(record)
                    break
                self._send(record)
                self._position = record.log_time
        self._changed.set()

    async def play_to(self, moment: int) -> None:
        """Publish everything up to a moment at once, and pause: for tests, which need not wait.

        :raises Exception: a part cannot be read; what is before it was published.
        """
        self.change(paused=True)
        async with self._turn:
            while (record := await self._next()) is not None:
                if isinstance(record, Gap):
                    self._pause_at(record)
                    raise record.error
                if record.log_time > moment:
                    self._ready.appendleft(record)
                    break
                self._send(record)
                if self.published % _TURN == 0:
                    await asyncio.sleep(0)
            self.ended = record is None
            self._position = min(max(moment, self._position), self.end)
        self._changed.set()

    async def run(self) -> None:
        """Play until it is cancelled."""
        loop = asyncio.get_running_loop()
        while True:
            self._changed.clear()
            wait: float | None = None
            if not self.paused and not self.ended:
                if self._since is None:
                    self._since = loop.time()
                wait = await self._play_due()
            elif self._since is not None:
                self._hold()
            if wait == 0:
                await asyncio.sleep(0)
                continue
            try:
                async with timeout(wait):
                    await self._changed.wait()
            except TimeoutError:
                continue

    async def _play_due(self) -> float | None:
        """Publish what is due; return the seconds until more is, None if nothing is left."""
        async with self._turn:
            for _ in range(_TURN):
                record = await self._next()
                if record is None:
                    return self._finish()
                due = _time(record) - self.position
                if due > 0 and not self.paused:
                    self._ready.appendleft(record)
                    return due / _NS / self.speed
                if self.paused:
                    self._ready.appendleft(record)
                    return 0
                if isinstance(record, Gap):
                    self._pause_at(record)
                    return 0
                self._send(record)
        return 0

    def _pause_at(self, gap: Gap) -> None:
        self._since = None
        self._position = gap.start
        self.paused = True
        log.warning("replay_part_unreadable", error=str(gap.error))
        self.on_gap(gap)

    def _finish(self) -> float | None:
        """Begin again, or end; return the seconds until it goes on."""
        nothing = self._from == self.start and self.published == self._already
        if not self.loop or self.end <= self.start or nothing:
            self._hold()
            self._position = self.end
            self.ended = True
            self.on_jump()
            return None
        took = (self.end - self._from) / _NS / self.speed
        self._since = None
        self._rewind(self.start)
        self.on_jump()
        return max(0.0, _SHORTEST - took)

    def _send(self, record: Record) -> None:
        self.published += 1
        self._publish(record)

    def _hold(self) -> None:
        """Let the recording's time stand still until it goes on."""
        self._position = self.position
        self._since = None

    def _rewind(self, moment: int) -> None:
        self.jumps += 1
        self._position = self._from = moment
        self._already = self.published
        self.ended = False
        self._ready.clear()
        self._records = records(self._recordings, self._wanted, moment)

    async def _next(self) -> Record | Gap | None:
        if not self._ready:
            self._ready.extend(await self._read_by(self._read))
        return self._ready.popleft() if self._ready else None

    async def _read_by(self, read: Callable[..., list[_Read]], *arguments: int) -> list[_Read]:
        loop = asyncio.get_running_loop()
        return await loop.run_in_executor(self._reader, read, *arguments)

    def close(self) -> None:
        """Read no more."""
        self._reader.shutdown(wait=False, cancel_futures=True)

    def _read(self) -> list[Record | Gap]:
        return list(islice(self._records, _AHEAD))

    def _before(self, moment: int) -> list[Record | Gap]:
        """Find the last record of each channel before a moment, in the chunks just before it.

        Chunks that cannot be read, in which some of them may be, are gaps.
        """
        found: dict[Any, Record] = {}
        gaps: list[Gap] = []
        chunks = [
            (chunk, recording)
            for recording in self._recordings
            for chunk in recording.chunks
            if chunk.start < moment
        ]
        chunks.sort(key=lambda one: one[0].end, reverse=True)
        for chunk, recording in chunks[:_BACK]:
            tracks = {
                number: track
                for number, track in recording.tracks.items()
                if track.channel.topic not in found and self._wanted(track)
            }
            try:
                last = {
                    record.track.channel.topic: record
                    for record in recording.read(chunk, tracks, 0, moment)
                }
            except Exception as error:  # a damaged part hides nothing of the others
                log.warning("replay_part_unreadable", error=str(error))
                gaps.append(Gap(chunk.start, chunk.end, error))
                continue
            found |= last
        return sorted((*found.values(), *gaps), key=_time)


def _time(one: Record | Gap) -> int:
    return one.start if isinstance(one, Gap) else one.log_time
