"""Unexpected exceptions, as the errors that a client may see."""

from __future__ import annotations

import secrets
from typing import Any

import structlog

from rcp_kernel.errors import AdapterUnavailable, InternalError, RcpError

__all__ = ["attribute_error", "to_internal_error"]

log = structlog.get_logger("rcp.gateway")


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
