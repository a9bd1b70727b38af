"""The configuration of what clients offer in one tenant."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, Struct

__all__ = ["ClientsConfig"]

_Count = Annotated[int, Meta(ge=1, le=1000)]
_Seconds = Annotated[float, Meta(gt=0, le=86_400)]


class ClientsConfig(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Limits. Times in seconds."""

    offers: _Count = 256
    """Services and actions offered at a time."""
    offers_of_one: _Count = 64
    """Those of one principal."""
    waiting: _Count = 16
    """Calls of one service or action that are not answered."""
    service_timeout: _Seconds = 10.0
    """For the response of a service."""
    action_timeout: _Seconds = 3600.0
    """For the result of an action."""
