"""Clients that reconnect by themselves have data again after each restart, however late the robot comes up."""

from __future__ import annotations

import asyncio
import os
import subprocess
from collections.abc import Generator
from pathlib import Path

import pytest
from websockets.asyncio.client import connect as connect_bare

from clients.test_typescript import typescript
from late import PATH, LateGateway
from plugins.client.test_codegen import node
from rcp_client import connect
from rcp_gateway.testing import decode, encode
from rcp_kernel.values import Encoding

BOUND = 60.0  # s that any wait of a test may take
LATE = 0.4  # s from the port to the robot
RESTARTS = int(os.environ.get("RCP_RESTARTS", "3"))


@pytest.fixture
def anyio_backend() -> str:
    return "asyncio"


@pytest.fixture
def gateway() -> Generator[LateGateway]:
    made = LateGateway(LATE)
    yield made
    made.kill()


@pytest.mark.anyio
async def test_one_that_asks_as_soon_as_the_port_is_open_is_told_to_ask_again(
    gateway: LateGateway,
) -> None:
    await asyncio.to_thread(gateway.start)
    async with (
        asyncio.timeout(BOUND),
        connect_bare(gateway.url.replace("http", "ws") + "/rcp/v1/ws", proxy=None) as socket,
    ):
        codes: list[str] = []
        while True:
            ask = {"type": "subscribe", "id": f"s{len(codes)}", "path": PATH}
            await socket.send(encode(ask, Encoding.JSON).decode())
            reply = decode(str(await socket.recv()).encode(), Encoding.JSON)
            if reply["status"] == "completed":
                break
            assert reply["error"]["retryable"] is True, reply
            codes.append(reply["error"]["code"])
            await asyncio.sleep(reply["error"]["retry_after"] / 4)
        assert set(codes) == {"adapter_unavailable"}


@pytest.mark.anyio
async def test_the_python_client_has_data_after_each_restart(gateway: LateGateway) -> None:
    run = await asyncio.to_thread(gateway.start)
    async with connect(gateway.url) as client, client.subscribe(PATH) as subscription:
        updates = aiter(subscription)
        for restart in range(RESTARTS + 1):
            if restart:
                gateway.kill()
                run = await asyncio.to_thread(gateway.start)
            async with asyncio.timeout(BOUND):
                while (await anext(updates)).body != run:
                    pass


@pytest.mark.skipif(node() is None, reason="needs Node")
def test_the_typescript_client_has_data_after_each_restart(
    gateway: LateGateway, tmp_path: Path
) -> None:
    found = node()
    assert found is not None
    client_folder = typescript(tmp_path)
    run = gateway.start()
    with subprocess.Popen(
        [found, "--no-warnings", "test/late.ts"],
        stdout=subprocess.PIPE,
        cwd=client_folder,
        env=os.environ | {"RCP_URL": gateway.url, "RCP_PATH": PATH},
        text=True,
    ) as client:
        assert client.stdout is not None
        try:
            for restart in range(RESTARTS + 1):
                if restart:
                    gateway.kill()
                    run = gateway.start()
                assert client.stdout.readline() == f"{run}\n"
        finally:
            client.kill()
