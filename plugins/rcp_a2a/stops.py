"""Whether a request stops something, from its plain data before the SDK parses it."""

from __future__ import annotations

from typing import Any

import msgspec
from msgspec import Raw

from rcp_a2a.messages import written
from rcp_a2a.places import Place
from rcp_kernel.wire import Request
from rcp_protocol.plain import is_list, is_map

__all__ = ["PLANS", "SHORT", "as_request"]

PLANS = "/system/plans"
_CANCEL = ("CancelTask", "tasks/cancel")
SHORT = 4096
"""Maximum bytes of a prioritised request that stops something; longer ones take their turn."""


def as_request(place: Place, method: str, plain: Any) -> Request | None:
    """Return the gateway request of a call if it could be a stop, otherwise None."""
    if method in _CANCEL or place.rest.endswith(":cancel"):
        return Request(type="cancel")
    params = plain.get("params") if is_map(plain) and place.binding == "jsonrpc" else plain
    message = params.get("message") if is_map(params) else None
    parts = message.get("parts") if is_map(message) else None
    if not is_list(parts):
        return None
    data = [part["data"] for part in parts if is_map(part) and "data" in part]
    texts = [part["text"] for part in parts if is_map(part) and isinstance(part.get("text"), str)]
    body: Any = data[0] if data else written("\n".join(texts))
    if isinstance(body, str):
        body = written(body)
    return Request(type="execute", path=PLANS, body=Raw(msgspec.json.encode(body)))
