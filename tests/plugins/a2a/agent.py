"""A gateway that speaks A2A, around the robot of few words, and what calls it."""

from __future__ import annotations

from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from typing import Any
from uuid import uuid4

import httpx

from transports.robot import KEY, Site, site

KEY_BETA = "key-of-tenant-beta"
VERSION = {"A2A-Version": "1.0"}


@asynccontextmanager
async def agent(table: str = "", more: str = "", **parts: Any) -> AsyncGenerator[Site]:
    """Run a gateway with `[plugins.a2a]`."""
    async with site(more=f"[plugins.a2a]\n{table}\n{more}", **parts) as made:
        yield made


@asynccontextmanager
async def caller(site: Site, key: str | None = KEY) -> AsyncGenerator[httpx.AsyncClient]:
    """Call the gateway as somebody."""
    headers = VERSION | ({} if key is None else {"authorization": f"Bearer {key}"})
    async with httpx.AsyncClient(base_url=site.url, headers=headers, timeout=60.0) as client:
        yield client


def text(body: str, **fields: Any) -> dict[str, Any]:
    """Write the parameters of a message that has a text."""
    return wrapped({"text": body}, **fields)


def data(body: Any, **fields: Any) -> dict[str, Any]:
    """Write the parameters of a message that has data."""
    return wrapped({"data": body}, **fields)


def wrapped(part: dict[str, Any], **fields: Any) -> dict[str, Any]:
    """Write the parameters of a message with one part."""
    configuration = fields.pop("configuration", None)
    message = {"messageId": str(uuid4()), "role": "ROLE_USER", "parts": [part], **fields}
    return {"message": message} | ({"configuration": configuration} if configuration else {})


async def rpc(client: httpx.AsyncClient, method: str, **params: Any) -> dict[str, Any]:
    """Call over JSON-RPC; returns the whole answer."""
    asked = {"jsonrpc": "2.0", "id": 1, "method": method, "params": params}
    answer = await client.post("/a2a", json=asked)
    assert answer.status_code == 200, answer.text
    assert answer.json()["id"] == 1
    return answer.json()


async def sent(client: httpx.AsyncClient, params: dict[str, Any]) -> dict[str, Any]:
    """Send a message over REST; returns the task."""
    answer = await client.post("/a2a/message:send", json=params)
    assert answer.status_code == 200, answer.text
    return answer.json()["task"]
