"""Every request of the contract, in every encoding, against a real gateway."""

from __future__ import annotations

import asyncio
import math
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from plugins.client.gateway import ADMIN, BOUND, OPERATOR, Gateway, Point
from rcp_client import Client, ConnectionLost, Feedback, connect, token_path
from rcp_kernel.errors import (
    Cancelled,
    DeadlineExceeded,
    EstopActive,
    Forbidden,
    OutOfRange,
    Unauthenticated,
    UnknownPath,
    UnsupportedOperation,
)
from rcp_kernel.types import Twist

pytestmark = pytest.mark.anyio
Connect = Callable[..., Client]
ENCODINGS = ["msgpack", "json", "cbor"]


@pytest.fixture(params=ENCODINGS)
def encoding(request: pytest.FixtureRequest) -> str:
    return request.param


async def test_reads_and_writes(gateway: Gateway, connect: Connect, encoding: str) -> None:
    async with asyncio.timeout(BOUND), connect(gateway, encoding=encoding) as client:
        assert await client.read("/param/limit") == 1.5
        assert await client.write("/param/limit", 0.5) == 0.5
        gateway.robot.say("sensor/point", Point(1.0, 2.0))
        assert await client.read("/tenant/alpha/sensor/point") == {"x": 1.0, "y": 2.0}
        assert await client.read("/sensor/point", fields=["y"]) == {"y": 2.0}
        assert await client.read("/sensor/point", type=Point) == Point(1.0, 2.0)
        sample = await client.sample("/sensor/point")
        assert (sample.seq, sample.state) == (1, "fresh")


async def test_several_paths_are_written_as_one(gateway: Gateway, connect: Connect) -> None:
    values = {"/param/limit": 0.5, "/tenant/alpha/param/label": "box"}
    async with connect(gateway) as client:
        assert {one.atomic for one in await client.discover("/param/*")} == {"params"}
        assert await client.write_all(values, idempotency_key="k") == values
        assert await client.write_all(values, idempotency_key="k") == values
        assert gateway.robot.together == [{"param/limit": 0.5, "param/label": "box"}]
        would = await client.write_all(values, dry_run=True)
        assert would["/param/limit"] == {"path": "/tenant/alpha/param/limit", "write": 0.5}
        with pytest.raises(OutOfRange) as refused:
            await client.write_all({"/param/limit": 9, "/param/label": 1})
        assert refused.value.details is not None
        faults = refused.value.details["faults"]
        assert [fault["code"] for fault in faults] == ["out_of_range", "invalid_value"]


async def test_values_that_json_cannot_write_go_both_ways(
    gateway: Gateway, connect: Connect, encoding: str
) -> None:
    async with asyncio.timeout(BOUND), connect(gateway, encoding=encoding) as client:
        data = bytes(range(256))
        assert await client.execute("/service/echo", data, type=bytes) == data
        with pytest.raises(Exception, match="finite"):
            await client.write("/param/limit", math.nan)


async def test_long_values_go_both_ways(gateway: Gateway, connect: Connect, encoding: str) -> None:
    async with asyncio.timeout(BOUND), connect(gateway, encoding=encoding) as client:
        data = os.urandom(1_500_000)
        assert await client.execute("/service/echo", data, type=bytes) == data
        gateway.robot.say("sensor/blob", data)
        assert await client.read("/sensor/blob", type=bytes) == data


async def test_reads_of_a_pattern_answer_for_each_path(gateway: Gateway, connect: Connect) -> None:
    async with asyncio.timeout(BOUND), connect(gateway) as client:
        found = await client.read("/param/*")
        assert {item["path"]: item["body"] for item in found} == {
            "/tenant/alpha/param/label": "crate",
            "/tenant/alpha/param/limit": 1.5,
        }


async def test_refusals_are_the_kernels_own_errors(gateway: Gateway, connect: Connect) -> None:
    async with asyncio.timeout(BOUND), connect(gateway) as client:
        with pytest.raises(OutOfRange, match=r"9 > 2\.5 m/s") as caught:
            await client.write("/param/limit", 9)
        assert caught.value.details == {
            "pointer": "",
            "value": 9,
            "bound": "<= 2.5",
            "unit": "m/s",
        }
        with pytest.raises(UnknownPath):
            await client.read("/sensor/nothing")
        with pytest.raises(UnsupportedOperation):
            await client.write("/sensor/count", 1)
        with pytest.raises(UnknownPath):
            await client.start("/action/nothing")


async def test_a_dry_run_changes_nothing(gateway: Gateway, connect: Connect) -> None:
    async with asyncio.timeout(BOUND), connect(gateway) as client:
        assert await client.write("/param/limit", 1.0, dry_run=True) == {"write": 1.0}
        assert await client.execute("/action/go", {"x": 1.0}, dry_run=True) is not None
        with pytest.raises(OutOfRange):
            await client.write("/param/limit", 9, dry_run=True)
        assert (gateway.robot.writes, gateway.robot.ran) == ([], [])


async def test_structs_are_sent_as_they_are(gateway: Gateway, connect: Connect) -> None:
    async with asyncio.timeout(BOUND), connect(gateway) as client:
        await client.write("/actuator/drive", Twist(), valid_for=1.0)
        assert gateway.robot.writes == [("actuator/drive", Twist())]


async def test_a_command_tells_of_its_course(
    gateway: Gateway, connect: Connect, encoding: str
) -> None:
    received: list[Feedback] = []
    async with asyncio.timeout(BOUND), connect(gateway, encoding=encoding) as client:
        handle = await client.start(
            "/action/go", {"x": 4.0}, on_feedback=received.append, type=Point
        )
        assert handle.id is not None
        await gateway.robot.started.get()
        gateway.robot.release.set()
        steps = [(item.status, item.body, item.progress) async for item in handle]
        assert steps == [("accepted", None, None), ("in_progress", 2.0, 0.5)]
        assert await handle.result() == Point(4.0)
        assert [item.status for item in received] == ["accepted", "in_progress"]
        assert (handle.status, handle.progress, handle.done) == ("completed", 0.5, True)
        assert (await handle.reply()).message is not None
        assert [command["command"] for command in await client.commands()] == [handle.id]


async def test_a_command_is_cancelled_by_its_handle_its_id_or_its_path(
    gateway: Gateway, connect: Connect
) -> None:
    async with asyncio.timeout(BOUND), connect(gateway) as client:
        for cancel in ("handle", "id", "path"):
            handle = await client.start("/action/go", {"x": 1.0})
            if cancel == "handle":
                await handle.cancel()
            else:
                named = handle.id if cancel == "id" else "/action/go"
                assert await client.cancel(named or "") == [handle.id]
            with pytest.raises(Cancelled):
                await handle.result()


async def test_who_stops_waiting_has_the_command_cancelled(
    gateway: Gateway, connect: Connect
) -> None:
    async with asyncio.timeout(BOUND), connect(gateway) as client:
        running = asyncio.create_task(client.execute("/action/go", {"x": 1.0}))
        await gateway.robot.started.get()
        running.cancel()
        with pytest.raises(asyncio.CancelledError):
            await running
        await gateway.robot.stopped.get()


async def test_who_stops_waiting_before_the_answer_has_it_cancelled_too(
    gateway: Gateway, connect: Connect
) -> None:
    async with asyncio.timeout(BOUND), connect(gateway) as client:
        running = asyncio.create_task(client.execute("/action/go", {"x": 1.0}))
        await asyncio.sleep(0)  # sent, and not yet answered
        running.cancel()
        with pytest.raises(asyncio.CancelledError):
            await running
        await gateway.robot.stopped.get()


async def test_a_command_keeps_to_its_deadline(gateway: Gateway, connect: Connect) -> None:
    async with asyncio.timeout(BOUND), connect(gateway) as client:
        with pytest.raises(DeadlineExceeded):
            await client.execute("/action/go", {"x": 1.0}, deadline=0.1)


async def test_a_key_that_was_used_gives_the_first_outcome(
    gateway: Gateway, connect: Connect
) -> None:
    async with asyncio.timeout(BOUND), connect(gateway) as client:
        gateway.robot.release.set()
        for _ in range(2):
            assert await client.execute("/action/go", {"x": 1.0}, idempotency_key="k") is not None
            await client.write("/param/limit", 1.0, idempotency_key="w")
        assert len(gateway.robot.ran) == 1
        assert len(gateway.robot.writes) == 1


async def test_an_estop_holds_until_somebody_resets_it(gateway: Gateway, connect: Connect) -> None:
    async with (
        asyncio.timeout(BOUND),
        connect(gateway) as client,
        connect(gateway, token=ADMIN) as admin,
    ):
        assert (await client.estop(scope="/tenant/alpha", reason="a person"))["active"]
        with pytest.raises(EstopActive):
            await client.execute("/action/go", {"x": 1.0})
        with pytest.raises(Forbidden):
            await client.estop(reset=True)
        assert not (await admin.estop(reset=True))["active"]


async def test_discovery_is_read_to_its_end(
    gateway: Gateway, connect: Connect, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rcp_client.client._PAGE", 2)
    async with asyncio.timeout(BOUND), connect(gateway) as client:
        found = await client.discover()
        assert len(found) == 10  # the gateway's own service/hold among them
        assert {item.path.split("/")[2] for item in found} == {"alpha"}
        assert [item.path for item in await client.discover("/**", kind="param", q="limit")] == [
            "/tenant/alpha/param/limit",
            "/tenant/beta/param/limit",
        ]
        (limit,) = await client.discover("/param/limit", op="write", schemas=False)
        assert (limit.unit, limit.examples, limit.schemas) == ("m/s", [1.0], {})


async def test_a_batch_answers_each_part(gateway: Gateway, connect: Connect) -> None:
    async with asyncio.timeout(BOUND), connect(gateway) as client:
        replies = await client.batch(
            [
                {"type": "read", "path": "/param/limit"},
                {"type": "write", "path": "/param/limit", "body": 9},
            ]
        )
        assert [reply.status for reply in replies] == ["completed", "rejected"]
        assert replies[0].body == 1.5


async def test_any_envelope_can_be_sent(gateway: Gateway, connect: Connect) -> None:
    async with asyncio.timeout(BOUND), connect(gateway) as client:
        reply = await client.request({"type": "read", "path": "/param/limit", "x-note": "hello"})
        assert (reply.path, reply.body) == ("/tenant/alpha/param/limit", 1.5)
        assert 0 < await client.ping() < 1
        assert (await client.status())["state"] == "ok"


async def test_relative_paths_mean_the_chosen_tenant(gateway: Gateway, connect: Connect) -> None:
    async with asyncio.timeout(BOUND), connect(gateway, tenant="beta") as client:
        assert client.greeting["tenant"] == "beta"
        await client.write("/param/limit", 0.25)
        assert gateway.robots["beta"].writes == [("param/limit", 0.25)]
    with pytest.raises(Forbidden):
        async with connect(gateway, tenant="gamma"):
            pass


async def test_a_bad_token_is_refused(gateway: Gateway, connect: Connect) -> None:
    with pytest.raises(Unauthenticated):
        async with connect(gateway, token="a-token-of-nobody"):
            pass


async def test_without_a_token_one_may_look_and_not_move(
    gateway: Gateway, connect: Connect
) -> None:
    async with asyncio.timeout(BOUND), connect(gateway, token=None) as client:
        assert await client.read("/param/limit") == 1.5
        with pytest.raises(Forbidden):
            await client.write("/param/limit", 1.0)


async def test_the_environment_says_where_and_who(
    gateway: Gateway, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("RCP_URL", gateway.url)
    monkeypatch.setenv("RCP_TOKEN", OPERATOR)
    monkeypatch.setenv("RCP_TENANT", "beta")
    async with asyncio.timeout(BOUND), connect() as client:
        assert client.greeting["principal"] == "operator"
        assert client.greeting["tenant"] == "beta"


@pytest.mark.parametrize(("mode", "principal"), [(0o600, "operator"), (0o644, "anonymous")])
async def test_a_token_left_for_this_user_alone_is_found(
    gateway: Gateway, mode: int, principal: str
) -> None:
    _leave(token_path(gateway.url), mode)
    async with asyncio.timeout(BOUND), connect(gateway.url) as client:
        assert client.greeting["principal"] == principal


def _leave(path: Path, mode: int) -> None:
    path.parent.mkdir(parents=True)
    path.write_text(OPERATOR + "\n")
    path.chmod(mode)


async def test_updates_come_in_the_type_asked_for(
    gateway: Gateway, connect: Connect, encoding: str
) -> None:
    gateway.robot.say("sensor/point", Point(1.0))
    async with asyncio.timeout(BOUND), connect(gateway, encoding=encoding) as client:
        async for update in client.subscribe("/sensor/point", type=Point, count=1):
            assert update.body == Point(1.0)
            assert update.path == "/tenant/alpha/sensor/point"


async def test_a_subscription_to_patterns_hears_them_all(
    gateway: Gateway, connect: Connect
) -> None:
    async with (
        asyncio.timeout(BOUND),
        connect(gateway) as client,
        client.subscribe(["/event/**", "/tenant/beta/event/*"], initial=False) as subscription,
    ):
        assert subscription.paths == ["/tenant/alpha/event/alarm", "/tenant/beta/event/alarm"]
        gateway.robots["beta"].say("event/alarm", "smoke")
        update = await anext(aiter(subscription))
        assert (update.path, update.body) == ("/tenant/beta/event/alarm", "smoke")


async def test_what_cannot_be_subscribed_to_raises_at_once(
    gateway: Gateway, connect: Connect
) -> None:
    async with asyncio.timeout(BOUND), connect(gateway) as client:
        with pytest.raises(UnknownPath):
            await anext(aiter(client.subscribe("/sensor/nothing")))
        with pytest.raises(ValueError, match="at least one"):
            client.subscribe([])
        assert client.channel.subscriptions == {}


async def test_a_closed_client_says_so(gateway: Gateway, connect: Connect) -> None:
    async with asyncio.timeout(BOUND), connect(gateway) as client:
        handle = await client.start("/action/go", {"x": 1.0})
    with pytest.raises(ConnectionLost, match="closed"):
        await client.ping()
    with pytest.raises(ConnectionLost, match="closed"):
        await handle.result()
    gateway.robot.release.set()


@pytest.mark.parametrize("text", ["ftp://here", "http://", "http://here:port", ""])
def test_what_is_no_address_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"address|[Pp]ort"):
        connect(text or "http:///")


def test_an_address_may_be_short_or_lie_behind_a_proxy() -> None:
    from rcp_client.address import Address

    short = Address.parse("robot.local:8080")
    assert (short.url, short.ws) == (
        "http://robot.local:8080",
        "ws://robot.local:8080/rcp/v1/ws",
    )
    deep: Any = Address.parse("wss://example.org/robots/rcp/v1/ws")
    assert (deep.url, deep.port) == ("https://example.org/robots", 443)
    assert deep.ws == "wss://example.org/robots/rcp/v1/ws"


def test_both_names_of_this_machine_have_one_token(tmp_path: Path) -> None:
    assert token_path("http://localhost:8080") == token_path("127.0.0.1:8080")
    assert token_path("127.0.0.1:8080") == tmp_path / "run" / "rcp" / "127.0.0.1_8080.token"
