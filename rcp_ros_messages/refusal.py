"""What a ROS service has answered that did not do what it was asked for."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

__all__ = ["refused_response"]


def refused_response(error: Mapping[str, Any] | None) -> dict[str, Any] | None:
    """Return the response in an error of the gateway, if a service has said `success: false`.

    For clients of ROS it is a response as any other.
    """
    details: dict[str, Any] = (error or {}).get("details") or {}
    response: Any = details.get("result")
    if not isinstance(response, dict) or response.get("success") is not False:  # pyright: ignore[reportUnknownMemberType]
        return None
    return response  # pyright: ignore[reportUnknownVariableType]
