"""A request that is answered later: exactly one final reply, inside its deadline, whatever happens."""

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

__all__ = ["Pending", "blame", "crash"]

log = structlog.get_logger("rcp.gateway")

Settle = Callable[[Any, RcpError | None], None]


def crash(error: BaseException, **facts: Any) -> RcpError:
    """Turn an exception that nobody expected into the error a client may see, and log the rest."""
    if isinstance(error, RcpError):
        return error
    if isinstance(error, (ConnectionError, TimeoutError)):
        return AdapterUnavailable(f"the link to the robot failed: {error or type(error).__name__}")
    failure = InternalError("the gateway failed to handle the request; its log has the reason")
    failure.trace_id = secrets.token_hex(8)
    log.error("request_crashed", trace_id=failure.trace_id, exc_info=error, **facts)
    return failure


def blame(error: Exception, origin: str, path: str) -> RcpError:
    """Turn what a backend raised into an error that says whose it is."""
    told = crash(error, backend=origin, path=path)
    told.origin = told.origin or origin
    return told


class Pending:
    """One coroutine with a deadline; `settle(result, error)` is called exactly once."""

    __slots__ = ("_settle", "_task", "_timeout", "_timer", "path")

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        work: Coroutine[Any, Any, Any],
        timeout: float,
        settle: Settle,
        path: str | None,
    ) -> None:
        self.path = path
        self._timeout = timeout
        self._settle: Settle | None = settle
        self._task = loop.create_task(work)
        self._timer = loop.call_later(timeout, self._expire)
        self._task.add_done_callback(self._done)

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
        self._task.cancel()

    def cancel(self, error: RcpError) -> None:
        """Answer with an error now and stop the work."""
        self._finish(None, error)
        self._task.cancel()

    def _done(self, task: asyncio.Task[Any]) -> None:
        if task.cancelled():
            self._finish(None, Cancelled("the request was cancelled", path=self.path))
            return
        error = task.exception()
        if error is None:
            self._finish(task.result(), None)
        else:
            self._finish(None, crash(error, path=self.path))
