"""A repeated call acts once: one with a key of the client's, or with its id within a session."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from typing import Any

import httpx
import pytest

from plugins.mcp.rig import BOUND, Caller, Site, caller
from plugins.mcp.test_endpoint import HEADERS, INITIALIZE
from rcp_mcp.repeats import KEY

pytestmark = pytest.mark.anyio
SENT = 1000  # calls that are repeated


class Old:
    """A client with a session, which chooses the ids of its calls."""

    def __init__(self, http: httpx.AsyncClient, url: str) -> None:
        self._http = http
        self._url = url

    async def call(self, id_: int | str, tool: str, **arguments: Any) -> dict[str, Any]:
        params = {"name": tool, "arguments": arguments}
        body = {"jsonrpc": "2.0", "id": id_, "method": "tools/call", "params": params}
        answer = await self._http.post(self._url, json=body)
        assert answer.status_code == 200, answer.text
        line = next(one for one in answer.text.splitlines()[::-1] if one.startswith("data:"))
        return json.loads(line[5:])["result"]


@asynccontextmanager
async def old(site: Site) -> AsyncGenerator[Old]:
    async with httpx.AsyncClient(headers=HEADERS, timeout=BOUND, trust_env=False) as http:
        opened = await http.post(site.url, json=INITIALIZE)
        http.headers["mcp-session-id"] = opened.headers["mcp-session-id"]
        http.headers["mcp-protocol-version"] = "2025-06-18"
        ready = {"jsonrpc": "2.0", "method": "notifications/initialized"}
        assert (await http.post(site.url, json=ready)).status_code == 202
        yield Old(http, site.url)


async def keyed(by: Caller, key: Any, tool: str, **arguments: Any) -> dict[str, Any]:
    return await by.ask("tools/call", name=tool, arguments=arguments, meta={KEY: key})


async def test_of_a_thousand_repeated_calls_each_acts_once(gateway: Site, operator: Caller) -> None:
    numbers = iter(range(SENT))

    async def repeat() -> None:
        for number in numbers:
            call = (f"call-{number}", "service-double")
            first, second = await asyncio.gather(
                keyed(operator, *call, value=number), keyed(operator, *call, value=number)
            )
            assert first["structuredContent"]["result"] == number * 2
            assert first["structuredContent"] == second["structuredContent"]

    async with asyncio.TaskGroup() as group:
        for _ in range(4):
            group.create_task(repeat())
    assert sorted(value for _, value in gateway.robot.ran) == list(range(SENT))


async def test_a_key_is_for_one_call(gateway: Site, operator: Caller) -> None:
    await keyed(operator, "k", "service-double", value=1)
    other = await keyed(operator, "k", "service-double", value=2)
    assert other["structuredContent"]["error"]["code"] == "duplicate_request"
    long = await keyed(operator, "k" * 257, "service-double", value=1)
    assert long["structuredContent"]["error"]["code"] == "bad_request"
    async with caller(gateway) as again:  # another connection
        await keyed(again, "k", "service-double", value=1)
    assert len(gateway.robot.ran) == 1


async def test_an_id_repeated_within_a_session_is_the_same_call(gateway: Site) -> None:
    async with old(gateway) as client:
        first = await client.call(7, "service-double", value=3)
        assert await client.call(7, "service-double", value=3) == first
        assert len(gateway.robot.ran) == 1
        await client.call(8, "service-double", value=3)
        await client.call("7", "service-double", value=3)
        await client.call(7, "service-double", value=4)
        assert len(gateway.robot.ran) == 4


async def test_an_id_means_nothing_in_another_session(gateway: Site, operator: Caller) -> None:
    for number in (1, 2):
        async with old(gateway) as client:
            await client.call(7, "service-double", value=3)
        assert len(gateway.robot.ran) == number
    for number in (3, 4):  # without sessions, ids start anew with each connection
        await operator.call("service-double", value=3)
        assert len(gateway.robot.ran) == number


async def test_a_repeated_stop_is_sent_again(gateway: Site, operator: Caller) -> None:
    halts = 0
    for _ in range(2):
        await keyed(operator, "stop", "system-estop")
        assert gateway.robot.halts > halts
        halts = gateway.robot.halts
        await operator.call("system-estop", reset=True)
