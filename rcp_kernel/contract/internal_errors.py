"""Exceptions as the errors that a client may see: the one place where they are converted."""

from __future__ import annotations

import secrets
from typing import Any

import structlog

from rcp_kernel.contract.caller import caller
from rcp_kernel.errors import AdapterUnavailable, InternalError, RcpError
from rcp_protocol.trace import Trace

__all__ = ["LinkLost", "attribute_error", "to_internal_error"]

log = structlog.get_logger("rcp.gateway")


class LinkLost(AdapterUnavailable):
    """The link failed while a command or write was with the robot, which may have begun to act."""

    status = "failed"
    retryable = False
    default_remedy = "Check the state of the robot before you send it again."


def to_internal_error(
    error: BaseException, *, trace: Trace | None = None, **facts: Any
) -> RcpError:
    """Convert an unexpected exception to the error that a client may see, and log the rest."""
    return _converted(
        error, AdapterUnavailable, "gateway failed to handle the request; see its log", trace, facts
    )


def attribute_error(
    error: BaseException,
    origin: str | None,
    path: str,
    *,
    sent: bool = False,
    trace: Trace | None = None,
    command: str | None = None,
) -> RcpError:
    """Convert a backend's confidential exception to an error that names the backend.

    `sent`: the robot may have begun to act, so that a failed link is `LinkLost`.
    """
    link = LinkLost if sent else AdapterUnavailable
    facts = {"backend": origin, "path": path}
    if command is not None:
        facts["command"] = command
    converted = _converted(error, link, "backend failed; see the gateway's log", trace, facts)
    converted.origin = converted.origin or origin
    return converted


def _converted(
    error: BaseException,
    link: type[AdapterUnavailable],
    failed: str,
    trace: Trace | None,
    facts: dict[str, Any],
) -> RcpError:
    if isinstance(error, RcpError):
        return error
    if isinstance(error, (ConnectionError, TimeoutError)):
        return link(f"the link to the robot failed: {error or type(error).__name__}")
    failure = InternalError(f"the {failed}")
    now = caller()
    trace = trace or (None if now is None else now.trace)
    failure.trace_id = secrets.token_hex(16) if trace is None else trace.id
    log.error("request_crashed", trace_id=failure.trace_id, exc_info=error, **facts)
    return failure
