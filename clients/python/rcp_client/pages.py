"""Paged replies: requested one after the other, within one deadline."""

from __future__ import annotations

import time
from collections.abc import AsyncGenerator, Awaitable, Callable
from typing import Any

import msgspec

from rcp_client.messages import Reply
from rcp_protocol.errors import DeadlineExceeded

__all__ = ["joined", "pages"]

Ask = Callable[[dict[str, Any]], Awaitable[Reply]]


async def pages(
    ask: Ask, envelope: dict[str, Any], deadline: float | None = None
) -> AsyncGenerator[Reply]:
    """Request the first page of a reply and all following ones.

    `deadline` applies to all pages together, in s; without it, the client's own applies to each.

    :raises DeadlineExceeded: not all pages were read in time.
    :raises RcpError: as for `ask`.
    """
    end = None if deadline is None else time.monotonic() + deadline
    while True:
        page_request = dict(envelope)
        if end is not None:
            page_request["deadline"] = end - time.monotonic()
            if page_request["deadline"] <= 0:
                raise DeadlineExceeded(
                    f"only part of {envelope.get('path')} was read within {deadline:g} s",
                    path=envelope.get("path"),
                )
        reply = await ask(page_request)
        yield reply
        cursor = reply.cursor
        if cursor is None and isinstance(reply.body, dict):  # discovery of an older gateway
            cursor = reply.body.get("cursor")
        if cursor is None:
            return
        envelope = {**envelope, "body": {**(envelope.get("body") or {}), "cursor": cursor}}


async def joined(ask: Ask, envelope: dict[str, Any], deadline: float | None = None) -> Reply:
    """Return one reply with the items of all pages.

    :raises RcpError: as for `pages`.
    """
    whole: Reply | None = None
    items: list[Any] = []
    async for reply in pages(ask, envelope, deadline):
        if reply.cursor is None and whole is None:
            return reply
        items += reply.body
        whole = reply
    assert whole is not None
    return msgspec.structs.replace(whole, body=items, truncated=False, cursor=None)
