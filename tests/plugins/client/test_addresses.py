"""Several addresses: of one gateway, or of several that serve the same robots."""

from __future__ import annotations

import asyncio
from contextlib import AsyncExitStack
from typing import Self

import pytest

from plugins.client.gateway import BOUND, OPERATOR, Gateway, Point
from plugins.client.heard import Heard
from plugins.client.peer import Message, Peer, peer, refusal, reply
from plugins.client.proxy import Proxy
from rcp_client import ConnectionLost, connect
from rcp_client.client import Client
from rcp_client.credentials import token_path
from rcp_protocol.errors import RcpError

pytestmark = pytest.mark.anyio
_NOBODY = "http://127.0.0.1:9"


async def test_the_first_that_answers_is_used() -> None:
    async with (
        asyncio.timeout(BOUND),
        Gateway() as gateway,
        connect(f"{_NOBODY}, {gateway.url}", token=OPERATOR) as client,
    ):
        assert client.channel.address.url == gateway.url
        assert await client.ping() > 0


async def test_nobody_answers() -> None:
    with pytest.raises(ConnectionLost, match="cannot reach"):
        await connect(f"{_NOBODY},{_NOBODY}", token=OPERATOR).channel.open()


async def test_no_address_may_show_the_token_to_the_network() -> None:
    with pytest.raises(ValueError, match="plain text"):
        connect(f"{_NOBODY},http://hub.example", token=OPERATOR)


async def test_a_token_stored_for_one_gateway_is_shown_to_no_other() -> None:
    file = token_path(_NOBODY)
    file.parent.mkdir(parents=True)
    file.touch(mode=0o600)
    file.write_text("of-this-machine")
    assert connect(_NOBODY).channel.settings.token == "of-this-machine"
    assert connect(f"{_NOBODY},http://127.0.0.1:10").channel.settings.token is None


async def test_a_session_is_resumed_at_another_address_of_the_same_gateway() -> None:
    heard = Heard()
    async with (
        asyncio.timeout(BOUND),
        Gateway() as gateway,
        Proxy(gateway.port) as proxy,
        connect(f"{proxy.url},{gateway.url}", token=OPERATOR, on_notice=heard) as client,
        client.subscribe("/sensor/count") as subscription,
    ):
        updates = aiter(subscription)
        gateway.robot.publish()
        assert (await anext(updates)).seq == 1
        running = asyncio.create_task(client.execute("/action/go", {"x": 1.0}))
        await gateway.robot.started.get()
        proxy.refuse = True
        proxy.cut()
        assert (await heard.until("reconnected")).facts == {"resumed": True}
        gateway.robot.publish()
        assert (await anext(updates)).seq == 2
        gateway.robot.release.set()
        assert await running == {"x": 1.0, "y": 0.0}
        assert gateway.robot.ran == [("action/go", Point(1.0))]


async def test_what_only_the_lost_gateway_knows_is_not_done_by_another() -> None:
    heard = Heard()
    async with (
        asyncio.timeout(BOUND),
        Gateway() as second,
        Gateway() as first,
        Proxy(first.port) as proxy,
        connect(f"{proxy.url},{second.url}", token=OPERATOR, on_notice=heard) as client,
    ):
        steps = [{"do": "execute", "path": "/action/go", "value": {"x": 1.0}}]
        plan = asyncio.create_task(client.plan(steps, idempotency_key="mine"))
        await first.robot.started.get()
        proxy.refuse = True
        proxy.cut()
        with pytest.raises(ConnectionLost, match="is unknown whether") as lost:
            await plan
        assert (lost.value.status, lost.value.retryable) == ("failed", False)
        assert (await heard.until("reconnected")).facts == {"resumed": False}
        assert second.robot.ran == []


async def test_a_command_is_not_run_again_by_another_gateway_with_robots_of_its_own() -> None:
    async with (
        asyncio.timeout(BOUND),
        Gateway() as second,
        Gateway() as first,
        Proxy(first.port) as proxy,
        connect(f"{proxy.url},{second.url}", token=OPERATOR) as client,
    ):
        running = asyncio.create_task(client.execute("/action/go", {"x": 1.0}))
        await first.robot.started.get()
        proxy.refuse = True
        proxy.cut()
        with pytest.raises(ConnectionLost, match="is unknown whether") as lost:
            await running
        assert (lost.value.status, lost.value.retryable) == ("failed", False)
        assert second.robot.ran == []


_GO = {"type": "execute", "path": "/action/go", "body": {"x": 1.0}}


class _Hubs:
    """A client of two hubs that has lost the first, played by the test."""

    def __init__(self, first: Peer, proxy: Proxy, second: Peer, client: Client) -> None:
        self.first, self.second, self.client = first, second, client
        self._proxy = proxy

    @classmethod
    async def opened(cls, stack: AsyncExitStack) -> Self:
        first, second = [await stack.enter_async_context(peer()) for _ in range(2)]
        proxy = await stack.enter_async_context(Proxy(first.port))
        second.greet = lambda hello: _unless_resumed(second, hello)
        urls = f"{proxy.url},{second.url}"
        client = connect(urls, token=OPERATOR, encoding="json", patience=BOUND)
        return cls(first, proxy, second, await stack.enter_async_context(client))

    def fail_over(self) -> None:
        self._proxy.refuse = True
        self._proxy.cut()

    async def tell_status(self) -> None:
        """Say that the second hub has run for long, and that all its robots have gateways."""
        asked = await self.second.next("read")
        assert asked["path"] == "/system/status"
        started = "2026-05-29T14:00:00.000000000Z"
        body = {"started": started, "uptime": 86_400.0, "backends": [{"gateways": 1}]}
        await self.second.send(reply(asked, body))


def _unless_resumed(hub: Peer, hello: Message) -> Message | None:
    if "session" in hello["body"]:
        return refusal(hello, "gap")
    welcome = hub.welcome(hello)
    assert welcome is not None
    welcome["body"]["session"] = "s-2"
    return welcome


async def test_of_a_batch_it_is_unknown_what_the_lost_hub_has_carried_out() -> None:
    async with asyncio.timeout(BOUND), AsyncExitStack() as stack:
        hubs = await _Hubs.opened(stack)
        sent = asyncio.create_task(
            hubs.client.channel.ask({"type": "batch", "body": [_GO]}, "keyed")
        )
        await hubs.first.next("batch")
        hubs.fail_over()
        await hubs.tell_status()
        asked = await hubs.second.next("read")
        assert asked["path"] == "/system/commands"
        await hubs.second.send(reply(asked, []))
        with pytest.raises(ConnectionLost, match="is unknown whether") as lost:
            await sent
        assert (lost.value.status, lost.value.retryable) == ("failed", False)


class _Pause:
    """A pause between two attempts that ends when the test says so."""

    over = asyncio.Event()

    def __init__(self, patience: float | None) -> None:
        type(self).over = asyncio.Event()

    async def again(self, error: RcpError) -> bool:
        await self.over.wait()
        return True


async def test_nothing_is_repeated_on_a_link_whose_hub_has_not_answered_yet(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("rcp_client.recovery.Tries", _Pause)
    async with asyncio.timeout(BOUND), AsyncExitStack() as stack:
        hubs = await _Hubs.opened(stack)
        sent = asyncio.create_task(hubs.client.execute("/action/go", {"x": 1.0}))
        await hubs.first.next("execute")
        hubs.fail_over()
        await hubs.tell_status()
        await hubs.second.send(
            refusal(await hubs.second.next("execute"), "adapter_unavailable", retryable=True)
        )
        hellos: asyncio.Queue[Message] = asyncio.Queue()
        hubs.second.greet = hellos.put_nowait
        await hubs.second.hang_up()
        hello = await hellos.get()
        _Pause.over.set()
        await asyncio.sleep(0)
        hubs.second.greet = lambda hello: _unless_resumed(hubs.second, hello)
        await hubs.second.send(refusal(hello, "gap"))
        await hubs.tell_status()  # before this, nothing else
        await hubs.second.send(reply(await hubs.second.next("execute"), {"x": 1.0}))
        assert await sent == {"x": 1.0}


async def _next_but_pings(hubs: _Hubs) -> str:
    """Return the type of what the client has sent before a ping, or `ping`."""
    ping = asyncio.create_task(hubs.client.ping())
    found = await hubs.second.inbox.get()
    if found["type"] == "ping":
        await hubs.second.send(reply(found))
        await ping
    ping.cancel()
    return found["type"]


@pytest.mark.parametrize("method", ["execute", "start", "write"])
async def test_what_is_given_up_while_it_waits_to_be_repeated_is_not_sent_again(
    monkeypatch: pytest.MonkeyPatch, method: str
) -> None:
    monkeypatch.setattr("rcp_client.recovery.Tries", _Pause)
    async with asyncio.timeout(BOUND), AsyncExitStack() as stack:
        hubs = await _Hubs.opened(stack)
        sent = asyncio.create_task(getattr(hubs.client, method)("/action/go", {"x": 1.0}))
        first = await hubs.first.inbox.get()
        hubs.fail_over()
        await hubs.tell_status()
        again = await hubs.second.next(first["type"])
        await hubs.second.send(refusal(again, "adapter_unavailable", retryable=True))
        assert await _next_but_pings(hubs) == "ping"  # it has heard of the refusal
        sent.cancel()
        with pytest.raises(asyncio.CancelledError):
            await sent
        _Pause.over.set()
        await asyncio.sleep(0)
        assert await _next_but_pings(hubs) == "ping"
        assert len(hubs.client.channel.calls) == 0


@pytest.mark.parametrize("accepted", [True, False])
async def test_what_is_given_up_while_its_repeat_is_under_way_is_cancelled(
    *, accepted: bool
) -> None:
    async with asyncio.timeout(BOUND), AsyncExitStack() as stack:
        hubs = await _Hubs.opened(stack)
        heard = asyncio.Event()
        running = hubs.client.execute("/action/go", {"x": 1.0}, on_feedback=lambda _: heard.set())
        sent = asyncio.create_task(running)
        asked = await hubs.first.next("execute")
        if accepted:
            going = {"status": "in_progress", "command": "c-1"}
            await hubs.first.send({"type": "execute", "id": asked["id"], **going})
            await heard.wait()
        hubs.fail_over()
        await hubs.tell_status()
        again = await hubs.second.next("execute")
        sent.cancel()
        with pytest.raises(asyncio.CancelledError):
            await sent
        begun = {"type": "execute", "id": again["id"], "status": "accepted", "command": "c-2"}
        await hubs.second.send(begun)
        cancel = await hubs.second.next("cancel")
        assert cancel["command"] == "c-2"
        await hubs.second.send(reply(cancel))
        await hubs.second.send({**begun, "status": "cancelled"})
        assert await _next_but_pings(hubs) == "ping"
        assert len(hubs.client.channel.calls) == 0


@pytest.mark.parametrize(("behind", "then"), [(1.8, "execute"), (60.0, "read")])
async def test_clocks_that_run_apart_within_ten_hours_are_no_restart(
    behind: float, then: str
) -> None:
    async with asyncio.timeout(BOUND), peer() as hub:
        hub.greet = lambda hello: _unless_resumed(hub, hello)
        async with connect(hub.url, token=OPERATOR, encoding="json") as client:
            known = 36_000.0  # s
            client.channel._recovery._met_at -= known  # noqa: SLF001 - it takes ten hours otherwise
            sent = asyncio.create_task(client.execute("/action/go", {"x": 1.0}))
            await hub.next("execute")
            await hub.hang_up()
            asked = await hub.next("read")
            started = "2026-05-29T14:00:00.000000000Z"
            body = {"started": started, "uptime": known - behind, "backends": []}
            await hub.send(reply(asked, body))
            await hub.next(then)
            sent.cancel()
