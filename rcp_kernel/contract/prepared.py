"""A long request whose body was decoded in steps before it is handled."""

from __future__ import annotations

from typing import Any

from rcp_kernel.values import ValueType
from rcp_kernel.wire import Request

__all__ = ["Prepared"]


class Prepared(Request):
    """A request whose body is already decoded; it never comes off the wire."""

    type_of_body: ValueType
    """The type used to decode the body."""
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
