from __future__ import annotations

from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from pathlib import Path

import httpx
import pytest
from structlog.testing import capture_logs

from rcp_gateway.server import Server, prepare, running
from rcp_kernel.config.file import load
from rcpd.reload import reload

pytestmark = pytest.mark.anyio
SAFE = """
anonymous = false
[transports.asgi]
host = "0.0.0.0"
port = 0
plaintext = true
[[keys]]
name = "k"
role = "viewer"
key = "a-key-of-this-test"
"""
STATUS = "/rcp/v1/context/system/status"


@asynccontextmanager
async def served(file: Path, text: str) -> AsyncGenerator[tuple[Server, httpx.AsyncClient]]:
    file.write_text(text)  # noqa: ASYNC240 - of a test
    async with running(prepare(load(file), str(file))) as server:
        port = next(facts["port"] for facts in server.status.transports if "port" in facts)
        async with httpx.AsyncClient(base_url=f"http://127.0.0.1:{port}") as http:
            yield server, http


@pytest.mark.parametrize(
    "text",
    [
        SAFE.replace("anonymous = false", ""),
        SAFE.replace("anonymous = false", "").replace("0.0.0.0", "127.0.0.1"),
        SAFE.partition("[[keys]]")[0].replace("0.0.0.0", "127.0.0.1"),
    ],
    ids=["open", "open with a listener that is not there", "nobody may do anything"],
)
async def test_a_reload_does_not_open_what_others_reach(tmp_path: Path, text: str) -> None:
    file = tmp_path / "rcp.toml"
    async with served(file, SAFE) as (server, http):
        for _ in range(2):
            file.write_text(text)
            with capture_logs() as said:
                await reload(server, file)
            assert [one["event"] for one in said] == ["reload_refused"]
            assert (await http.get(STATUS)).status_code == 401
            file.write_text(SAFE.replace("0.0.0.0", "127.0.0.1"))  # good, but not what runs
            await reload(server, file)
            key = {"authorization": "Bearer a-key-of-this-test"}
            assert (await http.get(STATUS, headers=key)).status_code == 200
