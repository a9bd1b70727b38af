"""How long a link waits."""

from __future__ import annotations

import msgspec

__all__ = ["LinkTiming"]


class LinkTiming(msgspec.Struct, frozen=True, kw_only=True):
    """Times of a link, in seconds on the event loop's clock."""

    silence: float = 2.0
    """Without any message for this long the link is lost; also the time to connect. A probe is sent
    three times in it."""
    first_pause: float = 0.25
    """Before the second attempt to connect; it doubles with each further one."""
    longest_pause: float = 5.0
