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

    class _Timeout(asyncio.Timeout):
        """`asyncio.Timeout` as of Python 3.11.3.

        Before it (Debian 12 has 3.11.2), a limit that expires in a task that had been cancelled
        already raises `CancelledError` instead of `TimeoutError` (python/cpython#102780): what
        handles the latter, to stop a robot again or to kill a process, would not run.
        """

        async def __aenter__(self) -> Self:
            await super().__aenter__()
            self._before = _cancelling()
            return self

        async def __aexit__(
            self,
            kind: type[BaseException] | None,
            error: BaseException | None,
            trace: TracebackType | None,
        ) -> None:
            await super().__aexit__(kind, error, trace)
            # Its own request to cancel is withdrawn now: there is no other one of within the block.
            ours = self.expired() and _cancelling() <= self._before
            if ours and kind is asyncio.CancelledError:
                raise TimeoutError from error

    def _cancelling() -> int:
        task = asyncio.current_task()
        return 0 if task is None else task.cancelling()

    def timeout(delay: float | None) -> _Timeout:
        """Limit a block to `delay` seconds; None is no limit."""
        when = None if delay is None else asyncio.get_running_loop().time() + delay
        return _Timeout(when)

    def timeout_at(when: float | None) -> _Timeout:
        """Limit a block to a time of the loop; None is no limit."""
        return _Timeout(when)
