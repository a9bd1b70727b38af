"""Requests that waited in a queue of an adapter before it submits them."""

from __future__ import annotations

from rcp_kernel.wire import Request

__all__ = ["QueuedRequest"]


class QueuedRequest(Request, kw_only=True):
    """A request created by an adapter, which no client can send as such.

    An e-stop after its arrival refuses an action of the gateway that affects the stopped robot.
    """

    since: float
    """Time of arrival, by `time.monotonic()`."""
