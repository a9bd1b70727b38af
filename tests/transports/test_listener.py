from __future__ import annotations

import asyncio
import socket
from typing import Any

import httpx
import pytest

from rcp_asgi import AsgiConfig
from rcp_gateway import plugins
from rcp_gateway.client_api import Mount
from rcp_kernel.errors import ConfigError, PluginError
from rcp_web.asgi import respond
from transports.raw import TEXT, answer, connected, frame, opened
from transports.robot import KEY, Site, site, until

pytestmark = pytest.mark.anyio
POSE = "/rcp/v1/context/tenant/alpha/sensor/pose"


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.0.2.1", "robot.example"])
async def test_strangers_and_other_machines_do_not_go_together(host: str) -> None:
    with pytest.raises(ConfigError, match="reachable from other machines"):
        async with site(asgi=f'host = "{host}"'):
            pass


async def test_with_keys_and_without_strangers_it_listens_everywhere() -> None:
    async with (
        site(top="anonymous = false", asgi='host = "0.0.0.0"\nplaintext = true') as gateway,
        httpx.AsyncClient(base_url=f"http://127.0.0.1:{gateway.port}") as http,
    ):
        assert (await http.get(POSE)).status_code == 401
        assert (await http.get("/metrics")).status_code == 401
        assert (await http.get("/healthz")).status_code == 200
        assert (await http.get("/readyz")).json() == {"ready": True}
        mine = await http.get(POSE, headers={"authorization": f"Bearer {KEY}"})
        assert mine.status_code == 200


async def test_an_address_in_use_is_a_fault_of_the_configuration() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(ConfigError, match="cannot listen on"):
            async with site(port=port):
                pass


async def test_health_readiness_metrics_and_the_index(http: httpx.AsyncClient) -> None:
    assert (await http.get("/healthz")).json() == {"status": "ok"}
    ready = await http.get("/readyz")
    assert (ready.status_code, ready.json()["backends"]["second"]) == (200, "ready")
    metrics = await http.get("/metrics")
    assert 'rcp_backend_up{backend="robot",tenant="alpha"} 1.0' in metrics.text
    assert (await http.get("/")).text.startswith("RCP gateway")
    page = await http.get("/", headers={"accept": "text/html,*/*"})
    assert page.headers["content-type"].startswith("text/html")
    assert 'href="rcp/v1/discovery"' in page.text
    assert (await http.post("/healthz")).json()["error"]["code"] == "unsupported_operation"


async def test_a_backend_that_is_down_is_not_ready(http: httpx.AsyncClient, gateway: Site) -> None:
    gateway.robot.host.report("unplugged", down=True)
    ready = await http.get("/readyz")
    assert (ready.status_code, ready.json()["ready"]) == (503, False)


async def test_metrics_are_not_for_one_tenant_alone(http: httpx.AsyncClient) -> None:
    beta = {"authorization": "Bearer key-of-tenant-beta"}
    assert (await http.get("/metrics", headers=beta)).status_code == 403
    assert (await http.get("/readyz", headers=beta)).json() == {"ready": True}


# -- adapters that do not run -----------------------------------------------------------------------


@pytest.mark.parametrize("path", ["/mcp", "/mcp/", "/mcp/messages"])
async def test_an_adapter_that_is_not_configured_answers_and_is_listed(
    path: str, http: httpx.AsyncClient
) -> None:
    refused = await http.post(path, json={"jsonrpc": "2.0", "id": 1, "method": "initialize"})
    error = refused.json()["error"]
    assert (refused.status_code, error["code"]) == (503, "adapter_unavailable")
    wanted = "Command rejected \N{EM DASH} MCP adapter is not connected to the runtime."
    assert error["message"] == wanted
    assert "[plugins.mcp]" in error["remedy"]
    status = (await http.get("/rcp/v1/status")).json()["body"]
    assert status["state"] == "ok"
    assert {"mcp": "off", "a2a": "off"}.items() <= {
        one["name"]: one["state"] for one in status["adapters"]
    }.items()
    assert (await http.get("/mcpx")).status_code == 404


async def test_an_adapter_whose_library_is_missing_answers(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    real = plugins.find_spec
    monkeypatch.setattr(plugins, "find_spec", lambda name: None if name == "mcp" else real(name))
    async with site(more="[plugins.mcp]") as gateway, httpx.AsyncClient() as http:
        refused = await http.post(f"{gateway.url}/mcp", json={})
        assert refused.status_code == 503
        assert "pip install 'rcp-gateway[mcp]'" in refused.json()["error"]["remedy"]


# -- HTTP that is none -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    "request_",
    [
        b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03",
        b"GET / HTTP/9.9\r\n\r\n",
        b"GET /\xff\xfe HTTP/1.1\r\nHost: localhost\r\n\r\n",
        b"GET / HTTP/1.1\r\nHost: localhost\r\nContent-Length: x\r\n\r\n",
        b"GET / HTTP/1.1\r\nno colon here\r\n\r\n",
    ],
)
async def test_what_is_no_http_is_a_bad_request(gateway: Site, request_: bytes) -> None:
    async with connected(gateway) as raw:
        status, data = await answer(raw, request_)
    assert status == 400
    assert b'"code":"bad_request"' in data


async def test_headers_have_a_limit() -> None:
    async with site(asgi="max_header = 1024") as gateway:
        head = b"GET / HTTP/1.1\r\nHost: localhost\r\n"
        long = head + b"X-Long: " + b"x" * 2000 + b"\r\n\r\n"
        many = head + b"x:\r\n" * 400 + b"\r\n"
        for request, wanted in ((long, 431), (many, 431), (b"GET /" + b"x" * 2000, 414)):
            async with connected(gateway) as raw:
                status, data = await answer(raw, request)
            assert status == wanted, data
            assert b"payload_too_large" in data


async def test_a_header_without_an_end_is_cut_at_the_limit(gateway: Site) -> None:
    async with connected(gateway) as raw:
        status, data = await answer(
            raw, b"GET / HTTP/1.1\r\nHost: localhost\r\nX: " + b"x" * 60_000
        )
    assert status == 431, data


@pytest.mark.parametrize("start", [b"", b"GET / HTTP/1.1\r\nHost: local"])
async def test_a_client_that_says_nothing_is_let_go(start: bytes) -> None:
    async with site(asgi="header_timeout = 0.05") as gateway, connected(gateway) as raw:
        raw.send(start)
        await raw.ended()


async def test_a_client_that_begins_a_second_request_slowly_is_let_go() -> None:
    async with site(asgi="header_timeout = 0.05") as gateway, connected(gateway) as raw:
        raw.send(b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\nGET /hea")
        await raw.ended()


async def test_one_connection_too_many_is_refused() -> None:
    async with (
        site(asgi="connections = 1") as gateway,
        opened(gateway),
        connected(gateway) as second,
    ):
        status, data = await answer(second, b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n")
        assert status == 503
        assert b"queue_full" in data


async def test_pipelined_requests_are_answered_in_order(gateway: Site) -> None:
    one = f"GET {POSE}?id=%d HTTP/1.1\r\nHost: localhost\r\n\r\n"
    async with connected(gateway) as raw:
        raw.send(*((one % number).encode() for number in range(20)))
        for number in range(20):
            head = await raw.reader.readuntil(b"\r\n\r\n")
            length = int(head.partition(b"content-length: ")[2].partition(b"\r\n")[0])
            assert b'"id":"%d"' % number in await raw.reader.readexactly(length)


# -- browsers --------------------------------------------------------------------------------------


async def test_a_listed_page_may_read_and_write_across_origins() -> None:
    async with (
        site(asgi='origins = ["https://ui.example"]') as gateway,
        httpx.AsyncClient(base_url=gateway.url) as http,
    ):
        asking = {
            "origin": "https://ui.example",
            "access-control-request-method": "PUT",
            "access-control-request-headers": "authorization",
        }
        leave = await http.options(POSE, headers=asking)
        assert leave.status_code == 204
        assert leave.headers["access-control-allow-origin"] == "https://ui.example"
        assert leave.headers["access-control-allow-headers"] == "authorization"
        put = await http.put(
            "/rcp/v1/context/tenant/alpha/param/limit",
            content=b"1",
            headers={"origin": "https://ui.example", "authorization": f"Bearer {KEY}"},
        )
        assert put.headers["access-control-allow-origin"] == "https://ui.example"
        assert (await http.get(POSE)).headers.get("access-control-allow-origin") is None


async def test_other_pages_may_not_change_anything(http: httpx.AsyncClient) -> None:
    foreign = {"origin": "https://elsewhere.example"}
    assert (await http.post("/rcp/v1/messages", headers=foreign, json={})).status_code == 403
    read = await http.get(POSE, headers=foreign)
    assert "access-control-allow-origin" not in read.headers
    rebound = await http.get(POSE, headers={"host": "rebound.example"})
    assert (rebound.status_code, rebound.json()["error"]["code"]) == (403, "forbidden")


async def test_a_name_of_the_gateways_own_is_listed() -> None:
    async with (
        site(asgi='hosts = ["Robot.Example"]') as gateway,
        httpx.AsyncClient(base_url=gateway.url) as http,
    ):
        for name in ("robot.example:8080", "localhost", "[::1]:80"):
            assert (await http.get(POSE, headers={"host": name})).status_code == 200


# -- mounts ----------------------------------------------------------------------------------------


def _told(word: str) -> Any:
    async def app(scope: Any, receive: Any, send: Any) -> None:
        await respond(send, 200, f"{word} {scope['path']}".encode())

    return app


async def test_the_longest_prefix_wins_and_a_suffix_before_it(
    http: httpx.AsyncClient, gateway: Site
) -> None:
    client_api = gateway.server.client_api
    root = Mount(name="root", prefix="/", app=_told("root"))
    deep = Mount(name="deep", prefix="/page/deep", app=_told("deep"))
    tail = Mount(name="tail", prefix="/page", suffix=".css", app=_told("tail"))
    for mount in (root, deep, tail):
        client_api.mount(mount)
    with pytest.raises(PluginError, match="both serve"):
        client_api.mount(Mount(name="again", prefix="/page/deep", app=_told("again")))

    async def get(path: str) -> str:
        return (await http.get(path)).text

    assert await get("/page/deep/er") == "deep /page/deep/er"
    assert await get("/page/deep") == "deep /page/deep"
    assert await get("/page/deeper") == "root /page/deeper"
    assert await get("/page/deep/x.css") == "tail /page/deep/x.css"
    assert await get("/") == "root /"
    assert await get("/elsewhere/x") == "root /elsewhere/x"
    assert (await http.get("/healthz")).json() == {"status": "ok"}
    assert (await http.get(POSE)).json()["status"] == "completed"
    for mount in (root, deep, tail):
        client_api.unmount(mount)
    assert (await http.get("/page/deep")).status_code == 404


async def test_a_mount_that_fails_is_internal_without_a_traceback(
    http: httpx.AsyncClient, gateway: Site
) -> None:
    async def fails(scope: Any, receive: Any, send: Any) -> None:
        raise ZeroDivisionError

    gateway.server.client_api.mount(Mount(name="fails", prefix="/fails", app=fails))
    response = await http.get("/fails")
    assert (response.status_code, response.json()["error"]["code"]) == (500, "internal")
    assert "ZeroDivision" not in response.text


async def test_a_proxy_may_show_the_gateway_below_a_path() -> None:
    async with (
        site(asgi='root_path = "/robots"') as gateway,
        httpx.AsyncClient(
            base_url=f"http://127.0.0.1:{gateway.port}",
            headers={"authorization": f"Bearer {KEY}"},
        ) as http,
    ):
        assert gateway.url.endswith("/robots")
        for prefix in ("", "/robots"):
            assert (await http.get(prefix + POSE)).status_code == 200
        started = await http.post("/robots/rcp/v1/context/action/go", json=1)
        assert started.headers["location"].startswith("/robots/rcp/v1/commands/")


async def test_a_websocket_of_another_plugin_speaks_plain_asgi(gateway: Site) -> None:
    async def echo(scope: Any, receive: Any, send: Any) -> None:
        assert (await receive())["type"] == "websocket.connect"
        await send({"type": "websocket.accept"})
        while (message := await receive())["type"] == "websocket.receive":
            text = message.get("text")
            if text == "bye":
                await send({"type": "websocket.close", "code": 4001, "reason": "asked"})
                continue
            body = {"bytes": message["bytes"]} if text is None else {"text": text}
            await send({"type": "websocket.send", **body})

    gateway.server.client_api.mount(Mount(name="echo", prefix="/echo", kind="websocket", app=echo))
    from websockets.asyncio.client import connect
    from websockets.exceptions import ConnectionClosed

    async with connect(f"ws://127.0.0.1:{gateway.port}/echo") as wire:
        for message in ("text", b"bytes", "x" * 200_000):
            await wire.send(message)
            assert await wire.recv() == message
        await wire.send("bye")
        with pytest.raises(ConnectionClosed) as closed:
            await wire.recv()
        assert closed.value.rcvd is not None
        assert closed.value.rcvd.code == 4001


async def test_a_websocket_that_fails_closes_with_1011(gateway: Site) -> None:
    async def fails(scope: Any, receive: Any, send: Any) -> None:
        await receive()
        if scope["path"] == "/fails/late":
            await send({"type": "websocket.accept"})
        raise ZeroDivisionError

    gateway.server.client_api.mount(
        Mount(name="fails", prefix="/fails", kind="websocket", app=fails)
    )
    from transports.raw import handshake

    async with connected(gateway) as raw:
        assert (await answer(raw, handshake("/fails/early")))[0] == 500
    async with connected(gateway) as raw:
        raw.send(handshake("/fails/late"))
        await raw.reader.readuntil(b"\r\n\r\n")
        assert await raw.closed() == 1011


# -- the end ---------------------------------------------------------------------------------------


async def test_after_the_end_nothing_of_the_listener_is_left() -> None:
    before = asyncio.all_tasks()
    async with site() as gateway:
        port = gateway.port
        raw = connected(gateway)
        hanging = await raw.__aenter__()
        hanging.send(b"GET / HTTP/1.1\r\nHost: loc")
        async with opened(gateway) as peer:
            peer.send(frame(TEXT, b'{"type":"ping"}'))
            await peer.reply()
    with pytest.raises(OSError, match=r"refused|Connect call failed"):
        await asyncio.open_connection("127.0.0.1", port)
    await raw.__aexit__(None, None, None)
    await until(lambda: not asyncio.all_tasks() - before)


def test_the_configuration_is_safe_by_default() -> None:
    config = AsgiConfig()
    assert (config.host, config.origins) == ("127.0.0.1", ())
