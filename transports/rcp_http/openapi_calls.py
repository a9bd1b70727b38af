"""The fixed part of the OpenAPI document: envelopes, and the calls that are no resources."""

from __future__ import annotations

from typing import Any

import msgspec

from rcp_http.openapi_responses import CALL, COMMAND, READ, refusals
from rcp_kernel.api.pages import LONGEST, MOST
from rcp_kernel.errors import BY_CODE
from rcp_kernel.model import MAX_PATH, Kind, Operation, operation_names
from rcp_kernel.wire import FINAL, VERSION, Request

__all__ = ["ERROR", "REPLY", "calls"]

Node = dict[str, Any]
_TEXT: Node = {"type": "string"}
_COUNT: Node = {"type": "integer", "minimum": 1, "maximum": MOST}
_CURSOR: Node = {"type": "string", "minLength": 1, "maxLength": LONGEST}
_PATH: Node = {"type": "string", "minLength": 1, "maxLength": MAX_PATH}
_STATUSES = (*FINAL, "accepted", "pending", "in_progress")
_STREAMS = ("subscribe", "unsubscribe", "hello")
_OPERATIONS = operation_names(Operation(31))
ERROR: Node = {
    "type": "object",
    "required": ["code", "message", "remedy", "retryable", "trace_id"],
    "properties": {
        "code": {"enum": sorted(BY_CODE)},
        "message": {"type": "string", "description": "One sentence for a person."},
        "origin": _TEXT,
        "path": _TEXT,
        "remedy": {"type": "string", "description": "What to do next."},
        "retryable": {"type": "boolean"},
        "retry_after": {"type": "number", "description": "Seconds."},
        "details": {"type": "object"},
        "trace_id": _TEXT,
    },
}
REPLY: Node = {
    "type": "object",
    "required": ["type", "status"],
    "properties": {
        "type": _TEXT,
        "id": _TEXT,
        "path": _TEXT,
        "status": {"enum": sorted(_STATUSES)},
        "body": {},
        "message": _TEXT,
        "error": {"$ref": "#/components/schemas/Error"},
        "command": _TEXT,
        "progress": {"type": "number", "minimum": 0, "maximum": 1},
        "seq": {"type": "integer"},
        "source_timestamp": _TEXT,
        "state": {"enum": ["fresh", "stale"]},
        "truncated": {
            "type": "boolean",
            "description": "The body is one page of the result; use `cursor` to get the next.",
        },
        "cursor": {"type": "string", "description": "Send it to get the next page."},
        "timestamp": _TEXT,
        "dry_run": {"type": "boolean"},
    },
}


def _query(name: str, schema: Node, text: str, *, required: bool = False) -> Node:
    found: Node = {"name": name, "in": "query", "schema": schema, "description": text}
    return found | {"required": True} if required else found


_ID: Node = {
    "name": "id",
    "in": "path",
    "required": True,
    "schema": {"type": "string", "minLength": 1, "maxLength": 128},
}


def _call(
    summary: str, *parameters: Node, statuses: tuple[int, ...] = CALL, extra: Node | None = None
) -> Node:
    content = {"application/json": {"schema": {"$ref": "#/components/schemas/Reply"}}}
    return {
        "summary": summary,
        "tags": ["gateway"],
        "parameters": list(parameters),
        "responses": {"200": {"description": "The reply.", "content": content}}
        | (extra or {})
        | refusals(statuses),
    }


def _envelope() -> Node:
    """Describe the request envelope by the type that reads it."""
    fields = [
        (field.encode_name, field.type)
        for field in msgspec.structs.fields(Request)
        if field.encode_name not in ("x-", "~encoding", "body")
    ]
    made = msgspec.defstruct("Envelope", fields)
    known: Node = msgspec.json.schema(made)["$defs"]["Envelope"]["properties"]
    types = [name for name in known["type"]["enum"] if name not in _STREAMS]
    return {
        "type": "object",
        "required": ["type"],
        "properties": known
        | {
            "type": {"enum": types},
            "version": {"enum": [VERSION, None]},
            "body": {},
        },
        "patternProperties": {"^x-.": {}},
        "additionalProperties": False,
    }


def calls() -> Node:
    """Describe the calls."""
    accepted = {"202": {"$ref": "#/components/responses/202"}}
    post = _call("Send any single envelope, or a batch.", statuses=COMMAND, extra=accepted) | {
        "requestBody": {
            "required": True,
            "content": {"application/json": {"schema": _envelope()}},
        }
    }
    unchanged: Node = {"304": {"description": "Not changed since the `ETag` in `If-None-Match`."}}
    discovery = _call(
        "List resources, with schemas and examples.",
        _query("path", _PATH, "A path or pattern."),
        _query("kind", {"enum": [kind.value for kind in Kind]}, "Only resources of this kind."),
        _query(
            "op",
            {"enum": _OPERATIONS},
            "Only resources on which the caller may use this operation.",
        ),
        _query(
            "q",
            {"type": "string", "maxLength": 200},
            "Words that must occur in the path or description.",
        ),
        _query("limit", _COUNT, "Items per page."),
        _query(
            "cursor", {"type": "string", "maxLength": LONGEST}, "`cursor` from the previous page."
        ),
        _query("schemas", {"type": "boolean"}, "Whether to include schemas."),
        extra=unchanged,
    )
    many = _call(
        "Read every resource that matches a pattern, page by page.",
        {
            "name": "pattern",
            "in": "path",
            "required": True,
            "schema": _PATH,
            "description": "`*` is one segment, `**` any number: `param/**`.",
        },
        _query("fields", _TEXT, "Only these fields of the values, comma-separated."),
        _query(
            "fresh",
            {"type": "boolean"},
            "Read from the robot, even if a recent sample is available.",
        ),
        _query("limit", _COUNT, "Items per page."),
        _query("cursor", _CURSOR, "`cursor` from the previous page."),
        statuses=READ,
        extra=unchanged,
    )
    return {
        "/rcp/v1/context/{pattern}": {"get": many},
        "/rcp/v1/messages": {"post": post},
        "/rcp/v1/discovery": {"get": discovery},
        "/rcp/v1/status": {"get": _call("Report health of the gateway and its robots.")},
        "/rcp/v1/schemas": {"get": _call("List the schemas that the caller may see.")},
        "/rcp/v1/schemas/{id}": {"get": _call("Return one schema.", _ID)},
        "/rcp/v1/commands": {
            "get": _call(
                "List commands, newest first.",
                _query(
                    "status",
                    {"enum": sorted((*_STATUSES, "running"))},
                    "Only commands with this status, or `running`.",
                ),
                _query("path", _TEXT, "Only commands on this path."),
                _query("limit", _COUNT, "Items per page."),
                _query("cursor", _CURSOR, "`cursor` from the previous page."),
            )
        },
        "/rcp/v1/commands/{id}": {
            "get": _call("Return a command with its history.", _ID),
            "delete": _call("Cancel a command.", _ID, statuses=COMMAND),
        },
    }
