"""`rcpd mcp`: an assistant that speaks by stdio has what one that speaks HTTP has."""

from __future__ import annotations

import asyncio
import json
import os
import sys
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from node import bin_of
from plugins.mcp.rig import BOUND, OPERATOR, Caller, Site, site
from plugins.mcp.test_clients import run
from plugins.mcp.test_endpoint import INITIALIZE
from ports import free_port

RCPD = str(Path(sys.executable).parent / "rcpd")


class Assistant:
    """Starts the program and speaks lines with it."""

    def __init__(self, process: asyncio.subprocess.Process) -> None:
        self.process = process
        self.others: list[dict[str, Any]] = []

    def say(self, message: dict[str, Any]) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps(message).encode() + b"\n")

    async def hear(self) -> dict[str, Any]:
        assert self.process.stdout is not None
        async with asyncio.timeout(BOUND):
            line = await self.process.stdout.readline()
        assert line, "the program ended"
        return json.loads(line)

    async def ask(self, message: dict[str, Any]) -> dict[str, Any]:
        self.say(message)
        while (heard := await self.hear()).get("id") != message["id"]:
            self.others.append(heard)
        return heard


@asynccontextmanager
async def assistant(url: str, *more: str) -> AsyncGenerator[Assistant]:
    process = await asyncio.create_subprocess_exec(
        *(RCPD, "mcp", "--url", url, *more),
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
        limit=4_000_000,
    )
    try:
        yield Assistant(process)
        assert process.stdin is not None
        process.stdin.close()
        async with asyncio.timeout(BOUND):
            assert await process.wait() == 0
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()


@pytest.fixture
def key(tmp_path: Path) -> str:
    made = tmp_path / "key"
    made.write_text(OPERATOR + "\n")
    return str(made)


async def test_an_older_client_opens_a_session_and_calls(gateway: Site, key: str) -> None:
    async with assistant(gateway.base, "--token-file", key) as one:
        opened = await one.ask(INITIALIZE)
        assert opened["result"]["protocolVersion"] == "2025-06-18"
        one.say({"jsonrpc": "2.0", "method": "notifications/initialized"})
        params = {"name": "read", "arguments": {"path": "/sensor/level"}}
        call = {"jsonrpc": "2.0", "id": 2, "method": "tools/call", "params": params}
        answer = await one.ask(call)
        assert answer["result"]["structuredContent"]["values"][0]["value"] == 1.25


async def test_a_newer_client_calls_and_cancels(gateway: Site, key: str) -> None:
    writer = Caller(gateway.url)
    await writer.http.aclose()
    async with assistant(gateway.base, "--token-file", key) as one:
        tools = await one.ask(writer.body("tools/list", {}))
        assert "action-go" in {tool["name"] for tool in tools["result"]["tools"]}
        params = {"name": "action-go", "arguments": {"x": 2}, "meta": {"progressToken": 7}}
        one.say(writer.body("tools/call", params) | {"id": 5})
        async with asyncio.timeout(BOUND):
            await gateway.robot.started.get()
        assert (await one.hear())["method"] == "notifications/progress"
        cancelled = {"requestId": 5, "reason": "enough"}
        one.say({"jsonrpc": "2.0", "method": "notifications/cancelled", "params": cancelled})
        async with asyncio.timeout(BOUND):
            await gateway.robot.stopped.get()


async def test_a_gateway_that_is_away_is_told_and_found_again_later(unused_tcp_port: int) -> None:
    async with assistant(f"http://127.0.0.1:{unused_tcp_port}") as one:
        for number in (1, 2):
            answer = await one.ask(INITIALIZE | {"id": number})
            assert "cannot be reached" in answer["error"]["message"]


async def test_an_older_client_goes_on_after_a_restart_of_the_gateway(
    unused_tcp_port: int, key: str
) -> None:
    params = {"name": "read", "arguments": {"path": "/sensor/level"}}
    call = {"jsonrpc": "2.0", "id": 2, "method": "tools/call", "params": params}
    async with assistant(f"http://127.0.0.1:{unused_tcp_port}", "--token-file", key) as one:
        async with site(port=unused_tcp_port):
            await one.ask(INITIALIZE)
            one.say({"jsonrpc": "2.0", "method": "notifications/initialized"})
            assert "result" in await one.ask(call)
        away = await one.ask(call | {"id": 3})
        assert "cannot be reached" in away["error"]["message"]
        async with site(port=unused_tcp_port):
            answer = await one.ask(call | {"id": 4})
            assert answer["result"]["structuredContent"]["values"][0]["value"] == 1.25


@pytest.fixture
def unused_tcp_port() -> int:
    return free_port()


async def test_the_inspector_lists_the_tools_by_stdio(
    gateway: Site, key: str, tmp_path: Path
) -> None:
    server: dict[str, Any] = {
        "command": RCPD,
        "args": ["mcp", "--url", gateway.base, "--token-file", key],
        "env": {name: os.environ[name] for name in ("PYTHONPATH",) if name in os.environ},
    }
    config = tmp_path / "servers.json"
    config.write_text(json.dumps({"mcpServers": {"robots": server}}))
    output = await run(
        *bin_of("mcp", "mcp-inspector"),
        *("--cli", "-q", "--config", str(config), "--server", "robots"),
        *("--method", "tools/list", "--strict"),
        cwd=tmp_path,
        MCP_INSPECTOR_SECRET_STORE="memory",
        HOME=str(tmp_path),
    )
    assert "action-go" in {tool["name"] for tool in json.loads(output)["tools"]}
