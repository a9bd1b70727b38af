"""The types of what clients offer: those of common ROS services, else whatever is sent."""

from __future__ import annotations

from typing import Any

import msgspec

from rcp_ros_messages.definitions import SERVICES
from rcp_ros_messages.message_type import PRIMITIVES, parse

__all__ = ["input_of", "output_of"]


def input_of(type_: str) -> Any:
    """Return the input type of a service or action by the name of its ROS type."""
    return _half(type_, "Request", 0)


def output_of(type_: str) -> Any:
    """Return the type of its result."""
    return _half(type_, "Response", 1)


def _half(type_: str, half: str, part: int) -> Any:
    if type_ not in SERVICES:
        return dict[str, Any] | None
    fields = parse(f"{type_}_{half}", SERVICES[type_][part]).fields
    zeros = [(field.name, PRIMITIVES[field.type]) for field in fields]
    return msgspec.defstruct(
        f"{type_.rpartition('/')[2]}{half}",
        [(name, type(zero), zero) for name, zero in zeros],
        kw_only=True,
        forbid_unknown_fields=True,
    )
