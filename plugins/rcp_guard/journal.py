"""The guard's log: JSON lines on standard error, written by a thread that may block."""

from __future__ import annotations

import json
import os
import queue
import threading
from datetime import UTC, datetime
from typing import Any

__all__ = ["Journal"]

_STDERR = 2


class Journal:
    """Accepts records without blocking, even if nothing reads standard error."""

    def __init__(self) -> None:
        self._records: queue.Queue[bytes | None] = queue.Queue(1000)
        self._thread = threading.Thread(target=self._write, name="journal", daemon=True)
        self._thread.start()

    def note(self, level: str, event: str, **facts: Any) -> None:
        """Log one record; dropped if too many are queued."""
        stamp = datetime.now(UTC).isoformat(timespec="milliseconds")
        head = {"timestamp": stamp, "level": level, "logger": "rcp.guard", "event": event}
        self._put(json.dumps(head | facts).encode() + b"\n")

    def close(self, timeout: float) -> None:
        """Write the queued records, within a time limit."""
        self._put(None)
        self._thread.join(timeout)

    def _put(self, record: bytes | None) -> None:
        try:
            self._records.put_nowait(record)
        except queue.Full:
            return

    def _write(self) -> None:
        while (record := self._records.get()) is not None:
            try:
                os.write(_STDERR, record)
            except OSError:  # nothing reads standard error, and there is no other output
                continue
