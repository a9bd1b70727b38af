"""Requests that an adapter has held back before it submits them."""

from __future__ import annotations

from rcp_kernel.wire import Request

__all__ = ["HeldRequest"]


class HeldRequest(Request, kw_only=True):
    """A request of an adapter's making, which no client can send as such.

    An e-stop since then refuses an action of the gateway's own that is about the stopped robot.
    """

    since: float
    """When it came in, by `time.monotonic()`."""
