"""Several addresses: of one gateway, or of several that serve the same robots."""

from __future__ import annotations

import asyncio

import pytest

from plugins.client.gateway import BOUND, OPERATOR, Gateway, Point
from plugins.client.heard import Heard
from plugins.client.proxy import Proxy
from rcp_client import ConnectionLost, connect

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
