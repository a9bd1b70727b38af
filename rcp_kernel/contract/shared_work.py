"""What several ask for at once is done once: whoever asks for the same meanwhile shares it."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine, Hashable
from typing import Any, Generic, TypeVar

__all__ = ["SharedWork"]

Result = TypeVar("Result")


class SharedWork(Generic[Result]):
    """Work under way, by what tells it from other work."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._under_way: dict[Hashable, asyncio.Task[Result]] = {}

    async def result(
        self, key: Hashable, begin: Callable[[], Coroutine[Any, Any, Result]]
    ) -> Result:
        """Return what the work under way for a key comes to; begin it if there is none.

        It goes on when one of those who wait for it gives up.
        """
        task = self._under_way.get(key)
        if task is None:
            task = self._under_way[key] = self._loop.create_task(begin())
            task.add_done_callback(lambda _: self._under_way.pop(key))
        return await asyncio.shield(task)
