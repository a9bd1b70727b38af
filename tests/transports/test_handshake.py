from __future__ import annotations

import asyncio

import httpx
import pytest
from websockets.asyncio.client import connect
from websockets.exceptions import InvalidStatus

from transports.raw import TEXT, answer, connected, frame, handshake, opened
from transports.robot import BOUND, Site, site

pytestmark = pytest.mark.anyio


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"Sec_WebSocket_Key": "short"}, 400),
        ({"Sec_WebSocket_Key": None}, 400),
        ({"Sec_WebSocket_Key": "!" * 24}, 400),
        ({"Sec_WebSocket_Version": "8"}, 426),
        ({"Sec_WebSocket_Version": None}, 426),
        ({"Sec_WebSocket_Protocol": "rcp.v9.json, chat"}, 400),
        ({"Origin": "https://elsewhere.example"}, 403),
        ({"Origin": "null"}, 403),
        ({"Host": "rebound.example"}, 403),
        ({"Authorization": "Bearer not-a-key-of-anybody"}, 401),
        ({"Authorization": "Basic dTpw"}, 400),
    ],
)
async def test_a_bad_handshake_is_refused_with_an_envelope(
    gateway: Site, headers: dict[str, str | None], status: int
) -> None:
    async with connected(gateway) as raw:
        found, data = await answer(raw, handshake(**headers))
    assert found == status, data
    assert b'"remedy"' in data


async def test_a_websocket_elsewhere_is_not_found(gateway: Site) -> None:
    async with connected(gateway) as raw:
        assert (await answer(raw, handshake("/nowhere")))[0] == 404


async def test_a_websocket_does_not_begin_with_post(gateway: Site) -> None:
    async with connected(gateway) as raw:
        assert (await answer(raw, handshake(method="POST", Content_Length="0")))[0] == 400


@pytest.mark.parametrize("connection", ["Upgrade", "keep-alive, Upgrade", "upgrade"])
async def test_browsers_spell_the_upgrade_in_their_own_ways(gateway: Site, connection: str) -> None:
    async with opened(gateway, Connection=connection) as raw:
        raw.ask(type="ping", id="1")
        assert (await raw.reply())["id"] == "1"


async def test_what_comes_with_the_handshake_is_not_lost(gateway: Site) -> None:
    async with connected(gateway) as raw:
        raw.send(handshake(), frame(TEXT, b'{"type":"ping","id":"early"}'))
        async with asyncio.timeout(BOUND):
            await raw.reader.readuntil(b"\r\n\r\n")
        assert (await raw.reply())["id"] == "early"


async def test_a_page_of_the_same_host_and_a_listed_one_may_connect() -> None:
    async with site(asgi='origins = ["https://ui.example"]') as gateway:
        for origin in (f"http://127.0.0.1:{gateway.port}", "https://UI.example"):
            host = f"127.0.0.1:{gateway.port}"
            async with opened(gateway, Origin=origin, Host=host) as raw:
                raw.ask(type="ping")
                assert (await raw.reply())["status"] == "completed"


async def test_the_subprotocol_is_the_first_that_is_spoken(gateway: Site) -> None:
    offered = "chat, rcp.v1.msgpack, rcp.v1.json"
    async with opened(gateway, Sec_WebSocket_Protocol=offered) as raw:
        assert b"Sec-WebSocket-Protocol: rcp.v1.msgpack\r\n" in raw.head
    async with opened(gateway) as raw:
        assert b"Sec-WebSocket-Protocol" not in raw.head


@pytest.mark.parametrize(
    "query",
    [
        "token=hidden-s3cret",
        "access_token=hidden-s3cret",
        "KEY=hidden-s3cret",
        "a=1&%74oken=hidden-s3cret",
    ],
)
async def test_a_secret_in_a_url_is_refused_and_not_repeated(gateway: Site, query: str) -> None:
    async with httpx.AsyncClient(base_url=gateway.url) as http:
        for path in ("/rcp/v1/context/sensor/pose", "/rcp/v1/events", "/healthz", "/metrics"):
            answer = await http.get(f"{path}?{query}")
            assert answer.status_code == 400, path
            assert answer.json()["error"]["code"] == "bad_request"
            assert "Authorization: Bearer" in answer.json()["error"]["remedy"]
            assert "s3cret" not in answer.text
    with pytest.raises(InvalidStatus) as refused:
        await connect(f"{gateway.ws}?{query}")
    assert refused.value.response.status_code == 400
    assert b"s3cret" not in refused.value.response.body
