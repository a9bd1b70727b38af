"""The fixed part of the OpenAPI document: envelopes, and the calls that are no resources."""

from __future__ import annotations

from typing import Any

from rcp_kernel.errors import BY_CODE
from rcp_kernel.model import Kind
from rcp_kernel.operations.pages import MOST
from rcp_kernel.wire import FINAL

__all__ = ["ERROR", "REFUSED", "REPLY", "calls"]

Node = dict[str, Any]
_TEXT: Node = {"type": "string"}
_COUNT: Node = {"type": "integer", "minimum": 1, "maximum": MOST}
REFUSED = "Refused or failed, with the status of the error's code; never a 2xx."
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
        "status": {"enum": sorted((*FINAL, "accepted", "pending", "in_progress"))},
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
            "description": "The body is one page of the answer; `cursor` leads to the next.",
        },
        "cursor": {"type": "string", "description": "Send it to get the next page."},
        "timestamp": _TEXT,
        "dry_run": {"type": "boolean"},
    },
}


def _query(name: str, schema: Node, text: str, *, required: bool = False) -> Node:
    found: Node = {"name": name, "in": "query", "schema": schema, "description": text}
    return found | {"required": True} if required else found


_ID: Node = {"name": "id", "in": "path", "required": True, "schema": _TEXT}


def _call(summary: str, *parameters: Node, media: str = "application/json") -> Node:
    schema: Node = {"$ref": "#/components/schemas/Reply"} if media == "application/json" else _TEXT
    return {
        "summary": summary,
        "tags": ["gateway"],
        "parameters": list(parameters),
        "responses": {
            "200": {"description": "The reply.", "content": {media: {"schema": schema}}},
            "default": {
                "description": REFUSED,
                "content": {"application/json": {"schema": {"$ref": "#/components/schemas/Reply"}}},
            },
        },
    }


def calls() -> Node:
    """Describe the calls."""
    envelope: Node = {
        "type": "object",
        "required": ["type"],
        "properties": {
            "type": {
                "enum": [
                    "read",
                    "write",
                    "execute",
                    "cancel",
                    "discover",
                    "status",
                    "ping",
                    "batch",
                ]
            },
            "path": _TEXT,
            "id": {"type": "string", "maxLength": 128},
            "deadline": {"type": "number", "exclusiveMinimum": 0},
            "valid_for": {"type": "number", "exclusiveMinimum": 0},
            "idempotency_key": _TEXT,
            "dry_run": {"type": "boolean"},
            "approval": _TEXT,
            "body": {},
        },
    }
    post = _call("Send any one envelope, or a batch of them.") | {
        "requestBody": {"required": True, "content": {"application/json": {"schema": envelope}}}
    }
    discovery = _call(
        "List what there is, with schemas and examples.",
        _query("path", _TEXT, "A path or pattern."),
        _query("kind", {"enum": [kind.value for kind in Kind]}, "Only this kind."),
        _query("op", _TEXT, "Only what the caller may do this with."),
        _query("q", _TEXT, "Words in path or description."),
        _query("limit", _COUNT, "In one page."),
        _query("cursor", _TEXT, "Of the last page."),
    )
    many = _call(
        "Read everything that a pattern reaches, page by page.",
        {
            "name": "pattern",
            "in": "path",
            "required": True,
            "schema": _TEXT,
            "description": "`*` is one segment, `**` any number: `param/**`.",
        },
        _query("fields", _TEXT, "Only these fields of the values, separated by commas."),
        _query("fresh", {"type": "boolean"}, "Ask the robot, even where a sample is at hand."),
        _query("limit", _COUNT, "Items in one page."),
        _query("cursor", _TEXT, "Of the last page."),
    )
    return {
        "/rcp/v1/context/{pattern}": {"get": many},
        "/rcp/v1/messages": {"post": post},
        "/rcp/v1/discovery": {"get": discovery},
        "/rcp/v1/status": {"get": _call("Report how the gateway and its robots are.")},
        "/rcp/v1/schemas": {"get": _call("List the schemas of what the caller may see.")},
        "/rcp/v1/schemas/{id}": {"get": _call("Return one schema.", _ID)},
        "/rcp/v1/commands": {
            "get": _call(
                "List commands, the newest first.",
                _query("status", _TEXT, "Only those of this status, or `running`."),
                _query("path", _TEXT, "Only those of this path."),
                _query("limit", _COUNT, "In one page."),
                _query("cursor", _TEXT, "Of the last page."),
            )
        },
        "/rcp/v1/commands/{id}": {
            "get": _call("Return a command with its history.", _ID),
            "delete": _call("Have a command cancelled.", _ID),
        },
    }
