"""`[safety]`: what holds for everybody who commands a robot."""

from __future__ import annotations

from typing import Annotated

import msgspec
from msgspec import Meta

__all__ = ["Safety"]


class Safety(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Control of robots; times in seconds."""

    lease_required: tuple[str, ...] = ()
    """Patterns of paths that are commanded only under a lease."""
    lease_ttl: Annotated[float, Meta(gt=0)] = 10.0
    """How long a lease lasts whose `acquire` or `renew` does not say."""
    lease_ttl_max: Annotated[float, Meta(gt=0)] = 300.0
    """Longest that may be asked for."""
    approval_ttl: Annotated[float, Meta(gt=0, le=86_400)] = 300.0
    """How long what wants a person's approval can be approved and sent."""
