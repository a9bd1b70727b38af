"""The tool `read`: one value, or several, for few tokens."""

from __future__ import annotations

from typing import Any

import msgspec
from msgspec import Raw

from rcp_gateway.api import Session
from rcp_gateway.client_api import ClientApi
from rcp_kernel.errors import BadRequest
from rcp_kernel.wire import Reply, Request
from rcp_mcp.answers import body_of, failed
from rcp_mcp.aside import aside
from rcp_mcp.catalogue import Catalogue
from rcp_mcp.changes import Changes, compared, packed
from rcp_mcp.config import McpConfig
from rcp_mcp.fixed import Read
from rcp_mcp.offers import Context, Outcome
from rcp_mcp.pictures import View
from rcp_mcp.poses import Poses
from rcp_mcp.remedies import in_tools
from rcp_mcp.sample_results import Sample, sampled
from rcp_mcp.senses import needs_pose

__all__ = ["ReadTool"]

_OPTIONS = ("fields", "fresh", "frame", "cursor")


class ReadTool:
    """The handler."""

    def __init__(self, config: McpConfig, client_api: ClientApi, catalogue: Catalogue) -> None:
        self._config = config
        self._client_api = client_api
        self._poses = Poses(client_api, catalogue)
        self._changes = Changes()

    async def read(self, ctx: Context, session: Session, arguments: Read) -> Outcome:
        """Read one value, those of a pattern, or those of several paths."""
        given = arguments.path
        paths: tuple[str, ...] = (given,) if isinstance(given, str) else given
        several = len(paths) > 1 or any("*" in path for path in paths)
        if arguments.cursor is not None and len(paths) > 1:
            raise BadRequest(
                "`cursor` continues one pattern, not several paths",
                remedy="Call `read` with the one pattern and its `cursor`.",
            )
        replies = [await self._one(session, path, arguments) for path in paths]
        if len(replies) == 1 and (error := replies[0].error) is not None:
            return failed(error, replies[0].status)
        samples = [
            sample
            for path, reply in zip(paths, replies, strict=True)
            for sample in _samples(path, reply)
        ]
        more = any(reply.truncated for reply in replies)
        facts: dict[str, Any] = {}
        if (several and arguments.cursor is None) or arguments.since is not None:
            samples = await self._compared(session, arguments.since, samples, facts)
        for sample in samples:
            if needs_pose(sample.get("value")):
                sample["pose"] = await self._poses.of(session, sample["path"])
        view = View(arguments.size or self._config.pixels, arguments.crop)
        pages = len(paths) == 1 and several

        def make() -> Outcome:
            return sampled("values", samples, self._config, view, pages=pages, more=more, **facts)

        return await aside(samples, make)

    async def _one(self, session: Session, path: str, arguments: Read) -> Reply:
        options = {name: getattr(arguments, name) for name in _OPTIONS}
        body = Raw(msgspec.json.encode({k: v for k, v in options.items() if v}))
        return await self._client_api.request(session, Request(type="read", path=path, body=body))

    async def _compared(
        self, session: Session, since: str | None, samples: list[Sample], facts: dict[str, Any]
    ) -> list[Sample]:
        """Keep only what has changed since a mark, and make a new one."""
        owner = (session.principal.identity, session.tenant)
        before = None if since is None else self._changes.of(owner, since)

        def compare() -> tuple[bytes, list[Sample], list[str]]:
            now = packed(samples)
            if before is None:
                return now, samples, []
            changed, gone = compared(before, now, samples)
            return now, changed, gone

        now, changed, gone = await aside(samples, compare)
        facts["mark"] = self._changes.keep(owner, now)
        if before is None:
            return samples
        facts["unchanged"] = len(samples) - len(changed)
        if gone:
            facts["gone"] = gone
        if not changed:
            facts["note"] = "Nothing has changed."
        return changed


def _samples(path: str, reply: Reply) -> list[Sample]:
    if reply.error is not None:
        return [{"path": path, "status": reply.status, "error": _told(reply.error)}]
    found = body_of(reply)
    if "*" in path:
        return [_renamed(one) for one in found]
    return [
        {
            "path": reply.path,
            "status": reply.status,
            "value": found,
            "timestamp": reply.source_timestamp,
            "state": reply.state,
        }
    ]


def _renamed(item: Sample) -> Sample:
    """Convert an item of a multiple read to the form of `read`."""
    kept = ("path", "status", "timestamp", "state")
    found = {key: item[key] for key in kept if key in item}
    if "error" in item:
        return {**found, "error": _told(item["error"])}
    return {"value": item.get("body"), **found}


def _told(error: dict[str, Any]) -> dict[str, Any]:
    """Shorten an error of one of several paths."""
    found = {"code": error["code"], "message": error["message"], "remedy": in_tools(error)}
    return {key: item for key, item in found.items() if item is not None}
