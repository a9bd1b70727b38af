"""The resources that a caller may see, and the tools made from them; updated with the tree."""

from __future__ import annotations

from collections.abc import Generator
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

from mcp import types

from rcp_gateway.api import Query, Rights, Session, SharedWork, at_once
from rcp_gateway.client_api import ClientApi
from rcp_kernel.model import Pattern, tenant_of
from rcp_mcp.config import McpConfig
from rcp_mcp.fixed import PLANS
from rcp_mcp.provenance import Marker
from rcp_mcp.schemas import Arguments
from rcp_mcp.stops import ESTOP
from rcp_mcp.typed import typed_tool

__all__ = ["Catalogue", "Facts", "Typed", "matches"]

Facts = dict[str, Any]
_PAGE = 10  # resources read per step


class Typed(NamedTuple):
    """The tool of one action or service."""

    tool: types.Tool
    facts: Facts
    arguments: Arguments
    listed: bool
    """Whether the list of tools has it; others are run by `execute`."""


class _Seen:
    """The view of one generation of the tree with one set of rights."""

    def __init__(self, generation: int) -> None:
        self.generation = generation
        self.facts: list[Facts] = []
        self.by_path: dict[str, Facts] = {}
        self.tools: dict[str | None, dict[str, Typed]] = {}


class Catalogue:
    """The views of the tree, by caller."""

    def __init__(self, config: McpConfig, client_api: ClientApi) -> None:
        self._config = config
        self._client_api = client_api
        self.marker = Marker()
        """Marks what robots say of themselves in lists."""
        self._seen: WeakKeyDictionary[Rights, _Seen] = WeakKeyDictionary()
        self._reading = SharedWork[None](client_api.loop)

    async def prepare(self, session: Session) -> None:
        """Read a session's view in steps, so that later calls need not read all of it at once."""
        if self._current(session) is None:
            turns, owner = self._client_api.turns, session.principal.identity
            key = (self._client_api.generation(session), session.rights, session.tenant)
            await self._reading.result(key, lambda: turns.finish(owner, self._read(session)))

    def all(self, session: Session) -> list[Facts]:
        """List what a session may see, ordered by path."""
        return self._of(session).facts

    def find(self, session: Session, path: str) -> Facts | None:
        """Return the resource at a path, if the session may see it."""
        return self._of(session).by_path.get(path)

    def tools(self, session: Session) -> dict[str, Typed]:
        """Return the tools for what a session may execute, by name."""
        return self._of(session).tools[session.tenant]

    def ready(self, session: Session) -> dict[str, Typed] | None:
        """Return the tools like `tools` if they have been read, otherwise None."""
        seen = self._current(session)
        return None if seen is None else seen.tools[session.tenant]

    def read_one(self, session: Session, path: str) -> dict[str, Typed]:
        """Return the tool of a path, by its name, without reading the others."""
        tools: dict[str, Typed] = {}
        for one in at_once(self._client_api.discover(session, path, Query(limit=1)))["resources"]:
            self._add(session, one, tools)
        return tools

    def _current(self, session: Session) -> _Seen | None:
        seen = self._seen.get(session.rights)
        if seen is None or seen.generation != self._client_api.generation(session):
            return None
        return seen if session.tenant in seen.tools else None

    def _of(self, session: Session) -> _Seen:
        seen = self._current(session)
        if seen is None:
            for _ in self._read(session):  # the tree has changed since `prepare`
                pass
            seen = self._seen[session.rights]
        return seen

    def _read(self, session: Session) -> Generator[None]:
        """Read a session's view and build its tools, in steps."""
        seen = _Seen(self._client_api.generation(session))
        query: Query | None = Query(limit=_PAGE)
        tools: dict[str, Typed] = {}
        while query is not None:
            page = yield from self._client_api.discover(session, "/**", query)
            for one in page["resources"]:
                seen.facts.append(one)
                seen.by_path[one["path"]] = one
                self._add(session, one, tools)
            cursor = page.get("cursor")
            query = None if cursor is None else Query(limit=_PAGE, cursor=cursor)
            yield
        known = self._seen.get(session.rights)
        if known is not None and known.generation == seen.generation:
            seen.tools = known.tools
        seen.tools[session.tenant] = tools
        self._seen[session.rights] = seen

    def _add(self, session: Session, one: Facts, tools: dict[str, Typed]) -> None:
        path = one["path"]
        chosen = self._config.tools or ()
        listed = path == ESTOP or matches(chosen, path) or self._has_profile(one)
        # By name, a client can also call what is not listed, unless the configuration chooses.
        if "execute" in one["operations"] and (listed or self._config.tools is None):
            stops = not matches(self._config.keeps_going, path)
            asks = path == PLANS or session.rights.asks(path)
            tool, arguments = typed_tool(
                one, session.tenant, self._config, self.marker, stops=stops, asks=asks
            )
            tools[tool.name] = Typed(tool, one, arguments, listed)

    def _has_profile(self, one: Facts) -> bool:
        named = (str(profile).partition("/")[0] for profile in one.get("profiles", ()))
        return any(name in self._config.profiles for name in named)


def matches(patterns: tuple[str, ...], path: str) -> bool:
    """Return whether a path matches patterns of the configuration."""
    tenant = tenant_of(path)
    return any(text == "/**" or Pattern(text, tenant).matches(path) for text in patterns)
