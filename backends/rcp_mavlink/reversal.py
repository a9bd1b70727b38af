"""Transfers that are applied as a whole or not at all."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Callable, Coroutine
from contextlib import asynccontextmanager
from typing import Any

from rcp_kernel.errors import DeviceRejected, RcpError

__all__ = ["reversed_on_failure"]

PutBack = Callable[[], Coroutine[Any, Any, str]]


@asynccontextmanager
async def reversed_on_failure(put_back: PutBack, remedy: str | None = None) -> AsyncGenerator[None]:
    """Put back what was there before if the work within fails or is cancelled.

    `put_back` returns what has come of it. It runs to its end, whatever is cancelled meanwhile.

    :raises DeviceRejected: the work has failed; says what has come of putting back.
    """
    try:
        yield
    except asyncio.CancelledError:
        await _to_its_end(put_back())
        raise
    except Exception as error:
        became = await _to_its_end(put_back())
        told = isinstance(error, RcpError)
        raise DeviceRejected(
            f"{error.message if told else f'an error of the gateway, {error!r}'}; {became}",
            remedy=remedy or (error.remedy if told else None),
            details=error.details if told else None,
        ) from error


async def _to_its_end(work: Coroutine[Any, Any, str]) -> str:
    """Return the result of work that no cancellation ends."""
    task = asyncio.create_task(work)
    cancelled = False
    while not task.done():
        try:
            await asyncio.wait((task,))
        except asyncio.CancelledError:
            cancelled = True
    if cancelled:
        raise asyncio.CancelledError
    return task.result()
