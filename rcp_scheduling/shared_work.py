"""Deduplication of concurrent work: requests for the same result share one run."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine, Hashable
from typing import Any, Generic, TypeVar

__all__ = ["SharedWork"]

Result = TypeVar("Result")


class SharedWork(Generic[Result]):
    """Work in progress, by key."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._under_way: dict[Hashable, asyncio.Task[Result]] = {}

    async def result(
        self, key: Hashable, begin: Callable[[], Coroutine[Any, Any, Result]]
    ) -> Result:
        """Return the result of the work in progress for a key; start it if there is none.

        It continues if one of its waiters gives up.
        """
        task = self._under_way.get(key)
        if task is None:
            task = self._under_way[key] = self._loop.create_task(begin())
            task.add_done_callback(lambda _: self._under_way.pop(key))
        return await asyncio.shield(task)
