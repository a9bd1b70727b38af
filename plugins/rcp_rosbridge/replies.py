"""Replies of the gateway, as plain data and as sentences."""

from __future__ import annotations

from typing import Any

import msgspec

from rcp_kernel.values import to_plain
from rcp_kernel.wire import NO_BODY, Body, Reply

__all__ = ["complaint", "plain"]


def plain(reply: Reply) -> Any:
    """Return the body of a reply as plain data, whose numbers are numbers in JSON too."""
    body = reply.body
    if body is NO_BODY:
        return None
    if isinstance(body, msgspec.Raw):
        return msgspec.json.decode(body) if body else None
    return to_plain(body.value if isinstance(body, Body) else body)


def complaint(reply: Reply) -> str:
    """Return why a request did not succeed, and what to do."""
    error = reply.error or {}
    text = str(error.get("message") or reply.message or reply.status)
    return f"{text.removesuffix('.')}. {error['remedy']}" if error.get("remedy") else text
