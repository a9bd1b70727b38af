"""`rcpctl mcp tools`: the tools that a model sees, and what they cost it to read."""

from __future__ import annotations

import asyncio
import json
from typing import Any

from rcp_client.client import Client
from rcp_client.console.output import Output, clean
from rcp_client.console.whole import post

__all__ = ["tools"]

_FAILED = 1
_BYTES = 4  # of JSON per token
_VERSION = "2026-07-28"
_METHOD = "tools/list"
_META = "io.modelcontextprotocol/"


async def tools(client: Client, out: Output, args: dict[str, Any]) -> int:
    """List the tools, with `cost` the most expensive first."""
    found: list[dict[str, Any]] = []
    pages, cursor = 0, None
    while not pages or cursor is not None:
        page = await asyncio.to_thread(_page, client, args["path"], cursor)
        if page is None:
            out.aside(f"rcpctl: there is no MCP server at {args['path']}: see [plugins.mcp].")
            return _FAILED
        found += page["tools"]
        cursor = page.get("nextCursor")
        pages += 1
    rows = [(one["name"], _tokens(one), one.get("description") or "") for one in found]
    if args["cost"]:
        rows.sort(key=lambda row: -row[1])
    if out.json:
        for name, tokens, words in rows:
            out.document({"tool": name, "tokens": tokens, "description": words})
    elif args["cost"]:
        out.table(("TOOL", "TOKENS"), [(name, tokens) for name, tokens, _ in rows])
        out.line(f"About {sum(row[1] for row in rows)} tokens in {pages} page(s).")
    else:
        out.table(("TOOL", "DESCRIPTION"), [(name, clean(words)[:100]) for name, _, words in rows])
    return 0


def _tokens(tool: dict[str, Any]) -> int:
    text = json.dumps(tool, ensure_ascii=False, separators=(",", ":"))
    return -(-len(text.encode()) // _BYTES)


def _page(client: Client, path: str, cursor: str | None) -> dict[str, Any] | None:
    """Return one page of the list; None if nothing answers in the protocol."""
    meta = {
        f"{_META}protocolVersion": _VERSION,
        f"{_META}clientInfo": {"name": "rcpctl", "version": "1"},
        f"{_META}clientCapabilities": {},
    }
    params = {"_meta": meta} | ({} if cursor is None else {"cursor": cursor})
    body = {"jsonrpc": "2.0", "id": 1, "method": _METHOD, "params": params}
    headers = {
        "Accept": "application/json, text/event-stream",
        "Mcp-Protocol-Version": _VERSION,
        "Mcp-Method": _METHOD,
    }
    if client.settings.tenant is not None:
        headers["X-RCP-Tenant"] = client.settings.tenant
    data = post(client, path, body, client.settings.deadline, headers)
    for line in data.decode(errors="replace").splitlines():
        try:
            message = json.loads(line.removeprefix("data:"))
        except ValueError:
            continue
        if isinstance(message, dict) and isinstance(message.get("result"), dict):  # pyright: ignore[reportUnknownMemberType]
            return message["result"]
    return None
