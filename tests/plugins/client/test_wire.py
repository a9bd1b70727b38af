"""What a gateway may send that a good one seldom does, and how it may refuse."""

from __future__ import annotations

import asyncio
import base64
import json
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from http import HTTPStatus
from typing import Any

import pytest
from websockets.asyncio.server import serve

from plugins.client.gateway import BOUND
from plugins.client.heard import Heard
from plugins.client.peer import Peer, peer, refusal, reply, segments, update
from rcp_client import Client, ConnectionLost, connect
from rcp_client.errors import error_of
from rcp_client.messages import Reply
from rcp_kernel.errors import (
    Forbidden,
    Overrun,
    PayloadTooLarge,
    RateLimited,
    Refused,
    TokenExpired,
    Unauthenticated,
    UnknownPath,
)

pytestmark = pytest.mark.anyio


@asynccontextmanager
async def played(**options: Any) -> AsyncGenerator[tuple[Peer, Client]]:
    async with (
        asyncio.timeout(BOUND),
        peer() as made,
        connect(made.url, encoding="json", **options) as client,
    ):
        yield made, client


def test_an_error_is_retryable_if_the_reply_says_so_whatever_its_code() -> None:
    for retryable in (False, True):
        facts = {"code": "adapter_unavailable", "retryable": retryable}
        error = error_of(Reply(type="execute", status="failed", error=facts))
        assert error is not None
        assert error.retryable is retryable


# -- long messages -------------------------------------------------------------------------------


async def test_a_reply_in_parts_is_put_together_whatever_comes_in_between() -> None:
    async with played() as (gateway, client):
        pending = [asyncio.create_task(client.read(path)) for path in ("/sensor/a", "/sensor/b")]
        big, small = [await gateway.next("read") for _ in pending]
        first, *rest = segments(reply(big, "x" * 500))
        await gateway.send(first)
        await gateway.send(reply(small, 2))
        assert await pending[1] == 2
        for part in rest:
            await gateway.send(part)
        assert await pending[0] == "x" * 500


async def test_a_damaged_transfer_is_asked_for_again() -> None:
    async with played() as (gateway, client):
        pending = asyncio.create_task(client.read("/sensor/a"))
        parts = segments(reply(await gateway.next("read"), "x" * 500))
        damaged = [dict(part) for part in parts]
        damaged[2]["body"] = base64.b64encode(b"y" * 64).decode()
        for part in damaged:
            await gateway.send(part)
        wish = await gateway.next("segment")
        assert wish == {"type": "segment", "id": "t-1", "resend": list(range(len(parts)))}
        for part in parts:
            await gateway.send(part)
        assert await pending == "x" * 500


async def test_parts_that_stay_away_are_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rcp_client.link._SWEEP", 0.01)
    monkeypatch.setattr("rcp_client.link._PART_WAIT", 0.05)
    async with played() as (gateway, client):
        pending = asyncio.create_task(client.read("/sensor/a"))
        parts = segments(reply(await gateway.next("read"), "x" * 500))
        for part in (*parts[:3], *parts[4:]):
            await gateway.send(part)
        assert (await gateway.next("segment"))["resend"] == [3]
        await gateway.send(parts[3])
        assert await pending == "x" * 500


async def test_a_long_request_goes_in_parts_and_any_of_them_again() -> None:
    async with played() as (gateway, client):
        writing = asyncio.create_task(client.write("/param/a", "x" * 5000))
        parts = [await gateway.next("segment")]
        parts += [await gateway.next("segment") for _ in range(1, parts[0]["total"])]
        assert all(len(json.dumps(part)) <= gateway.segment_size for part in parts)
        whole = b"".join(base64.b64decode(part["body"]) for part in parts)
        assert len(whole) == parts[0]["size"]
        await gateway.send({"type": "segment", "id": parts[0]["id"], "resend": [1]})
        assert await gateway.next("segment") == parts[1]
        await gateway.send(reply(json.loads(whole), "done"))
        assert await writing == "done"


async def test_a_refused_transfer_is_the_refusal_of_its_request() -> None:
    async with played() as (gateway, client):
        writing = asyncio.create_task(client.write("/param/a", "x" * 5000))
        part = await gateway.next("segment")
        await gateway.send({**refusal(part, "payload_too_large"), "type": "segment"})
        with pytest.raises(PayloadTooLarge):
            await writing


# -- updates -------------------------------------------------------------------------------------


@asynccontextmanager
async def watched(**options: Any) -> AsyncGenerator[tuple[Peer, Any, dict[str, Any], Heard]]:
    heard = Heard()
    async with played(on_notice=heard) as (gateway, client):
        subscription = client.subscribe("/sensor/a", **options)
        entering = asyncio.create_task(subscription.__aenter__())
        asked = await gateway.next("subscribe")
        await gateway.send(reply(asked, {"subscription": asked["id"], "paths": []}))
        await entering
        yield gateway, subscription, asked, heard


async def test_an_update_that_comes_twice_is_given_once() -> None:
    async with watched() as (gateway, subscription, asked, _):
        for seq in (4, 5, 4, 5, 6):
            await gateway.send(update(asked, seq))
        updates = aiter(subscription)
        assert [(await anext(updates)).seq for _ in range(3)] == [4, 5, 6]
        assert subscription.duplicates == 2


async def test_a_value_too_long_for_a_pattern_is_told_by_its_length() -> None:
    async with watched(type=int) as (gateway, subscription, asked, _):
        cut = update(asked, 4, truncated=True, size=5_333_421)
        del cut["body"]
        await gateway.send(cut)
        await gateway.send(update(asked, 5))
        updates = aiter(subscription)
        told, whole = await anext(updates), await anext(updates)
        assert (told.truncated, told.size, told.body) == (True, 5_333_421, None)
        assert (whole.truncated, whole.size, whole.body) == (False, None, 5)


async def test_a_number_left_out_of_a_reliable_subscription_is_a_gap() -> None:
    async with watched(reliable=True) as (gateway, subscription, asked, heard):
        for seq in (4, 5, 9):
            await gateway.send(update(asked, seq))
        gap = await heard.until("gap")
        assert (gap.id, gap.facts) == (subscription.id, {"lost": 3, "first": 6, "last": 8})


async def test_a_number_left_out_by_a_filter_is_none() -> None:
    async with watched(reliable=True, where={"field": "x", "gt": 1}) as (gateway, sub, asked, told):
        for seq in (4, 9):
            await gateway.send(update(asked, seq))
        updates = aiter(sub)
        assert [(await anext(updates)).seq for _ in range(2)] == [4, 9]
        assert told.codes == []


async def test_who_reads_too_slowly_gets_the_newest_and_the_count_of_the_rest() -> None:
    async with watched(buffer=2) as (gateway, subscription, asked, heard):
        for seq in range(1, 6):
            await gateway.send(update(asked, seq, dropped=1))
        await gateway.send({"type": "notice", "code": "done"})
        await heard.until("done")
        updates = aiter(subscription)
        read = [await anext(updates) for _ in range(2)]
        assert [item.seq for item in read] == [4, 5]
        assert sum(item.dropped for item in read) == 5 + 3


async def test_who_reads_a_reliable_subscription_too_slowly_is_told() -> None:
    async with watched(reliable=True, buffer=2) as (gateway, subscription, asked, _):
        for seq in range(1, 6):
            await gateway.send(update(asked, seq))
        await gateway.next("unsubscribe")
        updates = aiter(subscription)
        assert [(await anext(updates)).seq for _ in range(2)] == [1, 2]
        with pytest.raises(Overrun, match="unread"):
            await anext(updates)


async def test_a_subscription_that_the_gateway_ends_raises_why() -> None:
    async with watched() as (gateway, subscription, asked, _):
        error = {"code": "overrun", "message": "too far behind", "remedy": "Read faster."}
        await gateway.send({"type": "notice", "code": "overrun", "id": asked["id"], "error": error})
        with pytest.raises(Overrun, match="too far behind") as caught:
            await anext(aiter(subscription))
        assert caught.value.remedy == "Read faster."


async def test_notices_come_in_their_place_among_updates() -> None:
    async with watched() as (gateway, subscription, asked, _):
        await gateway.send(update(asked, 1))
        await gateway.send({"type": "notice", "code": "stale", "id": asked["id"], "age": 3})
        await gateway.send(update(asked, 2))
        events = subscription.events()
        first, told, second = [await anext(events) for _ in range(3)]
        assert (first.seq, second.seq) == (1, 2)
        assert (told.code, told.facts) == ("stale", {"age": 3})


async def test_leaving_a_bare_loop_ends_the_subscription() -> None:
    async with played() as (gateway, client):

        async def first() -> int:
            async for item in client.subscribe("/sensor/a"):
                return item.seq
            return 0

        reading = asyncio.create_task(first())
        asked = await gateway.next("subscribe")
        await gateway.send(reply(asked, {"paths": []}))
        await gateway.send(update(asked, 7))
        assert await reading == 7
        assert (await gateway.next("unsubscribe"))["body"] == {"subscription": asked["id"]}


# -- refusals ------------------------------------------------------------------------------------


async def test_an_error_keeps_all_that_the_gateway_said_of_it() -> None:
    async with played() as (gateway, client):
        pending = asyncio.create_task(client.read("/sensor/a"))
        facts = {"remedy": "Wait.", "retry_after": 2.5, "details": {"a": 1}, "trace_id": "t"}
        await gateway.send(refusal(await gateway.next("read"), "rate_limited", **facts))
        with pytest.raises(RateLimited, match="no: rate_limited") as caught:
            await pending
        error = caught.value
        assert (error.remedy, error.retry_after, error.trace_id) == ("Wait.", 2.5, "t")
        assert error.details == {"a": 1}


async def test_a_code_of_a_later_version_is_still_an_error() -> None:
    async with played() as (gateway, client):
        pending = asyncio.create_task(client.read("/sensor/a"))
        await gateway.send(refusal(await gateway.next("read"), "brand_new"))
        with pytest.raises(Refused) as caught:
            await pending
        assert caught.value.details == {"code": "brand_new"}


async def test_nonsense_is_passed_over() -> None:
    async with played() as (gateway, client):
        pending = asyncio.create_task(client.read("/sensor/a"))
        request = await gateway.next("read")
        for nonsense in ("", "{", "[]", '{"type": 1}', '{"type": "read", "id": "other"}'):
            await gateway.send(nonsense)
        await gateway.send(reply(request, 1))
        assert await pending == 1


async def test_a_callback_that_fails_does_no_harm(caplog: pytest.LogCaptureFixture) -> None:
    def fail(_: Any) -> None:
        raise ZeroDivisionError

    caplog.set_level("ERROR", "rcp.client")
    async with played(on_notice=fail) as (gateway, client):
        await gateway.send({"type": "notice", "code": "estop"})
        pending = asyncio.create_task(client.read("/sensor/a"))
        await gateway.send(reply(await gateway.next("read"), 1))
        assert await pending == 1
    assert "a callback of the client's user failed" in caplog.text


async def test_a_refused_hello_is_why_there_is_no_connection() -> None:
    async with asyncio.timeout(BOUND), peer() as gateway:
        gateway.greet = lambda hello: refusal(hello, "forbidden")
        with pytest.raises(Forbidden):
            async with connect(gateway.url, encoding="json"):
                pass


async def test_a_gateway_that_does_not_answer_hello_is_not_waited_for() -> None:
    async with asyncio.timeout(BOUND), peer() as gateway:
        gateway.greet = lambda _: None
        with pytest.raises(ConnectionLost, match="does not answer `hello`"):
            async with connect(gateway.url, encoding="json", connect_timeout=1.0):
                pass


async def test_a_proof_that_runs_out_ends_everything() -> None:
    async with played() as (gateway, client):
        pending = asyncio.create_task(client.read("/sensor/a"))
        await gateway.next("read")
        error = {"code": "token_expired", "message": "the proof is not good any more"}
        await gateway.send({"type": "hello", "status": "rejected", "error": error})
        with pytest.raises(TokenExpired):
            await pending
        with pytest.raises(TokenExpired):
            await client.ping()


async def test_a_session_that_belongs_to_somebody_else_is_left_for_a_new_one() -> None:
    heard = Heard()
    async with played(on_notice=heard) as (gateway, client):
        hellos: list[dict[str, Any]] = []

        def greet(hello: dict[str, Any]) -> dict[str, Any] | None:
            hellos.append(hello["body"])
            known = "session" in hello["body"]
            return refusal(hello, "unauthenticated") if known else gateway.welcome(hello)

        gateway.greet = greet
        await gateway.hang_up()
        pending = asyncio.create_task(client.read("/sensor/a"))
        status = await gateway.next("read")
        assert status["path"] == "/system/status"
        await gateway.send(refusal(status, "unknown_path"))
        await gateway.send(reply(await gateway.next("read"), 1))
        assert await pending == 1
        assert [body.get("resume_token") for body in hellos] == ["secret", None]


@pytest.mark.parametrize(
    ("status", "error"),
    [(401, Unauthenticated), (403, Forbidden), (404, ConnectionLost), (502, ConnectionLost)],
)
async def test_an_http_answer_instead_of_a_websocket_says_why(
    status: int, error: type[Exception]
) -> None:
    def refuse(connection: Any, _: Any) -> Any:
        return connection.respond(HTTPStatus(status), "no\n")

    async with serve(_nothing, "127.0.0.1", 0, process_request=refuse) as server:
        port = next(iter(server.sockets)).getsockname()[1]
        with pytest.raises(error, match=str(status)):
            async with connect(f"127.0.0.1:{port}"):
                pass


async def test_the_gateways_own_words_are_kept_when_it_refuses_the_connection() -> None:
    told = {"code": "unknown_path", "message": "there is nothing", "remedy": "Go elsewhere."}
    text = json.dumps({"type": "hello", "status": "rejected", "error": told})

    def refuse(connection: Any, _: Any) -> Any:
        return connection.respond(HTTPStatus.NOT_FOUND, text)

    async with serve(_nothing, "127.0.0.1", 0, process_request=refuse) as server:
        port = next(iter(server.sockets)).getsockname()[1]
        with pytest.raises(UnknownPath, match="there is nothing"):
            async with connect(f"127.0.0.1:{port}"):
                pass


async def test_a_server_of_another_protocol_is_no_gateway() -> None:
    async with serve(_nothing, "127.0.0.1", 0) as server:
        port = next(iter(server.sockets)).getsockname()[1]
        with pytest.raises(ConnectionLost, match=r"does not support rcp\.v1\.msgpack"):
            async with connect(f"127.0.0.1:{port}"):
                pass


async def _nothing(connection: Any) -> None:
    await connection.wait_closed()


async def test_nobody_there_is_said_in_one_line(unused_port: int) -> None:
    with pytest.raises(ConnectionLost, match=f"cannot reach http://127.0.0.1:{unused_port}: Conn"):
        async with connect(f"http://127.0.0.1:{unused_port}"):
            pass
