"""Replies sent in place of others: of one that is too long for its client, and of one that is not recorded."""

from __future__ import annotations

from rcp_kernel.errors import DeadlineExceeded, QueueFull, RcpError
from rcp_kernel.wire import Reply, failure

__all__ = ["left_out", "unrecorded"]

_ACTS = ("write", "execute")


def left_out(reply: Reply, size: int) -> Reply:
    """Return the substitute for a reply of `size` bytes that is not sent.

    The request was executed: the outcome is included, and that it must not be repeated.
    """
    acted = reply.type in _ACTS
    error = QueueFull(
        f"the reply of {size} bytes was not sent: this client, or all clients, have too much "
        "unread",
        remedy="Read the waiting messages, then check the state before you send it again."
        if acted
        else "Read the waiting messages, then send it again.",
        details={"size": size} | ({"outcome": reply.status} if acted else {}),
    )
    substitute = failure(error, reply.type, reply.id, reply.path, command=reply.command)
    substitute.custom = reply.custom
    if acted and substitute.error is not None:
        substitute.status = "failed"
        substitute.error["retryable"] = False
    return substitute


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
