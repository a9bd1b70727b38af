"""The configuration of `[plugins.a2a]`."""

from __future__ import annotations

from typing import Annotated

import msgspec
from msgspec import Meta

__all__ = ["A2aConfig", "Provider", "PushConfig"]


class Provider(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The provider of the agent, for its card."""

    organization: Annotated[str, Meta(min_length=1)]
    url: Annotated[str, Meta(min_length=1)]


class PushConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Task notifications to addresses given by clients. Times in seconds."""

    enabled: bool = True
    http: bool = False
    """Whether addresses without TLS are allowed."""
    ca: str | None = None
    """A PEM file with CAs to trust in addition to the system's."""
    private: tuple[str, ...] = ()
    """Private networks (`10.0.5.0/24`) that may be called."""
    per_task: Annotated[int, Meta(ge=1, le=100)] = 8
    """Maximum number of addresses per task."""
    queue: Annotated[int, Meta(ge=1)] = 1000
    """Maximum number of queued notifications, over all tasks; the oldest are dropped."""
    attempts: Annotated[int, Meta(ge=1, le=20)] = 5
    timeout: Annotated[float, Meta(gt=0, le=60)] = 10.0
    """Time-out of one attempt."""
    backoff: Annotated[float, Meta(gt=0, le=60)] = 0.5
    """Delay before the second attempt; doubled before each further one."""


class A2aConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The agent. Times in seconds."""

    name: str | None = None
    """Name of the agent; default: the gateway's."""
    description: str | None = None
    url: Annotated[str, Meta(pattern="^https?://[^/?#]+(/[^?#]*)?$")] | None = None
    """Public URL of the gateway; default: by the request's `Host`."""
    documentation: str | None = None
    provider: Provider | None = None
    card_key: str | None = None
    """A private key as PEM (P-256, RSA or Ed25519), or its file: signs the cards."""
    card_max_age: Annotated[int, Meta(ge=0)] = 60
    """Time for which a card may be cached."""
    compatible: bool = True
    """Whether to serve clients of A2A 0.3 as well."""
    message: Annotated[int, Meta(ge=1024)] = 1_048_576
    """Maximum request size, in bytes."""
    tasks_size: Annotated[int, Meta(ge=1024)] = 33_554_432
    """Maximum bytes of tasks per principal and tenant; the oldest ended ones are dropped."""
    tasks: Annotated[int, Meta(ge=1)] = 1000
    """Maximum number of tasks per principal and tenant; the oldest ended ones are dropped."""
    retention: Annotated[float, Meta(gt=0)] = 604_800.0
    """Time for which an ended task is kept."""
    input_timeout: Annotated[float, Meta(gt=0)] = 600.0
    """Time for which a task waits for an answer before it fails."""
    push: PushConfig = PushConfig()
