"""Unexpected exceptions, as the errors that a client may see."""

from __future__ import annotations

import secrets
from typing import Any

import structlog

from rcp_kernel.contract.caller import caller
from rcp_kernel.errors import AdapterUnavailable, InternalError, RcpError
from rcp_protocol.trace import Trace

__all__ = ["attribute_error", "to_internal_error"]

log = structlog.get_logger("rcp.gateway")


def to_internal_error(
    error: BaseException, *, trace: Trace | None = None, **facts: Any
) -> RcpError:
    """Convert an unexpected exception to the error that a client may see, and log the rest."""
    if isinstance(error, RcpError):
        return error
    if isinstance(error, (ConnectionError, TimeoutError)):
        return AdapterUnavailable(f"the link to the robot failed: {error or type(error).__name__}")
    failure = InternalError("the gateway failed to handle the request; see its log")
    now = caller()
    trace = trace or (None if now is None else now.trace)
    failure.trace_id = secrets.token_hex(16) if trace is None else trace.id
    log.error("request_crashed", trace_id=failure.trace_id, exc_info=error, **facts)
    return failure


def attribute_error(error: Exception, origin: str, path: str) -> RcpError:
    """Convert a backend's confidential exception to an error that names the backend."""
    internal = to_internal_error(error, backend=origin, path=path)
    internal.origin = origin
    return internal
