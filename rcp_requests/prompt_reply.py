"""The reply to a request that was answered at once, as bytes for the wire."""

from __future__ import annotations

import msgspec

__all__ = ["PromptReply"]


class PromptReply(msgspec.Struct, frozen=True, gc=False):
    """A final reply in JSON that tells no error, spliced around what was encoded before."""

    data: bytes
    seq: int = 0
    """Number of the sample that was read; of another request 0."""
    stale: bool = False
    """Whether that sample has a successor overdue."""
