"""What a list of tools costs a model to read, by an estimate that needs no vocabulary."""

from __future__ import annotations

from collections.abc import Sequence

from mcp import types

__all__ = ["fitting", "tokens_of"]

_BYTES = 4
"""Bytes of JSON per token: models differ, and English text and schemas have 3.5 to 4.5."""


def tokens_of(tool: types.Tool) -> int:
    """Estimate the tokens of a tool, as it is sent."""
    return -(-len(tool.model_dump_json(by_alias=True, exclude_none=True).encode()) // _BYTES)


def fitting(tools: Sequence[types.Tool], most: int) -> int:
    """Count the first tools that have at most `most` tokens together; at least one."""
    for count, tool in enumerate(tools):
        most -= tokens_of(tool)
        if most < 0:
            return max(count, 1)
    return len(tools)
