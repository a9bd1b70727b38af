"""The errors raised by a client: those of the protocol by code, and `ConnectionLost`."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import TYPE_CHECKING, TypeVar

from rcp_protocol.errors import BY_CODE, AdapterUnavailable, Cancelled, Failed, RcpError, Refused

if TYPE_CHECKING:
    from rcp_client.messages import Reply

__all__ = ["LOOK", "ConnectionLost", "error_of", "safely", "unknown_outcome"]

T = TypeVar("T")
log = logging.getLogger("rcp.client")

LOOK = "It may have been executed: check the state of the robot before you send it again."


class ConnectionLost(AdapterUnavailable, ConnectionError):
    """The gateway cannot be reached, or the connection was lost before its reply.

    A write or execute that was sent may have been executed: it is `retryable` only if a repeat does
    no harm, because of an idempotency key that the caller gave, as a dry run, or as a stop.
    """

    default_remedy = "Check the address and that `rcpd` is running there, then try again."


_BY_STATUS: dict[str, type[RcpError]] = {"rejected": Refused, "cancelled": Cancelled}


def error_of(reply: Reply) -> RcpError | None:
    """Return the error in a reply, or None if it contains none."""
    if reply.status not in ("failed", "rejected", "cancelled"):
        return None
    body = reply.error or {}
    code = body.get("code")
    class_ = BY_CODE.get(str(code)) or _BY_STATUS.get(reply.status, Failed)
    details = body.get("details")
    if str(code) not in BY_CODE and code is not None:
        details = {"code": code, **(details or {})}
    if reply.body is not None:  # of a plan: the state of each step
        details = {**(details or {}), "body": reply.body}
    error = class_(
        body.get("message") or reply.message or f"the gateway answered '{reply.status}'",
        path=body.get("path") or reply.path,
        origin=body.get("origin"),
        remedy=body.get("remedy"),
        retry_after=body.get("retry_after"),
        details=details,
    )
    error.status = reply.status  # the same code may come before or after the robot has acted
    error.retryable = bool(body.get("retryable", error.retryable))
    error.trace_id = body.get("trace_id")
    return error


def unknown_outcome(error: RcpError) -> RcpError:
    """Mark an error of a request that may have been executed and must not simply be repeated."""
    error.status = "failed"  # not `rejected`, which means that nothing was changed
    error.retryable = False
    error.remedy = LOOK
    return error


def safely(callback: Callable[[T], object] | None, item: T) -> None:
    """Call a user's callback; its exceptions are logged, as they must not break the connection."""
    if callback is None:
        return
    try:
        callback(item)
    except Exception:
        log.exception("a callback of the client's user failed")
