"""What `[plugins.mcp]` may say."""

from __future__ import annotations

from typing import Annotated

import msgspec
from msgspec import Meta

from rcp_kernel.api import check_pattern

__all__ = ["McpConfig", "check"]

Patterns = tuple[str, ...]


class McpConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The Model Context Protocol. Times in seconds."""

    path: Annotated[str, Meta(pattern=r"^/[A-Za-z0-9_./-]+$")] = "/mcp"
    """Where it is served."""
    url: Annotated[str, Meta(pattern=r"^https?://")] | None = None
    """The gateway's address as clients know it; without it they are told the one they called."""
    message: Annotated[int, Meta(ge=20_480)] = 1_048_576
    """Longest request, in bytes; `[limits]` may say less."""
    tools: Patterns = ("/**",)
    """Actions and services that have a tool of their own."""
    keeps_going: Patterns = ()
    """Actions that go on when the call that began them is cancelled; all others stop the robot."""
    budget: Annotated[int, Meta(ge=200)] = 4000
    """Tokens that one answer has about; longer ones are cut or summarised."""
    image: Annotated[int, Meta(ge=1024)] = 1_000_000
    """Bytes of the largest picture that is shown."""
    wait: Annotated[float, Meta(gt=0, le=3600)] = 45.0
    """A call answers after that long, while its command goes on."""
    feedback: Annotated[float, Meta(gt=0, le=50)] = 4.0
    """Progress notifications of one call a second, at most."""
    sessions: Annotated[int, Meta(ge=1)] = 1000
    """Of clients of the older versions, at a time."""
    idle: Annotated[float, Meta(gt=0)] = 1800.0
    """Until such a session without a request ends."""


def check(config: McpConfig) -> None:
    """Refuse patterns that are none.

    :raises ConfigError: with the key.
    """
    for key in ("tools", "keeps_going"):
        for pattern in getattr(config, key):
            check_pattern(pattern, f"[plugins.mcp] {key}")
