"""A request that is answered later: exactly one final reply, within its deadline."""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import Callable, Coroutine
from typing import Any

import structlog

from rcp_kernel.errors import (
    AdapterUnavailable,
    Cancelled,
    DeadlineExceeded,
    InternalError,
    RcpError,
)

__all__ = ["Pending", "attribute_error", "to_internal_error"]

log = structlog.get_logger("rcp.gateway")

Settle = Callable[[Any, RcpError | None], None]


def to_internal_error(error: BaseException, **facts: Any) -> RcpError:
    """Convert an unexpected exception to the error that a client may see, and log the rest."""
    if isinstance(error, RcpError):
        return error
    if isinstance(error, (ConnectionError, TimeoutError)):
        return AdapterUnavailable(f"the link to the robot failed: {error or type(error).__name__}")
    failure = InternalError("the gateway failed to handle the request; see its log")
    failure.trace_id = secrets.token_hex(8)
    log.error("request_crashed", trace_id=failure.trace_id, exc_info=error, **facts)
    return failure


def attribute_error(error: Exception, origin: str, path: str) -> RcpError:
    """Convert a backend's confidential exception to an error that names the backend."""
    internal = to_internal_error(error, backend=origin, path=path)
    internal.origin = origin
    return internal


class Pending:
    """One coroutine with a deadline; `settle(result, error)` is called exactly once.

    The deadline counts from now on; the coroutine runs from `start` on.
    """

    __slots__ = ("_loop", "_settle", "_task", "_timeout", "_timer", "_work", "path")

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        work: Coroutine[Any, Any, Any],
        timeout: float,
        settle: Settle,
        path: str | None,
    ) -> None:
        self.path = path
        self._loop = loop
        self._work = work
        self._timeout = timeout
        self._settle: Settle | None = settle
        self._task: asyncio.Task[Any] | None = None
        self._timer = loop.call_later(timeout, self._expire)

    def start(self) -> None:
        """Run the coroutine, unless the deadline has passed."""
        if self._settle is None:
            self._work.close()
            return
        self._task = self._loop.create_task(self._work)
        self._task.add_done_callback(self._done)

    def _stop(self) -> None:
        if self._task is not None:
            self._task.cancel()

    def _finish(self, result: Any, error: RcpError | None) -> None:
        settle, self._settle = self._settle, None
        if settle is not None:
            self._timer.cancel()
            settle(result, error)

    def _expire(self) -> None:
        self._finish(
            None,
            DeadlineExceeded(
                f"no answer from {self.path or 'the gateway'} within {self._timeout:g} s",
                path=self.path,
            ),
        )
        self._stop()

    def cancel(self, error: RcpError) -> None:
        """Answer with an error now and stop the work."""
        self._finish(None, error)
        self._stop()

    def _done(self, task: asyncio.Task[Any]) -> None:
        if task.cancelled():
            self._finish(None, Cancelled("the request was cancelled", path=self.path))
            return
        error = task.exception()
        if error is None:
            self._finish(task.result(), None)
        else:
            self._finish(None, to_internal_error(error, path=self.path))
