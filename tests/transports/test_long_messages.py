"""Messages that are long, or hold much: each is bounded, waits for its turn, and keeps its place."""

from __future__ import annotations

import asyncio
import base64
import json

import httpx
import pytest

from rcp_http.request import HttpRequest
from rcp_scheduling.turns import Turns
from transports.raw import TEXT, frame, opened
from transports.robot import BOUND, KEY, Site, site

pytestmark = pytest.mark.anyio
AS = f"Bearer {KEY}"
LISTS = b"[" + b",".join([b"[]"] * 200_000) + b"]"


def written(path: str, body: bytes, id_: str = "w") -> bytes:
    return b'{"type":"write","id":"%b","path":"%b","body":%b}' % (id_.encode(), path.encode(), body)


async def test_more_values_than_may_be_are_refused_before_they_are_decoded(gateway: Site) -> None:
    async with opened(gateway, Authorization=AS) as raw:
        raw.send(frame(TEXT, written("/tenant/alpha/param/text", LISTS)))
        refused = await raw.reply()
        assert (refused["id"], refused["status"]) == ("w", "rejected")
        assert refused["error"]["code"] == "payload_too_large"
        assert refused["error"]["details"] == {"limit": 256 * 1024}
        raw.ask(type="ping", id="alive")
        assert (await raw.reply())["id"] == "alive"


async def test_more_values_than_may_be_are_refused_over_http(gateway: Site) -> None:
    async with httpx.AsyncClient(
        base_url=gateway.url, headers={"Authorization": AS}, timeout=BOUND
    ) as http:
        path = "/rcp/v1/context/tenant/alpha/param/text"
        kind = {"content-type": "application/json"}
        answer = await http.put(path, content=LISTS, headers=kind)
        assert answer.status_code == 413
        assert answer.json()["error"]["details"] == {"limit": 256 * 1024}


async def test_a_map_of_five_megabytes_is_taken(gateway: Site) -> None:
    body = b'"%b"' % base64.b64encode(bytes(5_000_000))
    async with opened(gateway, Authorization=AS) as raw:
        raw.send(frame(TEXT, written("/tenant/alpha/param/blob", body)))
        assert (await raw.reply())["status"] == "completed"


async def test_what_comes_after_a_long_message_is_handled_after_it(gateway: Site) -> None:
    text, others = "x" * 200_000, "y" * 200_000
    long = json.dumps(text).encode()
    async with opened(gateway, Authorization=AS) as raw, opened(gateway, Authorization=AS) as other:
        for turn in range(3):
            body = json.dumps(others).encode()
            other.send(frame(TEXT, written("/tenant/alpha/param/text", body, "o")))
            first = frame(TEXT, written("/tenant/alpha/param/text", long, "long"))
            then = frame(TEXT, written("/tenant/alpha/param/text", b'"%d"' % turn, "short"))
            raw.send(first + then)
            for number in range(300):
                raw.ask(type="ping", id=f"{number}")
            said = [(await raw.reply())["id"] for _ in range(302)]
            pings = [id_ for id_ in said if id_ not in ("long", "short")]
            assert pings == [f"{number}" for number in range(300)]
            assert (await other.reply())["status"] == "completed"
            writes = [value for _, value in gateway.robot.writes]
            assert writes.index(text) < writes.index(f"{turn}")
            gateway.robot.writes.clear()


async def test_what_was_answered_before_another_connection_took_over_still_comes() -> None:
    async with site(more="[limits]\nqueue_bytes = 67108864") as gateway:
        gateway.robot.host.publish("sensor/blob", bytes(450_000))
        async with opened(gateway, Authorization=AS) as raw:
            raw.ask(type="hello", id="h")
            mine = (await raw.reply())["body"]
            for number in range(20):
                raw.ask(type="read", id=f"{number}", path="/tenant/alpha/sensor/blob")
            async with opened(gateway, Authorization=AS) as other:
                other.ask(type="ping", id="there")
                await other.reply()
                other.ask(
                    type="hello",
                    id="h",
                    body={"session": mine["session"], "resume_token": mine["resume_token"]},
                )
                assert (await other.reply())["status"] == "completed"
                for number in range(20):
                    assert (await raw.reply())["id"] == f"{number}"
                assert await raw.closed() == 1008


async def test_long_bodies_that_arrive_together_have_a_turn_each() -> None:
    turns = Turns(asyncio.get_running_loop())
    head = {"headers": [], "method": "PUT", "path": "/", "query_string": b""}
    taken: list[int] = []

    async def read() -> None:
        parts = [b"x" * 200_000, b"y" * 200_000]

        async def receive() -> dict[str, object]:
            return {"type": "http.request", "body": parts.pop(0), "more_body": bool(parts)}

        http = HttpRequest(head)
        body = await http.body(receive, 1_000_000, 60.0, turns, "one")
        assert len(body) == 400_000
        turns.add(1.0)  # what follows from it
        taken.append(turns.number)

    async with asyncio.timeout(BOUND), asyncio.TaskGroup() as group:
        for _ in range(8):
            group.create_task(read())
    assert len(set(taken)) == 8
