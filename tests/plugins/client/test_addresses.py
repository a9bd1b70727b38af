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
    return refusal(hello, "gap") if "session" in hello["body"] else hub.welcome(hello)


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
