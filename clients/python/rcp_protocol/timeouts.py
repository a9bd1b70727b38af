"""Time limits that also hold in the clean-up of a cancelled task."""

from __future__ import annotations

import asyncio
import sys
from types import TracebackType
from typing import Self

__all__ = ["timeout", "timeout_at"]

if sys.version_info >= (3, 11, 3):
    from asyncio import timeout, timeout_at  # noqa: TID251 - what it is banned for is mended here
else:

    class _Timeout:
        """`asyncio.Timeout` as of Python 3.11.3.

        Before it (Debian 12 has 3.11.2), a limit that expires in a task that had been cancelled
        already raises `CancelledError` instead of `TimeoutError` (python/cpython#102780): what
        handles the latter, to stop a robot again or to kill a process, would not run.
        """

        def __init__(self, when: float | None) -> None:
            self._when = when
            self._loop = asyncio.get_running_loop()
            self._timer: asyncio.Handle | None = None
            self._expired = False

        def reschedule(self, when: float | None) -> None:
            """Expire at `when`, in the loop's time, or never."""
            if self._timer is not None:
                self._timer.cancel()
            if when is None:
                self._timer = None
            elif when <= self._loop.time():
                self._timer = self._loop.call_soon(self._expire)
            else:
                self._timer = self._loop.call_at(when, self._expire)

        def _expire(self) -> None:
            self._expired = True
            self._task.cancel()

        async def __aenter__(self) -> Self:
            task = asyncio.current_task()
            if task is None:
                raise RuntimeError("a time limit holds for a task")
            self._task, self._before = task, task.cancelling()
            self.reschedule(self._when)
            return self

        async def __aexit__(
            self,
            kind: type[BaseException] | None,
            error: BaseException | None,
            trace: TracebackType | None,
        ) -> None:
            self.reschedule(None)
            ours = self._expired and self._task.uncancel() <= self._before
            if ours and kind is asyncio.CancelledError:
                raise TimeoutError from error

    def timeout(delay: float | None) -> _Timeout:
        """Limit a block to `delay` seconds; None is no limit."""
        when = None if delay is None else asyncio.get_running_loop().time() + delay
        return _Timeout(when)

    def timeout_at(when: float | None) -> _Timeout:
        """Limit a block to a time of the loop; None is no limit."""
        return _Timeout(when)
