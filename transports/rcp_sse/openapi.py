"""The streams in the OpenAPI document."""

from __future__ import annotations

from typing import Any

from rcp_gateway.api import Session

__all__ = ["described"]

_OPTIONS = {
    "rate": "Maximum updates per second and path.",
    "on": "`sample` or `change`.",
    "deadband": "A number, a percentage, or a JSON object of field to either.",
    "where": "A condition, as JSON.",
    "fields": "Only these fields, comma-separated.",
    "frame": "The frame of the values.",
    "history": "Samples to replay first: a number, or a duration.",
    "initial": "Whether to send the current value at once.",
    "qos": "Quality of service, as JSON.",
    "duration": "Seconds after which the stream ends.",
    "count": "Updates after which the stream ends.",
    "last_event_id": "The same as the header `Last-Event-ID`.",
}


def _parameter(name: str, place: str, text: str, *, required: bool = False) -> dict[str, Any]:
    schema = {"type": "string"}
    return {"name": name, "in": place, "schema": schema, "description": text, "required": required}


def _stream(summary: str, parameters: list[dict[str, Any]]) -> dict[str, Any]:
    return {
        "get": {
            "summary": summary,
            "tags": ["streams"],
            "parameters": parameters,
            "responses": {
                "200": {
                    "description": "Events, until one side closes the connection.",
                    "content": {"text/event-stream": {"schema": {"type": "string"}}},
                },
                "default": {"description": "Refused, with an envelope."},
            },
        }
    }


async def described(_: Session) -> dict[str, Any]:
    """Describe the calls; they are the same for every caller."""
    options = [_parameter(name, "query", text) for name, text in _OPTIONS.items()]
    path = _parameter("path", "query", "A path or pattern; repeatable.", required=True)
    id_ = _parameter("id", "path", "The command.", required=True)
    return {
        "paths": {
            "/rcp/v1/events": _stream("Stream updates.", [path, *options]),
            "/rcp/v1/status/events": _stream("Stream the health report.", options),
            "/rcp/v1/commands/{id}/events": _stream("Stream a command's replies.", [id_]),
        }
    }
