"""Errors in the OpenAPI document: one response per status, with its error codes."""

from __future__ import annotations

from typing import Any

from rcp_kernel.errors import BY_CODE

__all__ = ["CALL", "COMMAND", "READ", "refusals", "responses"]

Node = dict[str, Any]
CALL = (400, 401, 403, 404, 405, 414, 422, 429, 431, 500, 501, 503, 504)
"""Statuses of calls that only read."""
READ = (*CALL, 416, 502)
COMMAND = (*CALL, 409, 413, 423, 499, 502)
_ELSE = {
    414: "`payload_too_large`: the URL is longer than the limit.",
    416: "`bad_request`: the range is outside the value.",
    431: "`payload_too_large`: the headers are longer than the limit.",
}
"""Statuses that HTTP distinguishes, but the contract covers by one code."""
_HEADERS: dict[int, tuple[str, str]] = {
    401: ("WWW-Authenticate", "How to authenticate."),
    405: ("Allow", "The methods that the resource supports."),
}


def refusals(statuses: tuple[int, ...]) -> Node:
    """Return the references to the responses of some statuses."""
    return {str(status): {"$ref": f"#/components/responses/{status}"} for status in statuses}


def responses() -> Node:
    """Describe every error response."""
    codes: dict[int, list[str]] = {}
    for code, error in sorted(BY_CODE.items()):
        codes.setdefault(error.http, []).append(f"`{code}`")
    known = {status: f"{', '.join(named)}." for status, named in codes.items()} | _ELSE
    return {str(status): _response(status, text) for status, text in sorted(known.items())}


def _response(status: int, text: str) -> Node:
    schema = {"$ref": "#/components/schemas/Reply"}
    found: Node = {"description": text, "content": {"application/json": {"schema": schema}}}
    headers: Node = {}
    if status in _HEADERS:
        name, meaning = _HEADERS[status]
        headers[name] = {
            "description": meaning,
            "required": True,
            "schema": {"type": "string"},
        }
    if status in (429, 503):
        headers["Retry-After"] = {
            "description": "Seconds to wait before a retry, if known.",
            "schema": {"type": "integer", "minimum": 1},
        }
    return found | ({"headers": headers} if headers else {})
