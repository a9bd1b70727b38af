"""Notices: unsolicited messages to clients."""

from __future__ import annotations

from typing import Any

from rcp_kernel.clock import iso, now
from rcp_kernel.sessions.outbox import Outbox
from rcp_kernel.wire import encode_frame

__all__ = ["notice"]


def notice(outbox: Outbox | None, code: str, **facts: Any) -> None:
    """Send a notice to a client; without a connection it is dropped."""
    if outbox is None:
        return
    kept = {key: value for key, value in facts.items() if value is not None}
    if outbox.translator is not None:
        outbox.translator.notice(code, kept)
        return
    fields = {"type": "notice", "code": code, **kept, "timestamp": iso(now())}
    outbox.put(encode_frame(fields, b"", outbox.encoding))
