"""A query of recordings, as the gateway passes it to the process that answers it."""

from __future__ import annotations

from typing import Any, Literal

import msgspec

from rcp_protocol.values import Encoding

__all__ = ["STREAMED", "Format", "Query"]

Format = Literal["json", "csv", "arrow", "parquet", "mcap", "ros2"]
STREAMED: tuple[Format, ...] = ("csv", "arrow", "parquet", "mcap", "ros2")
"""What has everything in one answer."""


class Query(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """What is wanted of which files."""

    files: tuple[tuple[str, int | None], ...]
    """With the bytes that are complete, of those that are being written."""
    earlier: tuple[tuple[str, int | None], ...] = ()
    """Files that end before `start`, for `before`."""
    paths: frozenset[str]
    """Resources."""
    others: frozenset[str] = frozenset()
    """Resources whose commands and events are wanted too, for a copy."""
    tenant: bool = False
    """Whether e-stops are wanted too, for a copy."""
    start: int = 0
    end: int = 2**63 - 1
    """ns since the epoch; the end is not a part of it."""
    before: int = 0
    """Samples of each resource before `start`, to begin with."""
    room: int = 2**20
    """Bytes of all these; what does not fit is named."""
    named: bool = False
    """Whether each sample has its path: there may be several."""
    every: int | None = None
    """Length of an interval, ns."""
    thin: bool = False
    """The first sample of each interval in place of a summary of it."""
    fields: tuple[str, ...] = ()
    format: Format = "json"
    limit: int = 1000
    """Rows of a page."""
    skip: int = 0
    """Rows of `start` that the page before had."""
    facts: dict[str, Any] = {}
    """What a page has besides, ahead of its rows."""
    encoding: Encoding = Encoding.JSON
    """Of a page."""
    apart: bool = False
    """Whether the cursor is a line of its own before the page, empty if there is none."""
    name: str = ""
    """Of the recording, for a copy."""
