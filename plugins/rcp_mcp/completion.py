"""Completion of tenants, robots, places and names that the caller may see."""

from __future__ import annotations

from collections.abc import Iterable

from mcp import types

from rcp_gateway.api import Session
from rcp_gateway.client_api import ClientApi
from rcp_kernel.model import tenant_of
from rcp_kernel.wire import Request
from rcp_mcp.answers import body_of
from rcp_mcp.catalogue import Catalogue
from rcp_mcp.robots import RobotTools
from rcp_protocol.plain import is_list

__all__ = ["Completion"]

_PLACES = "/system/places"
_MOST = 100  # maximum number of values in a response


class Completion:
    """Completes arguments of templates and prompts."""

    def __init__(self, client_api: ClientApi, catalogue: Catalogue, robots: RobotTools) -> None:
        self._client_api = client_api
        self._catalogue = catalogue
        self._robots = robots

    async def complete(
        self, session: Session, params: types.CompleteRequestParams
    ) -> types.Completion | None:
        """Return the completions; None if the reference does not belong to this server."""
        begun = params.argument.value
        chosen = (params.context.arguments if params.context is not None else None) or {}
        if isinstance(params.ref, types.PromptReference):
            match params.argument.name:
                case "robot":
                    return _of(await self._robots.names(session), begun)
                case "destination":
                    return _of(await self._places(session), begun)
                case _:
                    return _of((), begun)
        if not params.ref.uri.startswith("rcp://"):
            return None
        paths = [one["path"] for one in self._catalogue.all(session)]
        if params.argument.name == "tenant":
            return _of(filter(None, map(tenant_of, paths)), begun)
        parts = params.ref.uri.removeprefix("rcp://").split("/")
        branch = parts[1] if len(parts) > 1 else ""
        tenant = chosen.get("tenant", session.tenant)
        prefix = "/system/" if branch == "system" else f"/tenant/{tenant}/{branch}/"
        return _of((p[len(prefix) :] for p in paths if p.startswith(prefix)), begun)

    async def _places(self, session: Session) -> list[str]:
        """Return the names of places; none without that feature."""
        reply = await self._client_api.request(session, Request(type="read", path=_PLACES))
        found = None if reply.error is not None else body_of(reply)
        return [str(one["name"]) for one in found] if is_list(found) else []


def _of(values: Iterable[str], begun: str) -> types.Completion:
    found = sorted({one for one in values if one.startswith(begun)})
    return types.Completion(values=found[:_MOST], total=len(found), has_more=len(found) > _MOST)
