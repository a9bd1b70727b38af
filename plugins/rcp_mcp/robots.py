"""The tool `robots`: which robots there are, briefly, or in detail."""

from __future__ import annotations

from typing import Any

import msgspec
from msgspec import Raw

from rcp_gateway.api import Session
from rcp_gateway.api.pages import cursor_of
from rcp_gateway.client_api import ClientApi
from rcp_kernel.wire import Request
from rcp_mcp.answers import answered, body_of, failed
from rcp_mcp.config import McpConfig
from rcp_mcp.content import text
from rcp_mcp.fixed import INVENTORY, Robots
from rcp_mcp.offers import Context, Outcome
from rcp_mcp.summary import PER_TOKEN, size
from rcp_web.untrusted import speaks

__all__ = ["RobotTools"]

_BRIEF = ("path", "kind", "state", "estop", "held", "mode", "profiles")
_Robot = dict[str, Any]


class RobotTools:
    """The handler."""

    def __init__(self, config: McpConfig, client_api: ClientApi) -> None:
        self._config = config
        self._client_api = client_api

    async def names(self, session: Session) -> list[str]:
        """List the robots that a caller may see, as prompts and people name them.

        That is the segment of its paths, or the whole path for the only robot of a tenant.
        """
        reply = await self._client_api.request(session, Request(type="read", path=INVENTORY))
        paths = () if reply.error is not None else (one["path"] for one in body_of(reply))
        own = f"/tenant/{session.tenant}/"
        return [path.removeprefix(own) for path in paths]

    async def robots(self, ctx: Context, session: Session, arguments: Robots) -> Outcome:
        """List the robots that match, as many as fit, with a cursor for the rest."""
        options = {"q": arguments.q, "limit": arguments.limit, "cursor": arguments.cursor}
        body = Raw(msgspec.json.encode({k: v for k, v in options.items() if v is not None}))
        request = Request(type="read", path=INVENTORY, body=body)
        reply = await self._client_api.request(session, request)
        if reply.error is not None:
            return failed(reply.error, reply.status)
        found: list[_Robot] = body_of(reply)
        robots = found if arguments.details else [_brief(one) for one in found]
        kept = self._fitting(robots)
        facts: dict[str, Any] = {"robots": robots[:kept]}
        if kept < len(robots) or reply.truncated:
            facts["cursor"] = cursor_of(found[kept - 1]["path"])
            facts["note"] = "There are more robots: search with `q`, or continue with `cursor`."
        elif not robots:
            facts["note"] = "No robot matches; try fewer words in `q`."
        if speaks(facts["robots"]):  # a mode or a model is a text of the robot's
            facts["untrusted"] = True
            return answered(facts, text(facts, None, untrusted=True))
        return answered(facts)

    def _fitting(self, robots: list[_Robot]) -> int:
        left = self._config.budget * PER_TOKEN
        for count, one in enumerate(robots):
            left -= size(one) + 1
            if left < 0:
                return max(count, 1)
        return len(robots)


def _brief(robot: _Robot) -> _Robot:
    """Shorten a robot to what one needs to choose it."""
    brief = {key: robot[key] for key in _BRIEF if key in robot}
    if (battery := robot.get("battery")) is not None:
        brief["battery"] = round(battery["value"]["percentage"], 2)
    if (pose := robot.get("pose")) is not None:
        value = pose["value"]
        at = {name: round(one, 2) for name, one in value["position"].items()}
        brief["position"] = {**at, "frame": value.get("frame_id")}
    if (control := robot.get("control")) is not None:
        brief["control"] = f"{control['principal']} ({control['by']})"
    return brief
