"""The calls under `/rcp/v1` besides resources and envelopes: catalogue, commands, health."""

from __future__ import annotations

import hashlib
from typing import Any

import msgspec
from litestar import Controller, delete, get
from litestar.di import NamedDependency
from litestar.params import FromPath
from litestar.types import ASGIApp
from msgspec import Raw

from rcp_gateway.api.pages import LONGEST, ObjectList, room
from rcp_http.answers import BOOT, matches
from rcp_http.call import Call
from rcp_http.command_pages import Wanted, fill
from rcp_http.downloads import recordings
from rcp_http.openapi_calls import COUNT, CURSOR, FILE, ID, PATH, STATUSES, TEXT, UNCHANGED, replies
from rcp_http.openapi_responses import COMMAND, READ
from rcp_http.request import count, flag
from rcp_http.schema_page import written
from rcp_kernel.errors import UnknownPath
from rcp_kernel.model import Kind, Operation, operation_names
from rcp_kernel.wire import encode_reply
from rcp_web.application import response
from rcp_web.calls import call as declared
from rcp_web.calls import query

__all__ = ["Catalogue", "Commands", "Files", "Status"]

_OPERATIONS = operation_names(Operation(31))


class Catalogue(Controller):
    """Resources and their schemas."""

    tags = ("gateway",)

    @get(
        "/discovery",
        **declared(
            "List resources, with schemas and examples.",
            query("path", PATH, "A path or pattern."),
            query("kind", {"enum": [kind.value for kind in Kind]}, "Only resources of this kind."),
            query(
                "op",
                {"enum": _OPERATIONS},
                "Only resources on which the caller may use this operation.",
            ),
            query(
                "q",
                {"type": "string", "maxLength": 200},
                "Words that must occur in the path or description.",
            ),
            query(
                "profile",
                {"type": "string", "maxLength": 100},
                "Only resources of robots with this profile that it defines.",
            ),
            query("limit", COUNT, "Items per page."),
            query(
                "cursor",
                {"type": "string", "maxLength": LONGEST},
                "`cursor` from the previous page.",
            ),
            query("schemas", {"type": "boolean"}, "Whether to include schemas."),
            responses=replies(extra=UNCHANGED),
        ),
    )
    async def discovery(self, call: NamedDependency[Call]) -> ASGIApp:
        """Answer with the catalogue."""
        etag = _etag(call)
        http = call.http
        if matches(http, etag):
            return call.unchanged(etag)
        wanted: dict[str, Any] = {}
        for name in ("kind", "op", "q", "profile", "cursor"):
            if (text := http.one(name)) is not None:
                wanted[name] = text
        if "limit" in http.query:
            wanted["limit"] = count("limit", http.one("limit") or "")
        if (text := http.one("schemas")) is not None:
            wanted["schemas"] = flag("schemas", text)
        request = http.request("discover", http.one("path"))
        request.body = Raw(msgspec.json.encode(wanted))
        reply = await call.submit(request)
        if reply.error is not None:
            return call.reply(reply)
        return call.encoded(encode_reply(reply, http.encoding), etag)

    @get(
        "/schemas",
        **declared("List the schemas that the caller may see.", responses=replies()),
    )
    async def schemas(self, call: NamedDependency[Call]) -> ASGIApp:
        """Answer with the schemas that the caller may see, by id."""
        client_api, session = call.client_api, call.session
        work = written(client_api.schemas(session), call.http.encoding)
        return call.plain(await client_api.turns.finish(session.principal.identity, work))

    @get("/schemas/{id:str}", **declared("Return one schema.", ID, responses=replies()))
    async def schema(self, id: FromPath[str], call: NamedDependency[Call]) -> ASGIApp:  # noqa: A002 - its name in the document
        """Answer with one schema; without an envelope for `application/schema+json`."""
        client_api, session = call.client_api, call.session
        work = client_api.schemas(session)
        schemas = await client_api.turns.finish(session.principal.identity, work)
        found = schemas.get(id.removeprefix("rcp:schema:"))
        if found is None:
            raise UnknownPath(f"unknown schema '{id[:80]}'", remedy="List /rcp/v1/schemas.")
        if b"application/schema+json" in call.http.headers.get("accept", b""):
            return response(200, msgspec.json.encode(found), b"application/schema+json")
        return call.plain(found)


class Status(Controller):
    """The health report."""

    tags = ("gateway",)

    @get("/status", **declared("Report health of the gateway and its robots.", responses=replies()))
    async def status(self, call: NamedDependency[Call]) -> ASGIApp:
        """Answer with the health report."""
        return call.reply(await call.submit(call.http.request("status")))


class Commands(Controller):
    """The commands and their states."""

    path = "/commands"
    tags = ("gateway",)

    @get(
        **declared(
            "List commands, newest first.",
            query(
                "status",
                {"enum": sorted((*STATUSES, "running"))},
                "Only commands with this status, or `running`.",
            ),
            query("path", TEXT, "Only commands on this path."),
            query("limit", COUNT, "Items per page."),
            query("cursor", CURSOR, "`cursor` from the previous page."),
            responses=replies(),
        ),
    )
    async def commands(self, call: NamedDependency[Call]) -> ASGIApp:
        """Answer with the newest first, without their histories."""
        client_api, session = call.client_api, call.session
        page, longest = ObjectList(call.http.encoding), room(client_api.limits.message)
        work = fill(page, Wanted.read(call.http), client_api.commands(session), longest)
        cursor = await client_api.turns.finish(session.principal.identity, work)
        return call.plain(page, "/system/commands", cursor)

    @get("/{id:str}", **declared("Return a command with its history.", ID, responses=replies()))
    async def command(self, id: FromPath[str], call: NamedDependency[Call]) -> ASGIApp:  # noqa: A002
        """Answer with the command's state, feedback and history."""
        body = call.client_api.command(call.session, id).plain()
        return call.plain(body, "/system/commands")

    @delete(
        "/{id:str}",
        **declared("Cancel a command.", ID, responses=replies(COMMAND)),
        status_code=200,
    )
    async def cancel(self, id: FromPath[str], call: NamedDependency[Call]) -> ASGIApp:  # noqa: A002
        """Cancel a command."""
        request = call.http.request("cancel")
        request.command = id
        return call.reply(await call.submit(request))


class Files(Controller):
    """The recordings as files."""

    tags = ("gateway",)

    @get(
        "/recordings/{name:str}",
        **declared(
            "Download a recording, whole or the part requested by `Range`.",
            {"name": "name", "in": "path", "required": True, "schema": TEXT},
            query(
                "format",
                {"enum": ["mcap", "ros2", "yaml"]},
                "As it is, as a bag of ROS 2, or the `metadata.yaml` of that bag.",
            ),
            responses=replies((*READ, 409), FILE | UNCHANGED),
        ),
    )
    async def recording(self, name: FromPath[str], call: NamedDependency[Call]) -> ASGIApp:
        """Answer with the file."""
        call.client_api.charge(call.session)
        format_ = call.http.one("format") or "mcap"
        found = recordings(call.client_api)
        return call.download(await found.file(call.session, name, format_))


def _etag(call: Call) -> bytes:
    """Return the validator of a session's view of the tree, for these parameters."""
    session = call.session
    seen = (
        session.principal.grants,
        session.tenant,
        sorted(call.http.query.items()),
        id(session.rights),
    )
    digest = hashlib.sha256(repr(seen).encode()).hexdigest()[:16].encode()
    return b'W/"%b.g%d.%b"' % (BOOT, call.client_api.generation(session), digest)
