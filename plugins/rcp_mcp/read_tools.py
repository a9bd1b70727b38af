"""The tools `discover` and `status`."""

from __future__ import annotations

import asyncio
from itertools import islice
from typing import Any

import msgspec
from mcp import types

from rcp_gateway.api import Command, Query, Session
from rcp_gateway.client_api import ClientApi
from rcp_kernel.model import Kind
from rcp_kernel.wire import Reply, Request
from rcp_mcp.answers import answered, body_of, failed
from rcp_mcp.catalogue import Catalogue, Facts
from rcp_mcp.config import McpConfig
from rcp_mcp.content import text
from rcp_mcp.fixed import Discover, Status
from rcp_mcp.naming import tool_name
from rcp_mcp.offers import Context, Outcome
from rcp_mcp.provenance import is_own
from rcp_mcp.schemas import without_defaults, worded
from rcp_mcp.summary import PER_TOKEN, cut, size
from rcp_mcp.typed import is_read_only
from rcp_protocol.timeouts import timeout
from rcp_web.untrusted import speaks

__all__ = ["ReadTools"]

_STEPS = 5  # entries of a command's history in a result
_RUNNING = 20
_COMMANDED = frozenset(("write", "execute"))
_SHORT = 160  # bytes of an example in a list


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

    async def _ended(self, command: Command, patience: float) -> None:
        """Wait until a command has ended, or for so long."""
        ended = asyncio.Event()

        def note(reply: Reply) -> None:
            if reply.final:
                ended.set()

        forget = self._client_api.follow(command, note)
        try:
            if not command.final:
                async with timeout(patience):
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


def _line(one: Facts, tenant: str | None, typed: set[str]) -> dict[str, Any]:
    """Describe one resource briefly, or with its schemas if requested."""
    line: dict[str, Any] = {
        "path": one["path"],
        "operations": one["operations"],
        "description": one["description"],
    }
    line |= {key: one[key] for key in ("unit", "atomic") if key in one}
    if "schemas" not in one and (example := _example(one)) is not None:
        line["example"] = example
    if is_read_only(one):
        line["read_only"] = True
    if one.get("state") in ("stale", "down", "never"):
        line["state"] = one["state"]
    name = tool_name(one["path"], tenant)
    if name in typed:
        line["tool"] = name
    if "schemas" in one:
        line["schemas"] = worded(_schemas(one))
        line["examples"] = msgspec.json.decode(msgspec.json.encode(one["examples"]))
    return line


def _schemas(one: Facts) -> Facts:
    """Return what a model needs to know before it acts; a result explains itself."""
    schemas: Facts = one["schemas"]
    if "execute" not in one["operations"]:
        return schemas
    given = one.get("command_schema") or schemas.get("input")
    return {"input": None if given is None else without_defaults(given)}


def _example(one: Facts) -> Any:
    """Return a short input of what can be commanded: often all that a model needs of its schema."""
    examples: list[Any] = one.get("examples") or []
    if not examples or _COMMANDED.isdisjoint(one["operations"]):
        return None
    example = msgspec.to_builtins(examples[0])
    return example if size(example) <= _SHORT else None


def _bounded(facts: dict[str, Any], budget: int) -> types.CallToolResult:
    if size(facts) > budget * PER_TOKEN:
        facts = {key: cut(item, budget // len(facts)) for key, item in facts.items()}
    if not speaks({key: facts.get(key) for key in ("command", "backends", "warnings")}):
        return answered(facts)
    facts["untrusted"] = True
    return answered(facts, text(facts, None, untrusted=True))
