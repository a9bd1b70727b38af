"""A robot that comes up later than its gateway: a subscription waits for it, at first and after a restart."""

from __future__ import annotations

import asyncio

import pytest

from plugins.client.gateway import BOUND, OPERATOR, Gateway
from plugins.client.heard import Heard
from rcp_client import Client, connect
from rcp_kernel.errors import AdapterUnavailable, UnknownPath

pytestmark = pytest.mark.anyio

COUNT = "/sensor/count"


async def test_a_first_subscription_waits_for_its_robot_and_says_so() -> None:
    heard = Heard()
    gateway = Gateway()
    gateway.opens.clear()
    async with (
        asyncio.timeout(BOUND),
        gateway,
        connect(gateway.url, token=OPERATOR, on_notice=heard) as client,
    ):
        begun = asyncio.create_task(_first(client))
        assert "not connected" in ((await heard.until("waiting")).message or "")
        gateway.opens.set()
        while "alpha" not in gateway.robots:  # noqa: ASYNC110 - nothing tells of it
            await asyncio.sleep(0.01)
        gateway.robot.publish()
        assert await begun == 1
    assert len([n for n in heard.notices if n.code == "waiting"]) == 1


async def test_it_ends_when_the_path_turns_out_to_be_none() -> None:
    heard = Heard()
    gateway = Gateway()
    gateway.opens.clear()
    async with (
        asyncio.timeout(BOUND),
        gateway,
        connect(gateway.url, token=OPERATOR, on_notice=heard) as client,
    ):
        begun = asyncio.create_task(_first(client, "/sensor/nothing"))
        await heard.until("waiting")
        gateway.opens.set()
        with pytest.raises(UnknownPath):
            await begun


async def test_it_ends_with_the_clients_patience() -> None:
    gateway = Gateway()
    gateway.opens.clear()
    async with (
        asyncio.timeout(BOUND),
        gateway,
        connect(gateway.url, token=OPERATOR, patience=0.5) as client,
    ):
        with pytest.raises(AdapterUnavailable, match="not connected"):
            await _first(client)
        gateway.opens.set()


async def test_after_a_restart_it_waits_until_the_robot_is_back() -> None:
    heard = Heard()
    async with asyncio.timeout(2 * BOUND), Gateway() as gateway:
        gateway.robot.publish()
        async with (
            connect(gateway.url, token=OPERATOR, on_notice=heard) as client,
            client.subscribe(COUNT) as subscription,
        ):
            updates = aiter(subscription)
            await anext(updates)
            for _ in range(2):
                heard.notices.clear()
                gateway.opens.clear()
                gateway.robots.clear()
                await gateway.stop()
                await gateway.start()
                await heard.until("waiting")
                gateway.opens.set()
                await heard.until("gap")
                gateway.robot.publish()
                assert (await anext(updates)).seq == 1


async def _first(client: Client, path: str = COUNT) -> int:
    async with client.subscribe(path) as subscription:
        async for update in subscription:
            return update.seq
    raise AssertionError("it ended")
