"""The API in the OpenAPI document."""

from __future__ import annotations

from typing import Any

from rcp_kernel.api import Session

__all__ = ["described"]

Node = dict[str, Any]
_REFUSED: Node = {"description": "Refused, with an envelope."}
_NUMBERS: Node = {"type": "array", "items": {"type": "number"}}
_SERIES: Node = {
    "type": "object",
    "required": ["path", "capacity", "now", "series"],
    "properties": {
        "path": {"type": "string"},
        "capacity": {"type": "integer", "description": "Samples kept per field."},
        "now": {"type": "number", "description": "The gateway's clock, s since the epoch."},
        "series": {
            "type": "array",
            "items": {
                "type": "object",
                "required": ["field", "samples", "times", "values"],
                "properties": {
                    "field": {
                        "type": "string",
                        "description": "Field name; empty for the value itself.",
                    },
                    "samples": {
                        "type": "integer",
                        "description": "Number of samples in the window.",
                    },
                    "times": {**_NUMBERS, "description": "Source times, s since the epoch."},
                    "values": _NUMBERS,
                },
            },
        },
    },
}
_LATEST: Node = {
    "type": "object",
    "required": ["timestamp", "values"],
    "properties": {
        "timestamp": {"type": "string"},
        "values": {
            "type": "array",
            "items": {
                "type": "object",
                "required": ["path", "status"],
                "properties": {
                    "path": {"type": "string"},
                    "status": {"type": "string"},
                    "body": {},
                    "omitted": {
                        "type": "integer",
                        "description": "Size in bytes of a value that is too long.",
                    },
                    "seq": {"type": "integer"},
                    "timestamp": {"type": "string"},
                    "state": {"enum": ["fresh", "stale"]},
                    "age": {"type": "number", "description": "s"},
                    "error": {"type": "object"},
                },
            },
        },
        "truncated": {"type": "boolean", "description": "There are more: continue with `cursor`."},
        "cursor": {"type": "string"},
    },
}
_PATH = ("path", "string", "A resource.")
_QUALITY = ("quality", "integer", "Quality of JPEGs converted from raw pixels, 1 to 100.")


async def described(_: Session) -> Node:
    """Describe the calls; they are the same for everybody."""
    image: Node = {
        media: {"schema": {"type": "string", "format": "binary"}}
        for media in ("image/jpeg", "image/png")
    }
    stream: Node = {"multipart/x-mixed-replace": {"schema": {"type": "string"}}}
    layout: Node = {"application/json": {"schema": {}}}
    none: Node = {"204": {"description": "Done."}, "default": _REFUSED}
    save = {"summary": "Save the caller's layout.", "requestBody": {"content": layout}}
    return {
        "paths": {
            "/dashboard/api/series": {
                "get": _call(
                    "Fields over time, down-sampled.",
                    _json(_SERIES),
                    _PATH,
                    ("field", "string", "A numeric field; repeatable."),
                    ("window", "number", "Length of the window before `until`, in s."),
                    (
                        "until",
                        "string",
                        "End of the window, ISO 8601 or s since the epoch. Default: the newest sample.",
                    ),
                    ("points", "integer", "Maximum number of points, 4 to 5000. Default: 600."),
                    ("method", "string", "`minmax` (no extreme is lost) or `lttb`."),
                )
            },
            "/dashboard/api/latest": {
                "get": _call(
                    "Current values.",
                    _json(_LATEST),
                    ("path", "string", "A path or pattern."),
                    (
                        "max_bytes",
                        "integer",
                        "Maximum bytes per value; longer ones are omitted. Default: 4096.",
                    ),
                    (
                        "cursor",
                        "string",
                        "`cursor` from the previous reply, if it was `truncated`.",
                    ),
                )
            },
            "/dashboard/api/camera": {"get": _call("The latest image.", image, _PATH, _QUALITY)},
            "/dashboard/api/camera/stream": {
                "get": _call(
                    "Images, until one side closes the connection.",
                    stream,
                    _PATH,
                    _QUALITY,
                    ("rate", "number", "Maximum images per second."),
                )
            },
            "/dashboard/api/layout": {
                "get": _call("The caller's layout.", layout),
                "put": {**save, "tags": ["dashboard"], "responses": none},
                "delete": {
                    "summary": "Delete the caller's layout.",
                    "tags": ["dashboard"],
                    "responses": none,
                },
            },
        }
    }


def _json(schema: Node) -> Node:
    return {"application/json": {"schema": schema}}


def _call(summary: str, content: Node, *parameters: tuple[str, str, str]) -> Node:
    return {
        "summary": summary,
        "tags": ["dashboard"],
        "parameters": [
            {
                "name": name,
                "in": "query",
                "required": name == "path",
                "description": text,
                "schema": {"type": "array", "items": {"type": kind}}
                if name == "field"
                else {"type": kind},
            }
            for name, kind, text in parameters
        ],
        "responses": {"200": {"description": summary, "content": content}, "default": _REFUSED},
    }
