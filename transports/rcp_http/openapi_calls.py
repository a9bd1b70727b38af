"""The fixed part of the OpenAPI document: envelopes, common parts, calls without a controller."""

from __future__ import annotations

from typing import Any

import msgspec

from rcp_gateway.api.pages import LONGEST, MOST
from rcp_http.openapi_responses import CALL, COMMAND, READ, refusals
from rcp_kernel.errors import BY_CODE
from rcp_kernel.model import MAX_PATH
from rcp_kernel.wire import FINAL, VERSION, Request
from rcp_web.calls import query

__all__ = [
    "COUNT",
    "CURSOR",
    "ERROR",
    "FILE",
    "ID",
    "PATH",
    "REPLY",
    "STATUSES",
    "TEXT",
    "UNCHANGED",
    "direct",
    "replies",
]

Node = dict[str, Any]
TEXT: Node = {"type": "string"}
COUNT: Node = {"type": "integer", "minimum": 1, "maximum": MOST}
CURSOR: Node = {"type": "string", "minLength": 1, "maxLength": LONGEST}
PATH: Node = {"type": "string", "minLength": 1, "maxLength": MAX_PATH}
STATUSES = (*FINAL, "accepted", "pending", "in_progress")
_STREAMS = ("subscribe", "unsubscribe", "hello")
ERROR: Node = {
    "type": "object",
    "required": ["code", "message", "remedy", "retryable", "trace_id"],
    "properties": {
        "code": {"enum": sorted(BY_CODE)},
        "message": {"type": "string", "description": "One sentence for a person."},
        "origin": TEXT,
        "path": TEXT,
        "remedy": {"type": "string", "description": "What to do next."},
        "retryable": {"type": "boolean"},
        "retry_after": {"type": "number", "description": "Seconds."},
        "details": {"type": "object"},
        "trace_id": TEXT,
    },
}
REPLY: Node = {
    "type": "object",
    "required": ["type", "status"],
    "properties": {
        "type": TEXT,
        "id": TEXT,
        "path": TEXT,
        "status": {"enum": sorted(STATUSES)},
        "body": {},
        "message": TEXT,
        "error": {"$ref": "#/components/schemas/Error"},
        "command": TEXT,
        "progress": {"type": "number", "minimum": 0, "maximum": 1},
        "seq": {"type": "integer"},
        "source_timestamp": TEXT,
        "state": {"enum": ["fresh", "stale"]},
        "truncated": {
            "type": "boolean",
            "description": "The body is one page of the result; use `cursor` to get the next.",
        },
        "cursor": {"type": "string", "description": "Send it to get the next page."},
        "timestamp": TEXT,
        "dry_run": {"type": "boolean"},
    },
}


ID: Node = {
    "name": "id",
    "in": "path",
    "required": True,
    "schema": {"type": "string", "minLength": 1, "maxLength": 128},
}


FILE: Node = {
    "200": {
        "description": "The file.",
        "content": {"application/octet-stream": {}, "application/yaml": {}},
    },
    "206": {
        "description": "The part of the file requested by `Range`.",
        "content": {"application/octet-stream": {}, "application/yaml": {}},
    },
}
UNCHANGED: Node = {"304": {"description": "Not changed since the `ETag` in `If-None-Match`."}}


def replies(statuses: tuple[int, ...] = CALL, extra: Node | None = None) -> Node:
    """Return the responses of a call: a reply, others, and refusals."""
    content = {"application/json": {"schema": {"$ref": "#/components/schemas/Reply"}}}
    done: Node = {"200": {"description": "The reply.", "content": content}}
    return done | (extra or {}) | refusals(statuses)


def _envelope() -> Node:
    """Describe the request envelope, by the type that decodes it."""
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


def direct() -> Node:
    """Describe the calls without a controller: envelopes, and reads of patterns."""
    accepted = {"202": {"$ref": "#/components/responses/202"}}
    post: Node = {
        "summary": "Send any single envelope, or a batch.",
        "tags": ["gateway"],
        "requestBody": {
            "required": True,
            "content": {"application/json": {"schema": _envelope()}},
        },
        "responses": replies(COMMAND, accepted),
    }
    many: Node = {
        "summary": "Read every resource that matches a pattern, page by page.",
        "tags": ["gateway"],
        "parameters": [
            {
                "name": "pattern",
                "in": "path",
                "required": True,
                "schema": PATH,
                "description": "`*` is one segment, `**` any number: `param/**`.",
            },
            query("fields", TEXT, "Only these fields of the values, comma-separated."),
            query(
                "fresh",
                {"type": "boolean"},
                "Read from the robot, even if a recent sample is available.",
            ),
            query("frame", TEXT, "The frame of the values: `map`, `earth`, …"),
            query("limit", COUNT, "Items per page."),
            query("cursor", CURSOR, "`cursor` from the previous page."),
        ],
        "responses": replies(READ, UNCHANGED),
    }
    return {"/rcp/v1/context/{pattern}": {"get": many}, "/rcp/v1/messages": {"post": post}}
