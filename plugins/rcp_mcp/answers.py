"""Replies of the gateway as tool results: structured, and as text with the remedy."""

from __future__ import annotations

from typing import Any

import msgspec
from mcp import types

from rcp_kernel.errors import RcpError
from rcp_kernel.values import Encoding
from rcp_kernel.wire import NO_BODY, Reply, encode_body, error_body
from rcp_mcp.config import McpConfig
from rcp_mcp.content import Block, show
from rcp_mcp.pictures import View
from rcp_mcp.remedies import in_tools
from rcp_mcp.stops import ESTOP, Report
from rcp_web.untrusted import UNTRUSTED, marked, robot_said

__all__ = ["answered", "body_of", "failed", "plain_of", "refused", "replied"]


def body_of(reply: Reply) -> Any:
    """Return a reply's body as plain JSON data."""
    return None if reply.body is NO_BODY else plain_of(reply.body)


def plain_of(body: Any) -> Any:
    """Return a body as plain JSON data."""
    return msgspec.json.decode(encode_body(body, Encoding.JSON))


def answered(facts: dict[str, Any], *blocks: Block) -> types.CallToolResult:
    """Return facts as a result, also as text unless content blocks are given."""
    content: list[Any] = list(blocks)
    if not content:
        content.append(types.TextContent(type="text", text=msgspec.json.encode(facts).decode()))
    return types.CallToolResult(content=content, structured_content=facts)


def refused(error: RcpError) -> types.CallToolResult:
    """Return an error that the model can act on."""
    return failed(error_body(error), error.status)


def failed(error: dict[str, Any], status: str, **facts: Any) -> types.CallToolResult:
    """Return the contract's `error` object as a result."""
    code, message, remedy = error["code"], error["message"], in_tools(error)
    untrusted = robot_said(error)
    text = f"{status}: {code}: "
    text += marked(message, error.get("path")) if untrusted else message
    if remedy:
        text += f"\nWhat to do: {remedy}"
    details = {key: item for key, item in error.items() if key != "trace_id"}
    if remedy is not None:
        details["remedy"] = remedy
    known = {key: item for key, item in facts.items() if item is not None}
    structured: dict[str, Any] = {"status": status, **known, "error": details}
    if untrusted:
        structured["untrusted"] = True
    block = types.TextContent(
        type="text", text=text, _meta={UNTRUSTED: True} if untrusted else None
    )
    return types.CallToolResult(content=[block], structured_content=structured, is_error=True)


def replied(reply: Reply, config: McpConfig) -> types.CallToolResult:
    """Return the final reply of a write or a command as a result."""
    if reply.path == ESTOP and not reply.dry_run:
        return _stopped(reply)
    if reply.error is not None:
        return failed(reply.error, reply.status, path=reply.path, command=reply.command)
    facts: dict[str, Any] = {"status": reply.status, "path": reply.path, "command": reply.command}
    facts["dry_run"] = True if reply.dry_run else None
    facts["message"] = reply.message
    blocks: list[Block] = []
    body = body_of(reply)
    if body is not None and not reply.dry_run:
        shown = show(
            body,
            reply.path or "",
            budget=config.budget,
            image=config.image,
            view=View(config.pixels),
        )
        facts["result" if shown.whole else "summary"] = shown.plain
        facts["untrusted"] = True if shown.untrusted else None
        blocks = [*shown.blocks]
    elif body is not None:
        facts["would"] = body
    facts = {key: item for key, item in facts.items() if item is not None}
    head = reply.message or f"{reply.path}: {reply.status}."
    if body is not None and reply.dry_run:
        head += " Nothing was done: " + msgspec.json.encode(body).decode()
    return answered(facts, types.TextContent(type="text", text=head), *blocks)


def _stopped(reply: Reply) -> types.CallToolResult:
    """Return the final reply of an emergency stop: which robots are at rest, and which are not."""
    error = reply.error
    if error is None:
        report = Report.of(body_of(reply))
    elif "robots" in (error.get("details") or {}):
        report = Report.of(error["details"])
    else:
        return failed(error, reply.status, path=reply.path)
    facts: dict[str, Any] = {"status": reply.status, "path": reply.path, **report.facts}
    if any("detail" in one for one in report.not_confirmed):
        facts["untrusted"] = True
    lines = [reply.message or f"{reply.path}: {reply.status}."]
    if error is not None:
        facts["error"] = {key: error[key] for key in ("code", "message", "remedy") if key in error}
        lines = [f"{reply.status}: {error['code']}."]
    words = "\n".join([*lines, report.words()]).strip()
    block = types.TextContent(type="text", text=words)
    return types.CallToolResult(
        content=[block], structured_content=facts, is_error=error is not None
    )
