"""Repetition of a stop until it is acknowledged, without waiting for a lost one."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any

import structlog

from rcp_kernel.contract.fence import unfenced

__all__ = ["retry_until_confirmed"]

log = structlog.get_logger("rcp.safety")
_AGAIN = 0.01  # s to the second one: with two of three lost, the third leaves within 50 ms
_FAILED = 0.05  # s after one that failed
_SLOWER = 2.0  # times as long to the next, for as long as none is answered, or all fail
_SLOWEST = 1.0  # s between two at most
_MAX_CONCURRENT = 8  # unanswered calls; the oldest is cancelled for the next
_LOG_INTERVAL = 1.0  # s between two log records, at least


def retry_until_confirmed(
    stop: Callable[[], Coroutine[Any, Any, None]],
    event: str,
    *,
    again: float | None = None,
    **facts: str,
) -> asyncio.Task[None]:
    """Call `stop` until one call returns; return the task, which can be cancelled.

    The first call is scheduled before this returns, ahead of anything scheduled after it. An
    unanswered call continues concurrently with the next ones, because it may only be slow; the
    second follows after `again` s. Failures are logged as `event` with `facts`.
    """
    loop = asyncio.get_running_loop()
    with unfenced():  # the caller may be a timer of the very write to be stopped
        first = loop.create_task(stop())
        return loop.create_task(_until_taken(first, stop, event, facts, again or _AGAIN))


async def _until_taken(
    first: asyncio.Task[None],
    stop: Callable[[], Coroutine[Any, Any, None]],
    event: str,
    facts: dict[str, str],
    pause: float,
) -> None:
    loop = asyncio.get_running_loop()
    calls = [first]
    refused, logged_at = _FAILED, -_LOG_INTERVAL
    try:
        while True:
            failure = await _answered(calls, loop.time() + pause)
            if failure is None and not calls:
                return
            if failure is not None and loop.time() - logged_at >= _LOG_INTERVAL:
                logged_at = loop.time()
                log.warning(event, error=repr(failure), **facts)
            if calls:
                pause = min(pause * _SLOWER, _SLOWEST)
            else:
                pause = refused
                refused = min(refused * _SLOWER, _SLOWEST)
            if len(calls) >= _MAX_CONCURRENT:
                calls.pop(0).cancel()
            calls.append(loop.create_task(stop()))
    finally:
        for call in calls:
            call.cancel()


async def _answered(calls: list[asyncio.Task[None]], until: float) -> BaseException | None:
    """Wait for an answer, and empty `calls` on a good one; return the last failure before the timeout."""
    loop, failure = asyncio.get_running_loop(), None
    while (left := until - loop.time()) > 0:
        if not calls:
            await asyncio.sleep(left)
            break
        done, _ = await asyncio.wait(calls, timeout=left, return_when=asyncio.FIRST_COMPLETED)
        for call in done:
            calls.remove(call)
            error = asyncio.CancelledError() if call.cancelled() else call.exception()
            if error is None:
                for other in calls:
                    other.cancel()
                calls.clear()
                return None
            failure = error
    return failure
