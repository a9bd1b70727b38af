"""Samples as a result: values with their times, pictures with where the robot was."""

from __future__ import annotations

from typing import Any

from mcp import types

from rcp_gateway.api.pages import cursor_of
from rcp_mcp.answers import answered
from rcp_mcp.config import McpConfig
from rcp_mcp.content import Block, show, text
from rcp_mcp.pictures import View
from rcp_mcp.summary import PER_TOKEN, size

__all__ = ["sampled"]

Sample = dict[str, Any]


def sampled(
    key: str,
    samples: list[Sample],
    config: McpConfig,
    view: View,
    *,
    pages: bool = False,
    more: bool = False,
    **facts: Any,
) -> types.CallToolResult:
    """Return samples as a result, each with its share of the space.

    Those of `pages` are ordered by path, so that a cursor leads to the omitted ones, and to the
    next page if there is `more`. `pose` of a sample is where its robot was.
    """
    share = max(config.budget // max(len(samples), 1), 40)
    items: list[Sample] = []
    blocks: list[Block] = []
    left = config.budget * PER_TOKEN
    for sample in samples:
        one, shown = _item(sample, config, view, share)
        left -= size(one)
        if left < 0 and items:
            facts["note"] = (
                f"{len(samples) - len(items)} more are omitted: use fewer paths, or `fields`."
            )
            more = True
            break
        items.append(one)
        if len(samples) > 1 and any(isinstance(block, types.ImageContent) for block in shown):
            blocks.append(types.TextContent(type="text", text=f"{one['path']}:"))
        blocks += shown
    if more:
        facts["truncated"] = True
    if more and pages:
        facts["cursor"] = cursor_of(items[-1]["path"])
        facts["note"] = (
            "There are more results: use fewer paths, or `fields`, or continue with `cursor`."
        )
    rest = {name: item for name, item in facts.items() if name != "note"}
    told: list[Block] = (
        [types.TextContent(type="text", text=facts["note"])] if "note" in facts else []
    )
    if rest:
        told.append(text(rest, None, untrusted=False))
    if not samples:
        facts.setdefault("note", "No matching resource that you may read.")
        return answered({key: [], **facts})
    return answered({key: items, **facts}, *_written(items), *blocks, *told)


def _item(sample: Sample, config: McpConfig, view: View, share: int) -> tuple[Sample, list[Block]]:
    """Return what is told of a sample, and its pictures and links."""
    one = {name: item for name, item in sample.items() if item is not None}
    if "value" not in one:
        return one, []
    shown = show(
        one.pop("value"),
        one["path"],
        budget=share,
        image=config.image,
        view=view,
        pose=one.get("pose"),
    )
    one["value" if shown.whole else "summary"] = shown.plain
    if shown.untrusted:
        one["untrusted"] = True
    return one, shown.blocks[1:]


def _written(items: list[Sample]) -> list[Block]:
    """Write the items as text: those with text of a robot together, in marks."""
    blocks: list[Block] = []
    for untrusted in (True, False):
        found = [one for one in items if bool(one.get("untrusted")) is untrusted]
        if found:
            path = found[0]["path"] if len(found) == 1 else None
            plain = found[0] if len(found) == 1 else found
            blocks.append(text(plain, path, untrusted=untrusted))
    return blocks
