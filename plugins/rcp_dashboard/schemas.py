"""The responses of the API, for the OpenAPI document."""

from __future__ import annotations

from rcp_web.calls import Node

__all__ = ["CAMERA", "LATEST", "PANELS", "PAST", "SERIES", "STREAM", "answer"]

_REFUSED: Node = {"description": "Refused, with an envelope."}
_NUMBERS: Node = {"type": "array", "items": {"type": "number"}}
_SERIES_BODY: Node = {
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
_LATEST_BODY: Node = {
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
_PAST_BODY: Node = {
    "type": "object",
    "required": ["samples"],
    "properties": {
        "samples": {
            "type": "array",
            "items": {
                "type": "object",
                "required": ["path", "timestamp", "received", "seq", "body"],
                "properties": {
                    "path": {"type": "string"},
                    "timestamp": {"type": "string", "description": "The source's time."},
                    "received": {"type": "string", "description": "When the gateway had it."},
                    "seq": {"type": "integer"},
                    "body": {},
                },
            },
        },
        "cursor": {"type": "string", "description": "There are more: continue with it."},
    },
}


_TEXT: Node = {"type": "string"}
_PORTS: Node = {
    "type": "array",
    "items": {"type": "object", "properties": {"name": _TEXT, "description": _TEXT}},
}
_PANELS_BODY: Node = {
    "type": "object",
    "properties": {
        "panels": {
            "type": "array",
            "items": {
                "type": "object",
                "properties": {
                    "name": _TEXT,
                    "title": _TEXT,
                    "description": _TEXT,
                    "reads": _PORTS,
                    "writes": _PORTS,
                },
            },
        }
    },
}


def _json(schema: Node) -> Node:
    return {"application/json": {"schema": schema}}


SERIES = _json(_SERIES_BODY)
LATEST = _json(_LATEST_BODY)
PAST = _json(_PAST_BODY)
PANELS = _json(_PANELS_BODY)
CAMERA: Node = {
    media: {"schema": {"type": "string", "format": "binary"}}
    for media in ("image/jpeg", "image/png")
}
STREAM: Node = {"multipart/x-mixed-replace": {"schema": {"type": "string"}}}


def answer(text: str, content: Node) -> Node:
    """Return the responses of a call with this content."""
    return {"200": {"description": text, "content": content}, "default": _REFUSED}
