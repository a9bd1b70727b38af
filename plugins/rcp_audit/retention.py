"""Retention of the log: the oldest rows are deleted by age and size, and this is recorded too."""

from __future__ import annotations

import asyncio
import sqlite3
from contextlib import suppress
from typing import Any

import msgspec
import structlog

from rcp_audit.config import AuditConfig
from rcp_kernel.clock import parse_time
from rcp_kernel.errors import BadRequest
from rcp_kernel.features import FeatureHost
from rcp_store.chain import Head
from rcp_store.file import ROWS

__all__ = ["Retention"]

log = structlog.get_logger("rcp.audit")
_LOOK = 60.0  # s between checks
_AT_ONCE = 10_000  # records deleted in one transaction
_SLACK = 0.05  # tolerated excess of age or size, so that deletions are rare
_DAY = 86_400 * 10**9  # ns
_WAIT = 86_400.0  # s that a clock has to go on after it went ahead by more than that


class Retention:
    """Checks the age and size of the log periodically.

    Nothing is deleted for its age while the clock may be wrong: after it went ahead, while the gateway
    ran or since the last record before, it has to go on like that for a day. If it is set back, nothing
    was lost.
    """

    def __init__(self, host: FeatureHost, config: AuditConfig) -> None:
        self._host = host
        self.config = config
        self._timer: asyncio.TimerHandle | None = None
        self._stopped = False
        self._seen: tuple[int, float] | None = None
        """Wall time at the last check, and the monotonic time then."""
        self._trusted = 0.0
        """The monotonic time from which on the clock tells the age of records."""

    def start(self, last: str | None = None) -> None:
        """Check now, then periodically; `last` is the time of the last record of an earlier run."""
        if last is not None:
            with suppress(BadRequest):
                self._seen = parse_time(last), self._host.clock.monotonic()
        self._check()

    def _check(self) -> None:
        self._timer = None
        self._watch_clock()
        self._host.ledger.look(self._surplus, self._delete)

    def _watch_clock(self) -> None:
        wall, moment = self._host.clock.now(), self._host.clock.monotonic()
        before, self._seen = self._seen, (wall, moment)
        if before is None:
            return
        ahead = (wall - before[0]) / 1e9 - (moment - before[1])
        if ahead < -_WAIT:
            self._trusted = 0.0
        elif ahead > _WAIT and self.config.keep_days is not None:
            self._trusted = moment + min(_WAIT, self.config.keep_days * _WAIT)
            log.warning("audit_clock_ahead", seconds=round(ahead), waits=_WAIT)

    def stop(self) -> None:
        """Stop checking."""
        if self._timer is not None:
            self._timer.cancel()
        self._stopped = True

    def _surplus(self, base: sqlite3.Connection) -> Head | None:
        """Return the last record to delete; runs on the store's thread."""
        first, last = base.execute("SELECT min(seq), max(seq) FROM audit").fetchone()
        if first is None:
            return None
        gone = max(self._too_old(base, first, last), self._too_many(base, first, last))
        gone = min(gone, first + _AT_ONCE - 1, last)
        if gone < first:
            return None
        row = base.execute(f"{ROWS} WHERE seq <= ? ORDER BY seq DESC LIMIT 1", (gone,)).fetchone()
        return row[:2]

    def _too_old(self, base: sqlite3.Connection, first: int, last: int) -> int:
        days = self.config.keep_days
        if days is None or self._host.clock.monotonic() < self._trusted:
            return 0
        limit = self._host.clock.now() - int(days * _DAY)
        if _time(base, first) > limit - int(days * _DAY * _SLACK):
            return 0
        low, high = first, min(first + _AT_ONCE, last)
        while low < high:
            middle = (low + high + 1) // 2
            if _time(base, middle) <= limit:
                low = middle
            else:
                high = middle - 1
        return low

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


def _time(base: sqlite3.Connection, seq: int) -> int:
    row = base.execute(
        "SELECT record FROM audit WHERE seq <= ? ORDER BY seq DESC LIMIT 1", (seq,)
    ).fetchone()
    try:
        record: Any = msgspec.json.decode(row[0])
        return parse_time(record["time"])
    except Exception:  # a record that was tampered with counts as old
        return 0
