"""Task groups that keep the cancellations of their task apart from their own."""

from __future__ import annotations

import asyncio
import sys
from operator import attrgetter
from types import TracebackType
from typing import Self

__all__ = ["TaskGroup"]

if sys.version_info >= (3, 13):
    from asyncio import TaskGroup  # noqa: TID251 - what it is banned for is mended here
else:
    _cancels_its_task = attrgetter("_parent_cancel_requested")

    class TaskGroup(asyncio.TaskGroup):  # noqa: TID251
        """`asyncio.TaskGroup` as of Python 3.13 (python/cpython#116720).

        Before it, a group that fails forgets that its task was cancelled from outside: a task that
        handles the failure and goes on would never end. And it leaves the task counted as cancelled
        when it fails while it waits for its tasks: a time limit around it would not end as one.
        """

        async def __aenter__(self) -> Self:
            await super().__aenter__()
            self._before = _task().cancelling()
            return self

        async def __aexit__(
            self,
            kind: type[BaseException] | None,
            error: BaseException | None,
            trace: TracebackType | None,
        ) -> None:
            counted = _cancels_its_task(self)
            try:
                await super().__aexit__(kind, error, trace)
            except BaseExceptionGroup:
                if _cancels_its_task(self) and not counted:
                    _task().uncancel()
                if _task().cancelling() > self._before:
                    _task().uncancel()
                    _task().cancel()  # raised where the task waits next
                raise

    def _task() -> asyncio.Task[object]:
        task = asyncio.current_task()
        if task is None:
            raise RuntimeError("a task group belongs to a task")
        return task
