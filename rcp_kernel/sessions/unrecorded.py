"""The reply for an outcome that could not be recorded."""

from __future__ import annotations

from rcp_kernel.errors import DeadlineExceeded, RcpError
from rcp_kernel.wire import Reply, failure

__all__ = ["unrecorded"]


def unrecorded(reply: Reply, why: str = "could not be written in time") -> Reply:
    """Return a reply that confirms nothing, and contains the true outcome in `details`."""
    error = reply.error
    outcome = reply.status if error is None else error["code"]
    unknown: RcpError = DeadlineExceeded(
        f"its audit record {why}, so it cannot be confirmed",
        remedy="Check the state of the robot and /system/status before you send it again.",
        details={"outcome": outcome},
    )
    substitute = failure(unknown, reply.type, reply.id, reply.path, command=reply.command)
    substitute.custom = reply.custom
    assert substitute.error is not None
    substitute.error["retryable"] = False  # it may have been executed
    return substitute
