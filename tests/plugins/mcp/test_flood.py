"""Long requests over MCP: they hold up no stop, and no more of one is read than a turn has time for."""

from __future__ import annotations

import asyncio
import json
from typing import Any

import httpx

from plugins.mcp.rig import OPERATOR, VERSION, Caller, Site, caller

MANY = 60
HEADERS = {
    "accept": "application/json, text/event-stream",
    "authorization": f"Bearer {OPERATOR}",
    "mcp-protocol-version": VERSION,
    "mcp-method": "tools/call",
}


async def test_no_flood_of_requests_that_name_a_stop_holds_up_a_stop(gateway: Site) -> None:
    async with caller(gateway, OPERATOR) as flooding, caller(gateway, OPERATOR) as stopping:
        await stopping.tools()
        done: list[str] = []

        async def discover() -> None:
            await flooding.call("discover", q="estop hold cancel " * 50)
            done.append("discover")

        flood = [asyncio.create_task(discover()) for _ in range(MANY)]
        await asyncio.wait(flood, return_when=asyncio.FIRST_COMPLETED)
        answer = await stopping.call("system-estop", scope="robot")
        before = len(done)
        await asyncio.gather(*flood)
        assert answer["structuredContent"]["at_rest"] == ["robot"]
        assert before < MANY / 2


async def test_a_stop_by_its_path_and_a_hold_are_known_before_anything_is_read(
    gateway: Site,
) -> None:
    async with caller(gateway, OPERATOR) as first:  # nobody has listed the tools
        assert (await first.call("service-hold"))["structuredContent"]["status"] == "completed"
        stopped = await first.call("execute", path="/system/estop", input={"scope": "robot"})
        assert stopped["structuredContent"]["status"] == "completed"


async def test_a_request_of_too_many_values_is_refused_before_it_is_read(
    gateway: Site, operator: Caller
) -> None:
    def written(values: list[Any]) -> dict[str, Any]:
        params = {"name": "write", "arguments": {"path": "/param/limit", "value": values}}
        return {"jsonrpc": "2.0", "id": 1, "method": "tools/call", "params": params}

    async with httpx.AsyncClient(headers=HEADERS | {"mcp-name": "write"}) as client:
        refused = await client.post(gateway.url, json=written([1] * 20_000))
    assert refused.status_code == 413
    error = json.loads(refused.content)["error"]
    assert error["data"]["code"] == "payload_too_large"
    assert "HTTP or WebSocket" in error["message"]
    assert await operator.tools()  # it goes on
