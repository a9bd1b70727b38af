"""Bugs in what handles requests: whoever asked is answered or cut off, and the log has the reason."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from typing import Any, NoReturn

import httpx
import pytest
from structlog.testing import capture_logs

from rcp_gateway.client_api import Mount
from rcp_web.asgi import Receive, Scope, Send
from transports.raw import connected, opened
from transports.robot import BOUND, KEY, Site, site

pytestmark = pytest.mark.anyio
POSE = "/tenant/alpha/sensor/pose"
AUTH = f"Bearer {KEY}"


def break_(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have every request that names a path meet a bug."""

    def broken(*_: Any, **__: Any) -> NoReturn:
        raise ZeroDivisionError

    monkeypatch.setattr("rcp_requests.admission.Resolver.resolve", broken)
    monkeypatch.setattr("rcp_requests.read._READ", 0)  # no read is answered without it


@pytest.fixture
async def gateway() -> AsyncGenerator[Site]:
    async with site() as made:
        yield made


def crashes(said: list[Any]) -> list[str]:
    return [one["trace_id"] for one in said if one["event"] == "request_crashed"]


REQUESTS = [
    {"type": "read", "path": POSE, "id": "1"},
    {"type": "read", "path": "/tenant/alpha/sensor/silent", "deadline": 0.05, "id": "1"},
    {"type": "write", "path": "/tenant/alpha/param/limit", "body": 1.0, "id": "1"},
    {"type": "execute", "path": "/tenant/alpha/service/add", "body": 1, "id": "1"},
    {"type": "subscribe", "path": POSE, "id": "1"},
]


@pytest.mark.parametrize(
    "request_", REQUESTS, ids=[f"{n}-{r['type']}" for n, r in enumerate(REQUESTS)]
)
async def test_a_bug_in_the_handling_of_a_request_leaves_nobody_without_an_answer(
    gateway: Site, monkeypatch: pytest.MonkeyPatch, request_: dict[str, Any]
) -> None:
    break_(monkeypatch)
    async with asyncio.timeout(BOUND), opened(gateway, authorization=AUTH) as raw:
        with capture_logs() as said:
            raw.ask(**request_)
            reply = await raw.reply()
        assert (reply["id"], reply["type"]) == ("1", request_["type"])
        assert reply["error"]["code"] == "internal"
        assert reply["error"]["trace_id"] in crashes(said)


@pytest.mark.parametrize(
    ("method", "path", "body"),
    [
        ("GET", "/rcp/v1/context/tenant/alpha/sensor/silent", None),
        ("PUT", "/rcp/v1/context/tenant/alpha/param/limit", 1.0),
        ("POST", "/rcp/v1/context/tenant/alpha/service/add", 1),
        ("POST", "/rcp/v1/messages", {"type": "read", "path": POSE}),
        ("GET", "/rcp/v1/events?path=/tenant/alpha/sensor/pose", None),
    ],
)
async def test_over_http_it_is_a_500_with_the_trace_id(
    monkeypatch: pytest.MonkeyPatch, http: httpx.AsyncClient, method: str, path: str, body: Any
) -> None:
    break_(monkeypatch)
    with capture_logs() as said:
        response = await http.request(method, path, json=body)
    error = response.json()["error"]
    assert (response.status_code, error["code"]) == (500, "internal")
    assert error["trace_id"] in crashes(said)


async def test_a_bug_while_a_message_is_taken_is_answered(
    gateway: Site, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: Any) -> NoReturn:
        raise ZeroDivisionError

    async with asyncio.timeout(BOUND), opened(gateway, authorization=AUTH) as raw:
        for target, type_ in (
            ("rcp_requests.connections.decode_request", "read"),
            ("rcp_ws.client.segments.read", "segment"),
        ):
            with monkeypatch.context() as patched, capture_logs() as said:
                patched.setattr(target, broken)
                raw.ask(type=type_, path=POSE, id="1")
                reply = await raw.reply()
            assert (reply["id"], reply["error"]["code"]) == ("1", "internal")
            assert reply["error"]["trace_id"] in crashes(said)
        raw.ask(type="ping", id="2")
        assert (await raw.reply())["id"] == "2"


@pytest.mark.parametrize(
    "target",
    [
        "rcp_requests.connections.Connection.answer_internal_error",
        "rcp_kernel.sessions.outbox.Outbox.collect",
        "rcp_ws.client.WsClient.settled",
    ],
)
async def test_where_not_even_an_answer_can_be_made_the_connection_is_closed_with_a_code(
    gateway: Site, monkeypatch: pytest.MonkeyPatch, target: str
) -> None:
    def broken(*_: Any, **__: Any) -> NoReturn:
        raise ZeroDivisionError

    with capture_logs() as said:
        monkeypatch.setattr(target, broken)
        if target.endswith("answer_internal_error"):
            monkeypatch.setattr("rcp_requests.connections.decode_request", broken)
        async with asyncio.timeout(BOUND), opened(gateway, authorization=AUTH) as raw:
            raw.ask(type="subscribe", path=POSE, id="1")
            assert await raw.closed() == 1011
    assert "websocket_failed" in [one["event"] for one in said]


async def test_who_leaves_while_answered_is_noticed_although_another_request_waits(
    gateway: Site,
) -> None:
    left = asyncio.Event()

    async def endless(_scope: Scope, receive: Receive, send: Send) -> None:
        async def watch() -> None:
            while (await receive())["type"] != "http.disconnect":
                pass
            left.set()

        async with asyncio.TaskGroup() as group:
            group.create_task(watch())
            await send({"type": "http.response.start", "status": 200, "headers": []})
            while not left.is_set():
                part = {"type": "http.response.body", "body": bytes(65_536), "more_body": True}
                await send(part)
                await asyncio.sleep(0)

    mount = Mount(name="endless", prefix="/endless", app=endless)
    gateway.server.client_api.mount(mount)
    with capture_logs() as said:
        async with connected(gateway) as raw, asyncio.timeout(BOUND):
            raw.send(b"GET /endless HTTP/1.1\r\nHost: localhost\r\n\r\n" * 2)
            await raw.reader.readexactly(1000)
            raw.writer.transport.abort()
            await left.wait()
    gateway.server.client_api.unmount(mount)
    assert said == []
