"""The tool `watch`: records a subscription for a number of samples or seconds."""

from __future__ import annotations

from typing import Any

import msgspec

from rcp_gateway.api import Session
from rcp_gateway.client_api import ClientApi
from rcp_mcp.answers import failed
from rcp_mcp.aside import aside
from rcp_mcp.config import McpConfig
from rcp_mcp.feed import ResourceFeed
from rcp_mcp.fixed import Watch
from rcp_mcp.offers import Context, Outcome
from rcp_mcp.pictures import View
from rcp_mcp.sample_results import sampled
from rcp_mcp.trends import trends
from rcp_protocol.timeouts import timeout

__all__ = ["WatchTools"]


class WatchTools:
    """The handler."""

    def __init__(self, config: McpConfig, client_api: ClientApi) -> None:
        self._config = config
        self._client_api = client_api

    async def watch(self, ctx: Context, session: Session, arguments: Watch) -> Outcome:
        """Collect updates until the number of samples or the time is reached."""
        feed = ResourceFeed(self._client_api, session)
        try:
            options: dict[str, Any] = {"on": "change" if arguments.on_change else "sample"}
            if arguments.rate is not None:
                options["rate"] = arguments.rate
            reply = await feed.subscribe(arguments.paths, **options)
            if reply.error is not None:
                return failed(reply.error, reply.status)
            found: list[dict[str, Any]] = []
            ended = await self._collect(ctx, feed, arguments, found)
        finally:
            feed.close()
        view = View(self._config.pixels)

        def make() -> Outcome:
            if arguments.each:
                return sampled("updates", found, self._config, view, ended=ended)
            return sampled("trends", trends(found), self._config, view, ended=ended)

        return await aside(found, make)

    async def _collect(
        self, ctx: Context, feed: ResourceFeed, arguments: Watch, found: list[dict[str, Any]]
    ) -> str:
        try:
            async with timeout(arguments.seconds):
                while len(found) < arguments.samples:
                    updates = await feed.next()
                    if not updates:
                        return "the subscription ended"
                    found += [_sample(path, data) for path, data in updates]
                    del found[arguments.samples :]
                    await ctx.session.report_progress(len(found), arguments.samples)
        except TimeoutError:
            return f"{arguments.seconds:g} s are over"
        return f"{arguments.samples} samples"


def _sample(path: str, data: bytes) -> dict[str, Any]:
    update = msgspec.json.decode(data)
    keys = ("timestamp", "state", "dropped")
    kept = {key: update[key] for key in keys if key in update}
    return {"path": path, **kept, "value": update.get("body")}
