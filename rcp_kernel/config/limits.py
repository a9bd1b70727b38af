"""`[limits]` for everybody, and quotas for those who share a gateway."""

from __future__ import annotations

from typing import Annotated

import msgspec
from msgspec import Meta

__all__ = ["Limits", "Quota", "Quotas"]

_Count = Annotated[int, Meta(ge=1)]


class Limits(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What one client may ask for; sizes in bytes, times in seconds."""

    message: Annotated[int, Meta(ge=1024)] = 16 * 1024 * 1024
    """Longest message or request body, after reassembly."""
    unproved: Annotated[int, Meta(ge=20_480)] = 64 * 1024
    """Longest of a client who has proved nothing, unless `anonymous` may write or execute."""
    values: Annotated[int, Meta(ge=65_536)] = 1024 * 1024
    """In one message: a text counts for 3 of them, a list or map for 9, all fourfold in CBOR."""
    queue_bytes: Annotated[int, Meta(ge=131_072)] = 16 * 1024 * 1024
    """That may wait for one client that takes slower than it is sent."""
    queue_bytes_total: Annotated[int, Meta(ge=1024 * 1024)] = 256 * 1024 * 1024
    """That may wait for all clients together; the first 64 KiB of each do not count."""
    pattern_value: Annotated[int, Meta(ge=262_144)] = 1024 * 1024
    """Longest value that a subscription is sent which names its path by a pattern alone."""
    subscriptions: _Count = 1000
    """Subscriptions of one session."""
    paths: _Count = 20_000
    """Paths that the subscriptions of one session may match together."""
    in_flight: _Count = 4096
    """Unanswered requests of one session."""
    batch: _Count = 256
    """Envelopes in one `batch`."""
    sessions: _Count = 2000
    """Sessions at once, those waiting for a client's return included."""
    session_ttl: Annotated[float, Meta(ge=0)] = 60.0
    """How long a session waits for its client's return."""
    failed_logins: _Count = 30
    """Wrong tokens of one address in a minute, before further wrong ones are refused unseen."""
    heartbeat: Annotated[float, Meta(gt=0)] = 15.0
    """Between pings of an idle connection; two unanswered ones close it."""
    deadline: Annotated[float, Meta(gt=0, le=3600)] = 10.0
    """For a request that names none."""
    action_timeout: Annotated[float, Meta(gt=0)] = 3600.0
    """For an action that declares none."""


class Quota(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """How much somebody may have of the gateway; what is not named is bounded by `Limits` alone."""

    requests: Annotated[float, Meta(gt=0, le=1_000_000)] | None = None
    """A second, on average."""
    burst: _Count | None = None
    """Requests that may come at once; those of one second if not given."""
    sessions: _Count | None = None
    """Connected at once."""
    subscriptions: _Count | None = None
    commands: _Count | None = None
    """Running or waiting for their turn."""
    plans: _Count | None = None
    """Running."""
    queue_bytes: Annotated[int, Meta(ge=1024)] | None = None
    """Waiting for clients that take slower than they are sent."""

    @property
    def pace(self) -> tuple[float, float]:
        """Seconds that a request takes of its share, and how far ahead of it one may be."""
        if self.requests is None:
            return 0.0, float("inf")
        interval = 1.0 / self.requests
        burst = self.burst or max(1, round(self.requests))
        return interval, (burst - 1) * interval + interval * 1e-6


class Quotas(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What holds for those whose roles say nothing."""

    principal: Quota = Quota()
    """Each principal by itself."""
