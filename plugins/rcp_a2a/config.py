"""What `[plugins.a2a]` may say."""

from __future__ import annotations

from typing import Annotated

import msgspec
from msgspec import Meta

__all__ = ["A2aConfig", "Provider", "PushConfig"]


class Provider(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Who answers for the agent, as its card says."""

    organization: Annotated[str, Meta(min_length=1)]
    url: Annotated[str, Meta(min_length=1)]


class PushConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Notifications of tasks to addresses that clients name. Times in seconds."""

    enabled: bool = True
    http: bool = False
    """Whether addresses without TLS are taken."""
    ca: str | None = None
    """A PEM file of CAs that are trusted beside those that everybody trusts."""
    private: tuple[str, ...] = ()
    """Networks (`10.0.5.0/24`) that are no part of the internet and may be called all the same."""
    per_task: Annotated[int, Meta(ge=1, le=100)] = 8
    """Addresses that one task may name."""
    queue: Annotated[int, Meta(ge=1)] = 1000
    """Notifications that wait at most, of all tasks; the oldest give way."""
    attempts: Annotated[int, Meta(ge=1, le=20)] = 5
    timeout: Annotated[float, Meta(gt=0, le=60)] = 10.0
    """Of one attempt."""
    backoff: Annotated[float, Meta(gt=0, le=60)] = 0.5
    """Before the second attempt; doubled before each further one."""


class A2aConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The agent that speaks A2A. Times in seconds."""

    name: str | None = None
    """Of the agent; the gateway's own if not given."""
    description: str | None = None
    url: Annotated[str, Meta(pattern="^https?://[^/?#]+(/[^?#]*)?$")] | None = None
    """Where the gateway is found from outside; else what the request's `Host` says."""
    documentation: str | None = None
    provider: Provider | None = None
    card_key: str | None = None
    """A private key as PEM (P-256, RSA or Ed25519), or its file: cards are signed with it."""
    card_max_age: Annotated[int, Meta(ge=0)] = 60
    """How long a card may be taken from a cache."""
    compatible: bool = True
    """Whether clients of A2A 0.3 are served too."""
    message: Annotated[int, Meta(ge=1024)] = 1_048_576
    """Longest request, in bytes."""
    tasks_size: Annotated[int, Meta(ge=1024)] = 33_554_432
    """Bytes that the tasks of one principal in one tenant may take; the oldest that have ended give way."""
    tasks: Annotated[int, Meta(ge=1)] = 1000
    """That are kept of one principal in one tenant; the oldest that have ended give way."""
    retention: Annotated[float, Meta(gt=0)] = 604_800.0
    """How long a task is kept that has ended."""
    input_timeout: Annotated[float, Meta(gt=0)] = 600.0
    """How long a task waits for an answer; then it has failed."""
    push: PushConfig = PushConfig()
