"""The reply to a request that was answered at once, as bytes for the wire."""

from __future__ import annotations

import msgspec

__all__ = ["PromptReply"]


class PromptReply(msgspec.Struct, frozen=True, gc=False):
    """A successful final reply in JSON, spliced around an encoding made earlier."""

    data: bytes
    seq: int = 0
    """Number of the sample that was read; 0 for any other request."""
    stale: bool = False
    """Whether that sample is stale."""
