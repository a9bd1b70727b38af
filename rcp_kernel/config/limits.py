"""`[limits]`: what the gateway accepts from one client, and from all of them."""

from __future__ import annotations

from typing import Annotated

import msgspec
from msgspec import Meta

__all__ = ["Limits"]

_Count = Annotated[int, Meta(ge=1)]


class Limits(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Limits per client; sizes in bytes, times in seconds."""

    message: Annotated[int, Meta(ge=1024)] = 16 * 1024 * 1024
    """Maximum message or request body, after reassembly."""
    unproved: Annotated[int, Meta(ge=20_480)] = 64 * 1024
    """Maximum message before authentication, unless `anonymous` may write or execute."""
    values: Annotated[int, Meta(ge=65_536)] = 256 * 1024
    """Maximum values in one message: a text counts as 3, a list or map as 9, all fourfold in CBOR."""
    queue_bytes: Annotated[int, Meta(ge=131_072)] = 16 * 1024 * 1024
    """Unread bytes of one client."""
    queue_bytes_total: Annotated[int, Meta(ge=1024 * 1024)] = 256 * 1024 * 1024
    """Unread bytes of all clients together; the first 64 KiB of each do not count."""
    pattern_value: Annotated[int, Meta(ge=262_144)] = 1024 * 1024
    """Longest value sent to a subscription that matches its path only by a pattern."""
    subscriptions: _Count = 1000
    """Subscriptions of one session."""
    paths: _Count = 20_000
    """Paths that the subscriptions of one session may match together."""
    in_flight: _Count = 4096
    """Unanswered requests of one session."""
    batch: _Count = 256
    """Envelopes in one `batch`."""
    sessions: _Count = 2000
    """Concurrent sessions, including those of disconnected clients."""
    session_ttl: Annotated[float, Meta(ge=0, le=1e9)] = 60.0
    """How long the session of a disconnected client is kept."""
    failed_logins: _Count = 30
    """Invalid tokens per minute and address, before further ones are `rate_limited`."""
    heartbeat: Annotated[float, Meta(gt=0, le=1e9)] = 15.0
    """Between pings of an idle connection; two unanswered ones close it."""
    deadline: Annotated[float, Meta(gt=0, le=3600)] = 10.0
    """Of a request without one."""
    action_timeout: Annotated[float, Meta(gt=0)] = 3600.0
    """Of an action that declares none."""
