"""The components of a request's URL: tenant, binding and path."""

from __future__ import annotations

import msgspec

from rcp_a2a.refusals import Binding

__all__ = ["CARD", "JWKS", "PREFIX", "Place", "place_of"]

PREFIX = "/a2a"
CARD = "/.well-known/agent-card.json"
JWKS = "/.well-known/jwks.json"
_REST = ("message:send", "message:stream", "tasks", "extendedAgentCard", "v1", ".well-known")


class Place(msgspec.Struct, frozen=True):
    """A location below the prefix."""

    tenant: str | None
    rest: str
    """The path after the tenant; `/` is the JSON-RPC endpoint."""

    @property
    def binding(self) -> Binding:
        """The binding at this location."""
        return "jsonrpc" if self.rest == "/" else "rest"


def place_of(path: str) -> Place:
    """Parse a path; an otherwise unknown first segment is a tenant."""
    if path == CARD:
        return Place(None, CARD)
    rest = path.removeprefix(PREFIX).rstrip("/")
    first, _, more = rest.removeprefix("/").partition("/")
    if not first or first in _REST:
        return Place(None, rest or "/")
    return Place(first, "/" + more)
