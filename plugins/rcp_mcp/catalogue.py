"""What a caller may see of the tree, and the tools made of it; made anew when that changes."""

from __future__ import annotations

from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

from mcp import types

from rcp_kernel.access.acl import Rights
from rcp_kernel.client_api import ClientApi
from rcp_kernel.clients.session import Session
from rcp_kernel.model import Pattern, tenant_of
from rcp_kernel.operations.discovery import Query
from rcp_mcp.config import McpConfig
from rcp_mcp.schemas import Arguments
from rcp_mcp.typed import typed_tool

__all__ = ["Catalogue", "Facts", "Typed", "matches"]

Facts = dict[str, Any]
_PAGE = 1000
_PLANS = "/system/plans"  # wants approval for the steps it has


class Typed(NamedTuple):
    """The tool of one action or service."""

    tool: types.Tool
    facts: Facts
    arguments: Arguments


class _Seen:
    """What one set of rights sees of one generation of the tree."""

    def __init__(self, generation: int, facts: list[Facts]) -> None:
        self.generation = generation
        self.facts = facts
        self.by_path = {one["path"]: one for one in facts}
        self.tools: dict[str | None, dict[str, Typed]] = {}


class Catalogue:
    """The trees as callers see them."""

    def __init__(self, config: McpConfig, client_api: ClientApi) -> None:
        self._config = config
        self._client_api = client_api
        self._seen: WeakKeyDictionary[Rights, _Seen] = WeakKeyDictionary()

    def all(self, session: Session) -> list[Facts]:
        """List what a session may see, in order of path."""
        return self._of(session).facts

    def find(self, session: Session, path: str) -> Facts | None:
        """Return what a session may see at a path."""
        return self._of(session).by_path.get(path)

    def tools(self, session: Session) -> dict[str, Typed]:
        """Return the tools of what a session may execute, by name."""
        seen = self._of(session)
        found = seen.tools.get(session.tenant)
        if found is None:
            found = seen.tools[session.tenant] = dict(self._made(session, seen.facts))
        return found

    def _made(self, session: Session, facts: list[Facts]) -> list[tuple[str, Typed]]:
        made: list[tuple[str, Typed]] = []
        for one in facts:
            path = one["path"]
            if "execute" in one["operations"] and matches(self._config.tools, path):
                stops = not matches(self._config.keeps_going, path)
                asks = path == _PLANS or session.rights.asks(path)
                tool, arguments = typed_tool(
                    one, session.tenant, self._config, stops=stops, asks=asks
                )
                made.append((tool.name, Typed(tool, one, arguments)))
        return made

    def _of(self, session: Session) -> _Seen:
        generation = self._client_api.generation(session)
        seen = self._seen.get(session.rights)
        if seen is None or seen.generation != generation:
            seen = self._seen[session.rights] = _Seen(generation, self._read(session))
        return seen

    def _read(self, session: Session) -> list[Facts]:
        facts: list[Facts] = []
        cursor: str | None = None
        while True:
            page = self._client_api.discover(session, "/**", Query(limit=_PAGE, cursor=cursor))
            facts += page["resources"]
            cursor = page.get("cursor")
            if cursor is None:
                return facts


def matches(patterns: tuple[str, ...], path: str) -> bool:
    """Tell whether a path is one of those that patterns of the configuration mean."""
    tenant = tenant_of(path)
    return any(text == "/**" or Pattern(text, tenant).matches(path) for text in patterns)
