"""Concurrent operations on several motors."""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine, Iterable
from typing import Any

import anyio

__all__ = ["all_of", "together"]


async def together(work: Iterable[Coroutine[Any, Any, None]]) -> None:
    """Run all concurrently; the first failure cancels the others and is raised."""
    tasks = [asyncio.ensure_future(each) for each in work]
    if not tasks:
        return
    try:
        await asyncio.wait(tasks, return_when=asyncio.FIRST_EXCEPTION)
    finally:
        for task in tasks:
            task.cancel()
        with anyio.CancelScope(shield=True):
            await asyncio.wait(tasks)
    for task in tasks:
        if not task.cancelled() and (error := task.exception()) is not None:
            raise error


async def all_of(work: Iterable[Coroutine[Any, Any, None]]) -> None:
    """Run all concurrently to their end, whichever fails; then raise the first failure."""
    done = await asyncio.gather(*work, return_exceptions=True)
    for error in done:
        if isinstance(error, BaseException):
            raise error
