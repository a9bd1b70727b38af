"""Completion in shells: paths, robots and commands, as the gateway has them now."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Iterable
from typing import Any

import click
from click.shell_completion import CompletionItem

from rcp_client.client import Client
from rcp_client.console import unwaited
from rcp_client.console.gateway import named_gateway
from rcp_protocol.timeouts import timeout

__all__ = ["candidates"]

_WAIT = 2.0  # s that a person waits after Tab
_MOST = 1000
Ask = Callable[[Client], Awaitable[Iterable[tuple[str, str]]]]


def candidates(ctx: click.Context, incomplete: str, what: str) -> list[CompletionItem]:
    """Ask the gateway for what may be written; nothing if it does not answer."""
    options: dict[str, Any] = ctx.find_root().ensure_object(dict)
    try:
        found = unwaited.run(_asked(options, _ASKS.get(what) or _paths_with(what), incomplete))
    except Exception:  # a shell's line is no place for errors
        return []
    return [
        CompletionItem(value, help=note or None)
        for value, note in sorted(set(found))
        if value.startswith(incomplete)
    ][:_MOST]


async def _asked(options: dict[str, Any], ask: Ask, incomplete: str) -> list[tuple[str, str]]:
    async with timeout(_WAIT):
        client = named_gateway(options, deadline=_WAIT, within=_WAIT, patience=_WAIT)
        async with client:
            found = list(await ask(client))
            own = f"/tenant/{client.greeting.get('tenant')}"
    if incomplete.startswith("/tenant/"):
        return found
    # Those of one's own tenant are written without it.
    return [(name.removeprefix(own) if name != own else name, note) for name, note in found]


def _paths_with(operation: str) -> Ask:
    async def ask(client: Client) -> Iterable[tuple[str, str]]:
        op = None if operation == "any" else operation
        listed = await client.discover("/**", op=op, schemas=False)
        return [(one.path, one.description.partition("\n")[0]) for one in listed]

    return ask


async def _robots(client: Client) -> Iterable[tuple[str, str]]:
    return [(one["path"], one.get("kind") or "") for one in await client.robots()]


async def _commands(client: Client) -> Iterable[tuple[str, str]]:
    listed = await client.commands()
    return [(one["command"], one["path"]) for one in listed if "finished" not in one]


async def _approvals(client: Client) -> Iterable[tuple[str, str]]:
    listed = await client.approvals()
    return [(one["approval"], one["path"]) for one in listed if one["status"] == "pending"]


_ASKS: dict[str, Ask] = {"robots": _robots, "commands": _commands, "approvals": _approvals}
