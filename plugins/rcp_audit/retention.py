"""Retention of the log: the oldest rows are deleted by age and size, and this is recorded too."""

from __future__ import annotations

import asyncio
import math
import sqlite3
from contextlib import suppress
from functools import partial

import msgspec

from rcp_audit.clock_trust import ClockTrust
from rcp_audit.config import AuditConfig
from rcp_kernel.clock import parse_time
from rcp_kernel.errors import BadRequest
from rcp_kernel.features import FeatureHost
from rcp_store.chain import Head
from rcp_store.file import ROWS

__all__ = ["Retention"]

_LOOK = 60.0  # s between checks
_AT_ONCE = 10_000  # records deleted in one transaction
_SLACK = 0.05  # tolerated excess of age or size, so that deletions are rare
_DAY = 86_400 * 10**9  # ns
_NEVER_SET = 50 * 365 * _DAY  # a clock that was never set is before that


class _Timed(msgspec.Struct):
    """What is read of a record."""

    time: str


_decode = msgspec.json.Decoder(_Timed).decode


class Retention:
    """Checks the age and size of the log periodically.

    Nothing is deleted for its age by a clock that may be wrong: see `ClockTrust`. If it is set back,
    nothing was lost.
    """

    def __init__(self, host: FeatureHost, config: AuditConfig) -> None:
        self._host = host
        self.config = config
        self._timer: asyncio.TimerHandle | None = None
        self._started = self._stopped = False
        self._undated = 0
        """The last of so many records at the beginning whose time is unknown; for the store's thread."""
        self._trust = ClockTrust(host.clock, host.store("clock"), lambda: self.config.keep_days)

    def start(self, last: str | None = None) -> None:
        """Check now, then periodically; `last` is the time of the last record of an earlier run."""
        time: int | None = None
        with suppress(BadRequest):
            time = None if last is None else parse_time(last)
        self._trust.load(time)
        self._started = True
        self._check()

    def _check(self) -> None:
        self._timer = None
        self._host.ledger.look(partial(self._surplus, self._trust.look()), self._delete)

    def stop(self) -> None:
        """Stop checking."""
        if self._timer is not None:
            self._timer.cancel()
        if self._started:
            self._trust.look()
        self._stopped = True

    def _surplus(self, now: int, base: sqlite3.Connection) -> Head | None:
        """Return the last record to delete; runs on the store's thread."""
        first, last = base.execute("SELECT min(seq), max(seq) FROM audit").fetchone()
        if first is None:
            return None
        gone = max(self._too_old(base, now), self._too_many(base, first, last))
        gone = min(gone, first + _AT_ONCE - 1, last)
        if gone < first:
            return None
        row = base.execute(f"{ROWS} WHERE seq <= ? ORDER BY seq DESC LIMIT 1", (gone,)).fetchone()
        return row[:2]

    def _too_old(self, base: sqlite3.Connection, now: int) -> int:
        """Return the last of the old records at the beginning; 0 if there are none.

        Times need not rise: a robot without a battery starts in 1970, among records of today.
        """
        days = self.config.keep_days
        if days is None or math.isinf(days):
            return 0
        gone, limit = 0, now - int(days * _DAY * (1 + _SLACK))
        rows = base.execute(
            "SELECT seq, record FROM audit WHERE seq > ? ORDER BY seq LIMIT ?",
            (self._undated, _AT_ONCE),
        )
        undated = 0
        for seq, record in rows:
            time = _time(record)
            if time > limit:
                break
            if time < _NEVER_SET:  # as old as the next
                undated = seq
            else:
                limit, gone = now - int(days * _DAY), seq
        else:
            if not gone:  # go on from there next time
                self._undated = max(self._undated, undated)
        return gone

    def _too_many(self, base: sqlite3.Connection, first: int, last: int) -> int:
        limit = self.config.keep_mb
        if limit is None:
            return 0
        pages, free, size = (
            base.execute(f"PRAGMA {name}").fetchone()[0]
            for name in ("page_count", "freelist_count", "page_size")
        )
        used = (pages - free) * size
        if used <= limit * 1e6:
            return 0
        share = 1 - limit * 1e6 * (1 - _SLACK) / used
        return first + int((last - first + 1) * share)

    def _delete(self, gone: Head | None) -> None:
        if self._stopped:
            return
        if gone is None:
            self._timer = self._host.loop.call_later(_LOOK, self._check)
            return
        seq, digest = gone
        # In one transaction: the chain begins after the head named in the `prune` record.
        self._host.ledger.prune(gone)
        self._host.note("prune", principal=None, to=seq, hash=digest.hex())
        self._check()


def _time(data: bytes) -> int:
    try:
        return parse_time(_decode(data).time)
    except Exception:  # a record that was tampered with is as old as the next
        return 0
