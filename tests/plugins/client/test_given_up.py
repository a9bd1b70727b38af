"""A command that its caller gave up while the link was lost: it ends, or never begins."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from typing import Any

import pytest

from plugins.client.gateway import BOUND, OPERATOR, Gateway
from plugins.client.heard import Heard
from plugins.client.proxy import Proxy
from rcp_client import Client, connect

pytestmark = pytest.mark.anyio


@asynccontextmanager
async def cut_off() -> AsyncGenerator[tuple[Gateway, Proxy, Client, Heard]]:
    """A gateway, and a client of it behind a proxy."""
    heard = Heard()
    async with (
        asyncio.timeout(BOUND),
        Gateway() as gateway,
        Proxy(gateway.port) as proxy,
        connect(proxy.url, token=OPERATOR, on_notice=heard) as client,
    ):
        yield gateway, proxy, client, heard


async def lose(proxy: Proxy, heard: Heard) -> None:
    proxy.refuse = True
    proxy.cut()
    await heard.until("disconnected")


async def given_up(task: asyncio.Task[Any]) -> None:
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task


async def test_who_stops_waiting_while_the_link_is_lost_has_the_command_cancelled() -> None:
    async with cut_off() as (gateway, proxy, client, heard):
        running = asyncio.create_task(client.execute("/action/go", {"x": 1.0}))
        await gateway.robot.started.get()
        await heard_of_it(client)
        await lose(proxy, heard)
        await given_up(running)
        proxy.refuse = False
        assert await gateway.robot.stopped.get() == "action/go"


async def heard_of_it(client: Client) -> None:
    """Wait until all that the gateway has said so far has arrived."""
    await client.read("/param/limit")


@pytest.mark.parametrize("method", ["execute", "start"])
async def test_what_is_given_up_before_there_is_a_link_is_never_sent(method: str) -> None:
    async with cut_off() as (gateway, proxy, client, heard):
        await lose(proxy, heard)
        waiting = asyncio.create_task(getattr(client, method)("/action/go", {"x": 1.0}))
        await asyncio.sleep(0)
        await given_up(waiting)
        proxy.refuse = False
        await heard.until("reconnected")
        await heard_of_it(client)
        assert gateway.robot.ran == []


async def test_what_was_lost_with_the_link_and_is_given_up_is_not_sent_again() -> None:
    async with cut_off() as (gateway, proxy, client, heard):
        proxy.mute = "up"  # the gateway does not hear of it
        sent = asyncio.create_task(client.execute("/action/go", {"x": 1.0}))
        await asyncio.sleep(0)
        await lose(proxy, heard)
        await given_up(sent)
        proxy.mute, proxy.refuse = None, False
        await heard.until("reconnected")
        await heard_of_it(client)
        assert gateway.robot.ran == []


async def test_a_subscription_that_ended_while_the_link_was_lost_ends_at_the_gateway() -> None:
    async with cut_off() as (_, proxy, client, heard):
        async with client.subscribe("/sensor/count"):
            await lose(proxy, heard)
        proxy.refuse = False
        await heard.until("reconnected")
        await heard_of_it(client)
        status = await client.read("/system/status")
        assert status["subscriptions"] == 0
