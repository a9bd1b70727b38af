"""Work on messages that takes long, in a thread of its own; only the newest message waits."""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

from rcp_ros2.cdr import Value

__all__ = ["Newest"]


class Newest:
    """One thread, for one path."""

    def __init__(self, name: str, work: Callable[[Value], None]) -> None:
        self._work = work
        self._pool = ThreadPoolExecutor(1, name)
        self._lock = threading.Lock()
        self._next: Value | None = None
        self._busy = False

    def take(self, value: Value) -> None:
        """Work on a value next, instead of one that still waits; from any thread."""
        with self._lock:
            self._next = value
            if self._busy:
                return
            self._busy = True
        with contextlib.suppress(RuntimeError):  # closed: nobody waits for it
            self._pool.submit(self._run)

    def _run(self) -> None:
        while True:
            with self._lock:
                value, self._next = self._next, None
                if value is None:
                    self._busy = False
                    return
            self._work(value)

    async def apart(self, make: Callable[[Value], Value], value: Value) -> Value:
        """Return what a function makes of a value, called in the thread."""
        return await asyncio.get_running_loop().run_in_executor(self._pool, make, value)

    def clear(self) -> None:
        """Drop what waits."""
        with self._lock:
            self._next = None

    def close(self) -> None:
        """End the thread after what it is at."""
        self._pool.shutdown(wait=False)
