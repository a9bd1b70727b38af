"""A periodic timer finer than the event loop's, whose resolution is a millisecond."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Generator
from contextlib import contextmanager

__all__ = ["Ticker"]

_LATE = 0.1  # s: beats that are later than this are not made up for


class Ticker:
    """Wakes one task of the event loop at a rate; a beat is skipped if the task is still busy."""

    def __init__(self, rate: float) -> None:
        self._period = 1 / rate
        self._loop = asyncio.get_running_loop()
        self._waiting: asyncio.Future[None] | None = None
        self._due = False
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"can {rate:g} Hz", daemon=True)

    @contextmanager
    def running(self) -> Generator[None]:
        """Run the timer while entered."""
        self._thread.start()
        try:
            yield
        finally:
            self._ended.set()

    async def beat(self) -> None:
        """Wait for the next beat."""
        if not self._due:
            self._waiting = self._loop.create_future()
            await self._waiting
        self._due = False

    def _wake(self) -> None:
        self._due = True
        if self._waiting is not None and not self._waiting.done():
            self._waiting.set_result(None)

    def _run(self) -> None:
        due = time.monotonic()
        while not self._ended.is_set():
            due += self._period
            now = time.monotonic()
            if due < now - _LATE:
                due = now
            time.sleep(max(0.0, due - now))
            try:
                self._loop.call_soon_threadsafe(self._wake)
            except RuntimeError:  # the loop has ended
                return
