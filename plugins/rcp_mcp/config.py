"""The configuration of `[plugins.mcp]`."""

from __future__ import annotations

from typing import Annotated

import msgspec
from msgspec import Meta

from rcp_gateway.api import check_pattern

__all__ = ["McpConfig", "check"]

Patterns = tuple[str, ...]


class McpConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The Model Context Protocol. Times in seconds."""

    path: Annotated[str, Meta(pattern=r"^/[A-Za-z0-9_./-]+$")] = "/mcp"
    """Path of the endpoint."""
    url: Annotated[str, Meta(pattern=r"^https?://")] | None = None
    """The gateway's URL as clients know it; default: the one of the request."""
    message: Annotated[int, Meta(ge=20_480)] = 1_048_576
    """Maximum request size, in bytes; `[limits]` may be lower."""
    tools: Patterns | None = None
    """Actions and services that get their own tool; default: none but those of `profiles`."""
    profiles: tuple[str, ...] = ()
    """Profiles whose actions and services get their own tool, such as `mobile`."""
    page: Annotated[int, Meta(ge=1000)] = 6000
    """Maximum tokens of one page of tools, unless a single tool is longer."""
    keeps_going: Patterns = ()
    """Actions that continue when their call is cancelled; others stop the robot."""
    budget: Annotated[int, Meta(ge=200)] = 4000
    """Approximate number of tokens per response; longer ones are cut or summarised."""
    image: Annotated[int, Meta(ge=1024)] = 1_000_000
    """Maximum size of an image, in bytes."""
    pixels: Annotated[int, Meta(ge=16, le=4096)] = 640
    """Longest side of an image or map, unless the call asks for another `size`."""
    wait: Annotated[float, Meta(gt=0, le=3600)] = 45.0
    """Time after which a call returns while its command continues."""
    feedback: Annotated[float, Meta(gt=0, le=50)] = 4.0
    """Maximum rate of progress notifications per call, per second."""
    sessions: Annotated[int, Meta(ge=1)] = 1000
    """Maximum number of sessions of clients with older protocol versions."""
    idle: Annotated[float, Meta(gt=0)] = 1800.0
    """Time without a request after which such a session ends."""
    subscriptions: Annotated[int, Meta(ge=1)] = 1000
    """Maximum number of resources that a client listens to; they need not exist."""


def check(config: McpConfig) -> None:
    """Refuse invalid patterns.

    :raises ConfigError: names the key.
    """
    for key in ("tools", "keeps_going"):
        for pattern in getattr(config, key) or ():
            check_pattern(pattern, f"[plugins.mcp] {key}")
