"""The endpoint: who gets in, whose session it is, and what those who listen are told."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncGenerator, AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from typing import Any

import httpx
import pytest

from expiring import LIFE, brief_key
from plugins.mcp.rig import BOUND, EVERY_TOOL, OPERATOR, Caller, Site, caller, site
from rcp_gateway.testing import SteppedClock
from rcp_kernel.model import Resource

INITIALIZE: dict[str, Any] = {
    "jsonrpc": "2.0",
    "id": 1,
    "method": "initialize",
    "params": {
        "protocolVersion": "2025-06-18",
        "capabilities": {},
        "clientInfo": {"name": "old", "version": "1"},
    },
}
HEADERS = {
    "accept": "application/json, text/event-stream",
    "authorization": f"Bearer {OPERATOR}",
}


async def test_a_token_that_is_not_good_is_refused_with_where_to_get_one(gateway: Site) -> None:
    async with caller(gateway, "nonsense") as stranger:
        body = stranger.body("tools/list", {})
        response = await stranger.http.post(
            stranger.url, json=body, headers={"mcp-method": "tools/list"}
        )
        assert response.status_code == 401
        where = f"{gateway.base}/.well-known/oauth-protected-resource/mcp"
        assert f'resource_metadata="{where}"' in response.headers["www-authenticate"]
        assert response.json()["error"]["data"]["code"] == "unauthenticated"
        reply = (await stranger.http.get(where)).json()
        assert reply["resource"] == gateway.url
        assert reply["bearer_methods_supported"] == ["header"]


async def test_without_anonymous_nobody_looks_and_the_issuer_is_told() -> None:
    more = """
anonymous = false
"""
    issuer = """
[[jwt]]
issuer = "https://login.example"
audience = "rcp"
role = "viewer"
jwks_url = "https://login.example/keys"
"""
    async with site(top=more, more=issuer) as made, caller(made, None) as stranger:
        body = stranger.body("tools/list", {})
        response = await stranger.http.post(
            made.url, json=body, headers={"mcp-method": "tools/list"}
        )
        assert response.status_code == 401
        reply = await stranger.http.get(f"{made.base}/.well-known/oauth-protected-resource/mcp")
        assert reply.json()["authorization_servers"] == ["https://login.example"]


@pytest.mark.parametrize("chunked", [False, True])
async def test_a_long_request_is_refused_by_who_sends_it_before_it_is_read(
    gateway: Site, *, chunked: bool
) -> None:
    long = json.dumps({**INITIALIZE, "id": "x" * 200_000}).encode()

    async def parts() -> AsyncIterator[bytes]:
        yield long[:100_000]
        yield long[100_000:]

    anonymous = {"accept": HEADERS["accept"], "content-type": "application/json"}
    async with httpx.AsyncClient(headers=anonymous, trust_env=False) as client:
        response = await client.post(gateway.url, content=parts() if chunked else long)
        assert response.status_code == 413, response.text
        own = {"authorization": HEADERS["authorization"]}
        taken = await client.post(gateway.url, content=long, headers=own)
        assert taken.status_code == 200, taken.text
        more = json.dumps({**INITIALIZE, "id": "x" * 2_000_000}).encode()
        refused = await client.post(gateway.url, content=more, headers=own)
        assert refused.status_code == 413


async def test_a_long_request_over_the_quota_is_refused_before_it_is_read() -> None:
    quota = "[quotas.principal]\nrequests = 0.01\nburst = 1"
    async with site(top=quota) as made, caller(made) as operator:
        path = "/rcp/v1/context/tenant/alpha/sensor/nothing"
        await operator.http.get(made.base + path, headers=HEADERS)
        garbage = b"[" * 200_000
        headers = HEADERS | {"content-type": "application/json"}
        response = await operator.http.post(made.url, content=garbage, headers=headers)
        assert (response.status_code, response.json()["error"]["data"]["code"]) == (
            429,
            "rate_limited",
        )


async def test_foreign_names_and_origins_are_refused(gateway: Site) -> None:
    async with httpx.AsyncClient(headers=HEADERS, trust_env=False) as client:
        for header in ({"host": "evil.example"}, {"origin": "https://evil.example"}):
            response = await client.post(gateway.url, json=INITIALIZE, headers=header)
            assert response.status_code == 403


async def test_a_session_is_its_openers_alone(gateway: Site) -> None:
    async with httpx.AsyncClient(headers=HEADERS, trust_env=False) as client:
        opened = await client.post(gateway.url, json=INITIALIZE)
        session = {"mcp-session-id": opened.headers["mcp-session-id"]}
        ping = {"jsonrpc": "2.0", "id": 2, "method": "ping"}
        assert (await client.post(gateway.url, json=ping, headers=session)).status_code == 200
        del client.headers["authorization"]
        stolen = await client.post(gateway.url, json=ping, headers=session)
        assert stolen.status_code == 404


@asynccontextmanager
async def listening(client: Caller, **wanted: Any) -> AsyncGenerator[asyncio.Queue[dict[str, Any]]]:
    """Listen; what comes is put into the queue."""
    heard: asyncio.Queue[dict[str, Any]] = asyncio.Queue()

    async def listen() -> None:
        body = client.body("subscriptions/listen", {"notifications": wanted})
        headers = {"mcp-method": "subscriptions/listen"}
        async with client.http.stream("POST", client.url, json=body, headers=headers) as response:
            async for line in response.aiter_lines():
                if line.startswith("data:"):
                    heard.put_nowait(json.loads(line[5:]))

    task = asyncio.create_task(listen())
    try:
        async with asyncio.timeout(BOUND):
            first = await heard.get()
            assert first["method"] == "notifications/subscriptions/acknowledged"
            yield heard
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


async def test_who_listens_hears_of_changes_that_he_may_see(
    gateway: Site, operator: Caller
) -> None:
    async with listening(operator, toolsListChanged=True) as heard:
        gateway.robots[1].host.declare(Resource(name="service/other", description="Of beta."))
        gateway.robot.host.declare(Resource(name="service/late", description="Came late."))
        assert (await heard.get())["method"] == "notifications/tools/list_changed"
        assert "service-late" in await operator.tools()
        gateway.robot.host.withdraw("service/late")
        assert (await heard.get())["method"] == "notifications/tools/list_changed"
        assert "service-late" not in await operator.tools()


async def test_a_change_that_is_hidden_makes_no_news(gateway: Site, operator: Caller) -> None:
    async with listening(operator, toolsListChanged=True) as heard:
        gateway.robots[1].host.declare(Resource(name="service/other", description="Of beta."))
        await asyncio.sleep(0.6)  # twice as long as the tree is left alone
        assert heard.empty()


async def test_who_listens_to_a_resource_hears_of_new_values(
    gateway: Site, operator: Caller
) -> None:
    uris = ["rcp://alpha/sensor/level", "rcp://beta/sensor/level", "rcp://alpha/sensor/none"]
    async with listening(operator, resourceSubscriptions=uris) as heard:
        for level in range(50):
            gateway.robots[1].host.publish("sensor/level", float(level))
            gateway.robot.host.publish("sensor/level", float(level))
            await asyncio.sleep(0.01)
            if not heard.empty():
                break
        reply = await heard.get()
        assert reply["method"] == "notifications/resources/updated"
        assert reply["params"]["uri"] == "rcp://alpha/sensor/level"


class Older:
    """A client of 2025-11-25 with a session."""

    def __init__(self, url: str, http: httpx.AsyncClient) -> None:
        self.url = url
        self.http = http
        self.session: dict[str, str] = {}

    async def open(self) -> None:
        params = {**INITIALIZE["params"], "protocolVersion": "2025-11-25"}
        opened = await self.http.post(self.url, json={**INITIALIZE, "params": params})
        self.session = {
            "mcp-session-id": opened.headers["mcp-session-id"],
            "mcp-protocol-version": "2025-11-25",
        }
        await self.post({"method": "notifications/initialized"})

    async def post(self, message: dict[str, Any]) -> httpx.Response:
        return await self.http.post(
            self.url, json={"jsonrpc": "2.0", **message}, headers=self.session
        )

    @asynccontextmanager
    async def stream(self, **headers: str) -> AsyncGenerator[AsyncIterator[str]]:
        async with self.http.stream(
            "GET", self.url, headers={**self.session, **headers}
        ) as response:
            assert response.status_code == 200
            yield response.aiter_lines()


@pytest.fixture
async def older(gateway: Site) -> AsyncGenerator[Callable[[], Older]]:
    async with httpx.AsyncClient(headers=HEADERS, trust_env=False, timeout=BOUND) as http:
        yield lambda: Older(gateway.url, http)


async def methods(lines: AsyncIterator[str], count: int) -> list[str]:
    """Return what the next notifications are about."""
    found: list[str] = []
    async with asyncio.timeout(BOUND):
        async for line in lines:
            if line.startswith("data: {"):
                found.append(json.loads(line[6:])["method"].removeprefix("notifications/"))
                if len(found) == count:
                    break
    return found


async def test_an_older_client_hears_of_changes_and_values_too(
    gateway: Site, older: Callable[[], Older]
) -> None:
    client = older()
    await client.open()
    async with client.stream() as lines:
        gateway.robot.host.declare(Resource(name="service/late", description="Came late."))
        changed = {"tools/list_changed", "resources/list_changed"}
        assert set(await methods(lines, 2)) == changed
    params = {"uri": "rcp://alpha/sensor/level"}
    await client.post({"id": 2, "method": "resources/subscribe", "params": params})
    async with client.stream() as lines:
        telling = asyncio.create_task(methods(lines, 1))
        for level in range(200):
            gateway.robot.host.publish("sensor/level", float(level))
            await asyncio.sleep(0.02)
            if telling.done():
                break
        assert await telling == ["resources/updated"]


async def test_no_client_listens_to_resources_without_end() -> None:
    more = EVERY_TOOL + "subscriptions = 2\n"
    async with (
        site(mcp=more) as made,
        httpx.AsyncClient(headers=HEADERS, trust_env=False, timeout=BOUND) as http,
    ):
        client = Older(made.url, http)
        await client.open()

        async def listening(uri: str) -> str:
            call = {"id": 2, "method": "resources/subscribe", "params": {"uri": uri}}
            return (await client.post(call)).text

        for name in "ab":
            assert "error" not in await listening(f"rcp://alpha/sensor/{name}")
        assert "error" not in await listening("rcp://alpha/sensor/a")  # it does already
        refused = await listening("rcp://alpha/sensor/c")
        assert "at most 2 resources, and these are 3" in refused
        assert "raise `subscriptions` in `[plugins.mcp]`" in refused


async def test_a_uri_that_is_listened_to_is_not_longer_than_others(
    older: Callable[[], Older],
) -> None:
    client = older()
    await client.open()
    call = {"id": 2, "method": "resources/subscribe", "params": {"uri": "rcp://" + "x" * 5000}}
    assert "at most 2048 characters" in (await client.post(call)).text


async def test_a_listen_to_too_many_resources_says_how_many_are_allowed() -> None:
    async with (
        site(mcp=EVERY_TOOL + "subscriptions = 2\n") as made,
        caller(made) as client,
        asyncio.timeout(BOUND),
    ):
        uris = [f"rcp://alpha/sensor/{name}" for name in "abc"]
        body = client.body(
            "subscriptions/listen", {"notifications": {"resourceSubscriptions": uris}}
        )
        headers = {"mcp-method": "subscriptions/listen"}
        response = await client.http.post(client.url, json=body, headers=headers)
        assert "at most 2 resources, and these are 3" in response.text


async def test_a_session_reads_on_after_a_cut_and_no_other_reads_that(
    gateway: Site, older: Callable[[], Older]
) -> None:
    one, other = older(), older()
    await one.open()
    await other.open()
    call = {"name": "read", "arguments": {"path": "/sensor/level"}}
    answer = await one.post({"id": 7, "method": "tools/call", "params": call})
    await other.post({"id": 7, "method": "tools/call", "params": call})
    first = next(line[4:] for line in answer.text.splitlines() if line.startswith("id: "))

    async def again(client: Older, within: float) -> str:
        message = ""
        with suppress(TimeoutError):
            async with asyncio.timeout(within), client.stream(**{"last-event-id": first}) as lines:
                async for line in lines:
                    message += line
                    if "1.25" in message:
                        break
        return message

    assert "1.25" in await again(one, BOUND)
    assert "1.25" not in await again(other, 2)


async def test_a_proof_that_ends_closes_what_it_opened(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rcp_kernel.sessions.credential_expiry._LOOK", 0.05)
    time = SteppedClock()
    async with (
        site(clock=time.clock) as made,
        caller(made, brief_key(made.server)) as client,
    ):
        async with asyncio.timeout(BOUND):
            with suppress(httpx.RemoteProtocolError):
                body = client.body("subscriptions/listen", {"notifications": {}})
                headers = {"mcp-method": "subscriptions/listen"}
                async with client.http.stream(
                    "POST", client.url, json=body, headers=headers
                ) as response:
                    assert response.status_code == 200
                    time.adjust(LIFE + 1)
                    async for _ in response.aiter_lines():
                        pass
        answer = await client.send("tools/list")
        assert answer["error"]["data"]["code"] == "token_expired"


async def test_lists_count_against_a_quota_as_calls_do() -> None:
    hasty = """
[quotas.principal]
requests = 0.004
burst = 3
"""
    async with site(more=hasty) as made, caller(made) as client:
        answers = [await client.send("tools/list") for _ in range(6)]
        refused = [one["error"] for one in answers if "error" in one]
        assert refused
        assert refused[0]["data"]["code"] == "rate_limited"
        assert refused[0]["data"]["retry_after"] > 0
        call = await client.call("read", path="/sensor/level")
        assert call["structuredContent"]["error"]["code"] == "rate_limited"
