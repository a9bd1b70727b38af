"""Cancellations that something else was raised in place of."""

from __future__ import annotations

import asyncio

__all__ = ["raise_if_cancelled"]


def raise_if_cancelled(instead: BaseException | None = None) -> None:
    """Raise `CancelledError`, from what was raised `instead`, if this task was cancelled.

    To be called where errors are caught and the task goes on: before Python 3.13, a task group that
    ends with errors of its tasks raises these alone, also when it was cancelled from outside
    (python/cpython#116720), and the task would never end.
    """
    task = asyncio.current_task()
    if task is not None and task.cancelling():
        raise asyncio.CancelledError from instead
