"""What a client is told in place of a reply that is too long for its queue."""

from __future__ import annotations

from rcp_kernel.errors import QueueFull
from rcp_kernel.wire import Reply, failure

__all__ = ["ESTOP", "left_out"]

ESTOP = "/system/estop"
"""The path whose replies are sent however much waits."""
_ACTS = ("write", "execute")


def left_out(reply: Reply, size: int) -> Reply:
    """Make the reply that says why another one, of `size` bytes, is not sent.

    What was done stays done: the outcome is told, and that it should not be asked for again.
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
