"""The substitute for a reply that is too long for a client's queue."""

from __future__ import annotations

from rcp_kernel.errors import QueueFull
from rcp_kernel.wire import Reply, failure

__all__ = ["left_out"]

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
