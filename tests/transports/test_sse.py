from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncGenerator, AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import httpx
import pytest

from rcp_sse.journal import Journal, parse_event_id
from transports.raw import connected
from transports.robot import BOUND, KEY, Site, site, until

pytestmark = pytest.mark.anyio
EVENTS = "/rcp/v1/events"
Event = dict[str, Any]


class Events:
    """The events of a stream, one at a time."""

    def __init__(self, response: httpx.Response) -> None:
        self.response = response
        self._lines: AsyncIterator[str] = response.aiter_lines()

    async def next(self) -> Event:
        found: Event = {}
        async with asyncio.timeout(BOUND):
            async for line in self._lines:
                if not line and "data" in found:
                    return found
                name, _, value = line.partition(": ")
                if name:
                    found[name] = json.loads(value) if name == "data" else value
        raise EOFError

    async def rest(self) -> list[Event]:
        """Read to the end of the stream."""
        found: list[Event] = []
        try:
            while True:
                found.append(await self.next())
        except EOFError:
            return found


@asynccontextmanager
async def stream(
    http: httpx.AsyncClient, url: str, last: str | None = None
) -> AsyncGenerator[Events]:
    headers = {} if last is None else {"last-event-id": last}
    async with http.stream("GET", url, headers=headers) as response:
        assert response.status_code == 200, await response.aread()
        assert response.headers["content-type"].startswith("text/event-stream")
        yield Events(response)


async def test_updates_come_as_events_with_ids(http: httpx.AsyncClient, gateway: Site) -> None:
    async with stream(http, f"{EVENTS}?path=/sensor/text") as events:
        first = await events.next()
        assert (first["event"], first["data"]["body"]) == ("update", "x")
        session, _, number = first["id"].rpartition(":")
        assert session.startswith("s-")
        gateway.robot.host.publish("sensor/text", "y")
        second = await events.next()
        assert (second["id"], second["data"]["body"]) == (f"{session}:{int(number) + 1}", "y")


async def test_options_are_parameters(http: httpx.AsyncClient, gateway: Site) -> None:
    where = json.dumps({"field": "position.x", "gt": 5})
    query = httpx.QueryParams(
        [
            ("path", "/tenant/alpha/sensor/pose"),
            ("path", "/tenant/beta/sensor/*"),
            ("where", where),
            ("fields", "position.x,position.y"),
            ("count", "1"),
            ("qos", '{"depth": 3}'),
            ("reliability", "reliable"),
            ("on", "change"),
            ("initial", "false"),
        ]
    )
    async with stream(http, f"{EVENTS}?{query}") as events:
        for x in (1.0, 6.0, 7.0):
            gateway.robot.host.publish("sensor/pose", {"position": {"x": x, "y": 0.0}})
        found = await events.rest()
    assert found[0]["data"]["body"] == {"position": {"x": 6.0, "y": 0.0}}
    assert found[-1]["event"] == "notice"
    assert found[-1]["data"]["code"] == "subscription_ended"


@pytest.mark.parametrize(
    ("url", "status", "code"),
    [
        (EVENTS, 400, "bad_request"),
        (f"{EVENTS}?path=/sensor/none", 404, "unknown_path"),
        (f"{EVENTS}?path=sensor", 400, "invalid_path"),
        (f"{EVENTS}?path=/sensor/text&speed=1", 400, "bad_request"),
        (f"{EVENTS}?path=/sensor/text&rate=fast", 400, "bad_request"),
        (f"{EVENTS}?path=/sensor/text&rate=1&rate=2", 400, "bad_request"),
        (f"{EVENTS}?path=/sensor/text&where=x", 400, "bad_request"),
        (f"{EVENTS}?path=/sensor/text&rate=-1", 422, "out_of_range"),
        (f"{EVENTS}?path=/sensor/text&fields=none", 400, "filter_unsupported"),
        (f"{EVENTS}?path=/action/go", 405, "unsupported_operation"),
        ("/rcp/v1/status/events?path=/sensor/text", 400, "bad_request"),
        ("/rcp/v1/commands/none/events", 404, "unknown_path"),
    ],
)
async def test_what_cannot_be_streamed_is_refused_with_an_envelope(
    http: httpx.AsyncClient, url: str, status: int, code: str
) -> None:
    response = await http.get(url)
    assert (response.status_code, response.json()["error"]["code"]) == (status, code)


async def test_a_stream_is_neither_posted_nor_taken_as_json(http: httpx.AsyncClient) -> None:
    url = f"{EVENTS}?path=/sensor/text"
    assert (await http.post(url)).status_code == 405
    assert (await http.get(url, headers={"accept": "application/json"})).status_code == 400
    assert (await http.options(url)).headers["allow"] == "GET, OPTIONS"
    nobody = {"authorization": "Bearer nobody-has-this-key"}
    refused = await http.get(url, headers=nobody)
    assert (refused.status_code, refused.headers["www-authenticate"]) == (401, "Bearer")


@pytest.mark.parametrize("by", ["header", "query"])
async def test_a_stream_goes_on_where_its_client_left_it(
    http: httpx.AsyncClient, gateway: Site, by: str
) -> None:
    url = f"{EVENTS}?path=/tenant/*/sensor/text&depth=50"
    async with stream(http, url) as events:
        seen = [await events.next() for _ in range(2)]
        for number in range(3):
            gateway.robots[number % 2].host.publish("sensor/text", f"v{number}")
            seen.append(await events.next())
    await until(lambda: not _connections(gateway))
    gateway.robots[0].host.publish("sensor/text", "missed by a")
    gateway.robots[1].host.publish("sensor/text", "missed by b")
    last = seen[2]["id"]
    again = url if by == "header" else f"{url}&last_event_id={last}"
    async with stream(http, again, last if by == "header" else None) as events:
        bodies = {(await events.next())["data"]["body"] for _ in range(4)}
    assert bodies == {"v1", "v2", "missed by a", "missed by b"}


async def test_a_stream_whose_session_is_gone_says_gap_and_goes_on(
    http: httpx.AsyncClient,
) -> None:
    async with stream(http, f"{EVENTS}?path=/sensor/text", "s-0123:7") as events:
        gap = await events.next()
        assert (gap["event"], gap["data"]["code"]) == ("notice", "gap")
        assert (await events.next())["event"] == "update"


async def test_somebody_elses_stream_is_not_taken_over(http: httpx.AsyncClient) -> None:
    async with stream(http, f"{EVENTS}?path=/sensor/text") as events:
        last = (await events.next())["id"]
        headers = {"last-event-id": last, "authorization": "Bearer key-of-tenant-beta"}
        response = await http.get(f"{EVENTS}?path=/sensor/text", headers=headers)
        assert response.json()["error"]["code"] == "unauthenticated"


async def test_an_ended_stream_leaves_no_session(http: httpx.AsyncClient, gateway: Site) -> None:
    async with stream(http, f"{EVENTS}?path=/sensor/text&count=1") as events:
        await events.rest()
    await until(lambda: not gateway.server.gateway.sessions.known)


async def test_the_comment_keeps_a_quiet_stream_awake() -> None:
    async with (
        site(sse="comment = 0.02") as gateway,
        httpx.AsyncClient(base_url=gateway.url) as http,
        http.stream("GET", f"{EVENTS}?path=/sensor/text&initial=false") as response,
    ):
        lines = response.aiter_lines()
        async with asyncio.timeout(BOUND):
            found = [await anext(lines) for _ in range(8)]
        assert found[2:8:2] == [":", ":", ":"]


async def test_a_client_that_does_not_read_costs_no_memory(gateway: Site) -> None:
    async with connected(gateway) as raw:
        raw.send(f"GET {EVENTS}?path=/sensor/text HTTP/1.1\r\nHost: localhost\r\n\r\n".encode())
        async with asyncio.timeout(BOUND):
            await raw.reader.readuntil(b"event: update")
        for number in range(400):
            gateway.robot.host.publish("sensor/text", f"{number}:" + "x" * 100_000)
            await asyncio.sleep(0)
        held = _connections(gateway)
        assert len(held) == 1
        assert held[0].outbox.depth == 1
        tail = b""
        async with asyncio.timeout(BOUND):
            while b'"body":"399:' not in tail:
                tail = tail[-20:] + await raw.reader.read(65_536)


async def test_a_command_is_followed_to_its_end(http: httpx.AsyncClient, gateway: Site) -> None:
    started = await http.post("/rcp/v1/context/action/go", json=4)
    await gateway.robot.started.get()
    place = started.headers["location"]
    async with stream(http, f"{place}/events") as events:
        history = [await events.next(), await events.next()]
        assert [one["data"]["status"] for one in history] == ["accepted", "in_progress"]
        gateway.robot.release.set()
        end = await events.rest()
        assert [one["data"]["status"] for one in end] == ["completed"]
        assert {one["event"] for one in end} == {"reply"}
    async with stream(http, f"{place}/events", history[1]["id"]) as events:
        assert [one["data"]["status"] for one in await events.rest()] == ["completed"]
    async with stream(http, f"{place}/events", end[0]["id"]) as events:
        assert [one["data"]["status"] for one in await events.rest()] == ["completed"]


async def test_the_status_is_a_stream_of_its_own(http: httpx.AsyncClient) -> None:
    async with stream(http, "/rcp/v1/status/events?count=1") as events:
        found = await events.rest()
    assert found[0]["data"]["path"] == "/system/status"
    assert found[0]["data"]["body"]["state"] == "ok"


async def test_streams_end_when_the_gateway_does() -> None:
    async with site() as gateway:
        http = httpx.AsyncClient(base_url=gateway.url, headers={"authorization": f"Bearer {KEY}"})
        response = await http.send(
            http.build_request("GET", f"{EVENTS}?path=/sensor/text"), stream=True
        )
        events = Events(response)
        await events.next()
    await events.rest()
    await response.aclose()
    await http.aclose()


def test_a_journal_knows_the_way_back_as_far_as_it_reaches() -> None:
    journal = Journal(4)
    for number, path in enumerate("abcabc", 1):
        assert journal.note(path, number * 10) == number
    assert journal.until(6) == {"a": 40, "b": 50, "c": 60}
    assert journal.until(3) == {"a": 10, "b": 20, "c": 30}
    assert journal.until(2) == {"a": 10, "b": 20}
    assert journal.until(1) is None
    assert journal.until(7) is None


@pytest.mark.parametrize("text", [None, "", "x", ":1", "s-1:", "s-1:x", "s-1:99999999999999999"])
def test_an_id_that_is_none_is_not_one(text: str | None) -> None:
    assert parse_event_id(text) is None


def _connections(gateway: Site) -> list[Any]:
    known = gateway.server.gateway.sessions.known.values()
    return [session.connection for session in known if session.connection is not None]
