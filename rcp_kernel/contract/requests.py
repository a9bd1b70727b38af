"""Requests that never come off the wire: those of adapters, and long ones decoded in steps."""

from __future__ import annotations

from typing import Any

from rcp_kernel.values import ValueType
from rcp_kernel.wire import Request

__all__ = ["PreparedRequest", "QueuedRequest"]


class PreparedRequest(Request):
    """A long request whose body was decoded in steps before it is handled."""

    type_of_body: ValueType | None
    """The type used to decode the body; None if there was no resource that has one."""
    outcome: Any
    """Its value, or the error that decoding ended with."""
    recorded: dict[str, Any]
    """Its length and hash, for the record."""

    def decode_body(self, type_: ValueType, label: str = "body") -> Any:
        """Return the body, unless it is to be of another type by now."""
        if type_ is not self.type_of_body:
            return super().decode_body(type_, label)
        if isinstance(self.outcome, Exception):
            raise self.outcome
        return self.outcome


class QueuedRequest(Request, kw_only=True):
    """A request that waited in a queue of an adapter, which no client can send as such.

    An e-stop after its arrival refuses an action of the gateway that affects the stopped robot.
    """

    since: float
    """Time of arrival, by `time.monotonic()`."""
