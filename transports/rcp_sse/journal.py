"""The numbered events of a stream, so that a client can resume at any of them."""

from __future__ import annotations

import asyncio
from collections import deque

__all__ = ["Journal", "Journals", "parse_event_id"]


class Journal:
    """The events of one session: a bounded record of path and sample by number."""

    __slots__ = ("_before", "_first", "_seen", "_size", "last")

    def __init__(self, size: int) -> None:
        self.last = 0
        """Number of the last event."""
        self._size = size
        self._seen: deque[tuple[str, int]] = deque()
        self._first = 1
        """Number of the oldest event in `_seen`."""
        self._before: dict[str, int] = {}
        """The last sample of each path before that event."""

    def note(self, path: str, seq: int) -> int:
        """Record an update; return its number."""
        seen = self._seen
        if len(seen) >= self._size:
            old_path, old_seq = seen.popleft()
            self._before[old_path] = old_seq
            self._first += 1
        seen.append((path, seq))
        number = self.last = self.last + 1
        return number

    def until(self, number: int) -> dict[str, int] | None:
        """Return the last sample of each path up to an event; None if it is no longer known."""
        if number < self._first - 1 or number > self.last:
            return None
        return self._before | dict(list(self._seen)[: number - self._first + 1])


class Journals:
    """The journals of sessions whose clients may resume."""

    def __init__(self, size: int) -> None:
        self._size = size
        self._known: dict[str, Journal] = {}
        self._timers: dict[str, asyncio.TimerHandle] = {}

    def of(self, session: str) -> Journal:
        """Return the journal of a session, creating it if necessary."""
        timer = self._timers.pop(session, None)
        if timer is not None:
            timer.cancel()
        return self._known.setdefault(session, Journal(self._size))

    def find(self, session: str) -> Journal | None:
        """Return the journal of a session, if there is one."""
        return self._known.get(session)

    def forget(self, session: str, after: float = 0.0) -> None:
        """Discard a journal after some seconds, unless its session resumes."""
        if after <= 0:
            self._known.pop(session, None)
        elif session in self._known and session not in self._timers:
            loop = asyncio.get_running_loop()
            self._timers[session] = loop.call_later(after, self._expire, session)

    def _expire(self, session: str) -> None:
        self._timers.pop(session, None)
        self._known.pop(session, None)

    def close(self) -> None:
        """Discard all journals."""
        for timer in self._timers.values():
            timer.cancel()


def parse_event_id(text: str | None) -> tuple[str, int] | None:
    """Parse `<session id>:<number>`; None for anything else."""
    session, _, number = (text or "").rpartition(":")
    return (session, int(number)) if session and number.isdigit() and len(number) < 16 else None
