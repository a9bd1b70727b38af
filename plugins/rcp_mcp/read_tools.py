"""The read-only tools: discover, read, status."""

from __future__ import annotations

import asyncio
from itertools import islice
from typing import Any

import msgspec
from mcp import types
from msgspec import Raw

from rcp_kernel.api import Command, Query, Session
from rcp_kernel.api.pages import cursor_of
from rcp_kernel.client_api import ClientApi
from rcp_kernel.model import Kind
from rcp_kernel.wire import Reply, Request
from rcp_mcp.answers import answered, body_of, failed
from rcp_mcp.catalogue import Catalogue, Facts
from rcp_mcp.config import McpConfig
from rcp_mcp.content import Block, show, speaks, text
from rcp_mcp.fixed import Discover, Read, Status
from rcp_mcp.naming import tool_name
from rcp_mcp.offers import Context, Outcome
from rcp_mcp.provenance import is_own
from rcp_mcp.schemas import worded
from rcp_mcp.summary import PER_TOKEN, cut, size

__all__ = ["ReadTools", "sampled"]

_STEPS = 5  # entries of a command's history in a result
_RUNNING = 20
_HEAVY = 200_000  # bytes of JSON above which images and summaries are made in a thread


class ReadTools:
    """The handlers."""

    def __init__(self, config: McpConfig, client_api: ClientApi, catalogue: Catalogue) -> None:
        self._config = config
        self._client_api = client_api
        self._catalogue = catalogue

    async def discover(self, ctx: Context, session: Session, arguments: Discover) -> Outcome:
        """List matching resources, as many as fit, with a cursor for the rest."""
        self._client_api.charge(session)
        query = Query(
            kind=None if arguments.kind is None else Kind(arguments.kind),
            op=arguments.op,
            q=arguments.q,
            limit=arguments.limit,
            cursor=arguments.cursor,
            schemas=arguments.schemas,
        )
        page = await self._page(session, arguments.path, query)
        typed = {name for name, one in self._catalogue.tools(session).items() if one.listed}
        found = [_line(one, session.tenant, typed) for one in page["resources"]]
        kept = self._fitting(found)
        if kept < len(found):  # the cursor after the items that are included
            query = msgspec.structs.replace(query, limit=kept)
            page = await self._page(session, arguments.path, query)
        facts: dict[str, Any] = {"resources": found[:kept]}
        if (cursor := page.get("cursor")) is not None:
            facts["cursor"] = cursor
            facts["note"] = "There are more results: search with `q`, or continue with `cursor`."
        elif not found:
            facts["note"] = "No matching resources; try fewer words in `q`."
        if all(is_own(one["path"]) for one in facts["resources"]):
            return answered(facts)
        facts["untrusted"] = True
        return answered(facts, text(facts, None, untrusted=True))

    async def _page(self, session: Session, path: str, query: Query) -> dict[str, Any]:
        work = self._client_api.discover(session, path, query)
        return await self._client_api.turns.finish(session.principal.identity, work)

    def _fitting(self, found: list[dict[str, Any]]) -> int:
        left = self._config.budget * PER_TOKEN
        for count, one in enumerate(found):
            left -= size(one) + 1
            if left < 0:
                return max(count, 1)
        return len(found)

    async def read(self, ctx: Context, session: Session, arguments: Read) -> Outcome:
        """Read one value, or those of a pattern."""
        names = ("fields", "fresh", "frame", "cursor")
        options = {name: getattr(arguments, name) for name in names}
        body = Raw(msgspec.json.encode({k: v for k, v in options.items() if v}))
        reply = await self._client_api.request(
            session, Request(type="read", path=arguments.path, body=body)
        )
        if reply.error is not None:
            return failed(reply.error, reply.status)
        found = body_of(reply)
        if "*" in arguments.path:
            samples = [_renamed(one) for one in found]
        else:
            samples = [
                {
                    "path": reply.path,
                    "status": reply.status,
                    "value": found,
                    "timestamp": reply.source_timestamp,
                    "state": reply.state,
                }
            ]
        many = "*" in arguments.path
        if size(samples) < _HEAVY:
            return sampled("values", samples, self._config, pages=many, more=reply.truncated)
        return await asyncio.to_thread(
            sampled, "values", samples, self._config, pages=many, more=reply.truncated
        )

    async def _ended(self, command: Command, patience: float) -> None:
        """Wait until a command has ended, or for so long."""
        ended = asyncio.Event()

        def note(reply: Reply) -> None:
            if reply.final:
                ended.set()

        forget = self._client_api.follow(command, note)
        try:
            if not command.final:
                async with asyncio.timeout(patience):
                    await ended.wait()
        except TimeoutError:
            pass
        finally:
            forget()

    async def status(self, ctx: Context, session: Session, arguments: Status) -> Outcome:
        """Return the status of the gateway, or of one command."""
        if arguments.command is not None:
            found = self._client_api.command(session, arguments.command)
            if arguments.wait:
                await self._ended(found, arguments.wait)
            command = found.plain()
            command["history"] = command["history"][-_STEPS:]
            plain = msgspec.json.decode(msgspec.json.encode(command))
            return _bounded({"command": plain}, self._config.budget)
        reply = await self._client_api.request(session, Request(type="status"))
        if reply.error is not None:
            return failed(reply.error, reply.status)
        health = body_of(reply)
        known = self._client_api.commands(session)
        running = list(islice((c for c in known if c is not None and not c.final), _RUNNING))
        keys = ("name", "tenant", "state", "detail", "since")
        facts: dict[str, Any] = {
            "state": health.get("state"),
            "backends": [
                {key: one[key] for key in keys if one.get(key) is not None}
                for one in health.get("backends", ())
            ],
            "running": [
                {"command": c.id, "path": c.path, "status": c.status, "progress": c.progress}
                for c in running
            ],
            "warnings": [
                one.get("message") if isinstance(one, dict) else one
                for one in health.get("warnings", ())[-_STEPS:]
            ],
        }
        return _bounded(facts, self._config.budget)


def sampled(
    key: str,
    samples: list[dict[str, Any]],
    config: McpConfig,
    *,
    pages: bool = False,
    more: bool = False,
    **facts: Any,
) -> types.CallToolResult:
    """Return samples as a result, each with its share of the space.

    Those of `pages` are ordered by path, so that a cursor leads to the omitted ones, and to the
    next page if there is `more`.
    """
    share = max(config.budget // max(len(samples), 1), 40)
    items: list[dict[str, Any]] = []
    blocks: list[Block] = []
    shown_as: list[Block] = []
    left = config.budget * PER_TOKEN
    for sample in samples:
        one = {name: item for name, item in sample.items() if item is not None}
        if "value" in one:
            shown = show(one.pop("value"), one["path"], budget=share, image=config.image)
            one["value" if shown.whole else "summary"] = shown.plain
            if shown.untrusted:
                one["untrusted"] = True
            shown_as += shown.blocks[1:]
        left -= size(one)
        if left < 0 and items:
            facts["note"] = (
                f"{len(samples) - len(items)} more are omitted: use fewer paths, or `fields`."
            )
            more = True
            break
        items.append(one)
        blocks.append(text(one, one["path"], untrusted=bool(one.get("untrusted"))))
    if more:
        facts["truncated"] = True
    if more and pages:
        facts["cursor"] = cursor_of(items[-1]["path"])
        facts["note"] = (
            "There are more results: use fewer paths, or `fields`, or continue with `cursor`."
        )
    head = facts.get("note")
    content = [types.TextContent(type="text", text=head)] if head else []
    result = answered({key: items, **facts}, *blocks, *shown_as, *content)
    if not samples:
        return answered({key: [], "note": "No matching resource that you may read."})
    return result


def _renamed(item: dict[str, Any]) -> dict[str, Any]:
    """Convert an item of a multiple read to the form of `read`."""
    kept = ("path", "status", "timestamp", "state", "error")
    return {"value": item.get("body")} | {key: item[key] for key in kept if key in item}


def _line(one: Facts, tenant: str | None, typed: set[str]) -> dict[str, Any]:
    """Describe one resource briefly, or with its schemas if requested."""
    line: dict[str, Any] = {
        "path": one["path"],
        "operations": one["operations"],
        "description": one["description"],
    }
    line |= {key: one[key] for key in ("unit", "atomic") if key in one}
    if one.get("state") in ("stale", "down", "never"):
        line["state"] = one["state"]
    name = tool_name(one["path"], tenant)
    if name in typed:
        line["tool"] = name
    if "schemas" in one:
        schemas = dict(one["schemas"])
        if "command_schema" in one:
            schemas["command"] = one["command_schema"]
        line["schemas"] = worded(schemas)
        line["examples"] = msgspec.json.decode(msgspec.json.encode(one["examples"]))
    return line


def _bounded(facts: dict[str, Any], budget: int) -> types.CallToolResult:
    if size(facts) > budget * PER_TOKEN:
        facts = {key: cut(item, budget // len(facts)) for key, item in facts.items()}
    if not speaks({key: facts.get(key) for key in ("command", "backends", "warnings")}):
        return answered(facts)
    return answered(facts, text(facts, None, untrusted=True))
