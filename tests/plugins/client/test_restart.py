"""A session that has expired, and a gateway that was started anew: begin again, repeat nothing."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from plugins.client.gateway import BOUND, OPERATOR, Gateway, Point
from plugins.client.heard import Heard
from plugins.client.proxy import Proxy
from rcp_client import ConnectionLost, connect
from rcp_kernel.clock import now
from rcp_kernel.sessions.session import Session

pytestmark = pytest.mark.anyio


async def test_an_expired_session_is_begun_afresh_and_the_gap_told_of() -> None:
    heard = Heard()
    async with (
        asyncio.timeout(BOUND),
        Gateway(session_ttl=0.05) as gateway,
        Proxy(gateway.port) as proxy,
        connect(proxy.url, token=OPERATOR, on_notice=heard) as client,
    ):
        gateway.robot.publish(5)
        async with client.subscribe("/sensor/count") as subscription:
            updates = aiter(subscription)
            assert (await anext(updates)).seq == 5
            gone = _sessions_that_end(gateway)
            proxy.refuse = True
            proxy.cut()
            await gone.wait()
            gateway.robot.publish(5)
            proxy.refuse = False
            assert (await heard.until("gap")).id == subscription.id
            assert (await anext(updates)).seq == 10
            gateway.robot.publish()
            assert (await anext(updates)).seq == 11
    assert [n.facts for n in heard.notices if n.code == "reconnected"] == [{"resumed": False}]


async def test_a_command_is_found_again_from_a_new_session() -> None:
    heard = Heard()
    async with (
        asyncio.timeout(BOUND),
        Gateway(session_ttl=0.05) as gateway,
        Proxy(gateway.port) as proxy,
        connect(proxy.url, token=OPERATOR, on_notice=heard) as client,
    ):
        running = asyncio.create_task(client.execute("/action/go", {"x": 1.0}))
        await gateway.robot.started.get()
        gone = _sessions_that_end(gateway)
        proxy.refuse = True
        proxy.cut()
        await gone.wait()
        proxy.refuse = False
        await heard.until("reconnected")
        gateway.robot.release.set()
        assert await running == {"x": 1.0, "y": 0.0}
        assert gateway.robot.ran == [("action/go", Point(1.0))]


def _sessions_that_end(gateway: Gateway) -> asyncio.Event:
    """Return what is set when the gateway lets a session go."""
    assert gateway.server is not None
    sessions, gone = gateway.server.gateway.sessions, asyncio.Event()
    drop = sessions.drop

    def dropped(session: Session) -> None:
        drop(session)
        gone.set()

    sessions.drop = dropped
    return gone


async def test_a_subscription_goes_on_after_a_restart_once_its_robot_is_back() -> None:
    heard = Heard()
    async with asyncio.timeout(BOUND), Gateway() as gateway:
        gateway.robot.publish(5)
        async with (
            connect(gateway.url, token=OPERATOR, on_notice=heard) as client,
            client.subscribe("/sensor/count") as subscription,
        ):
            updates = aiter(subscription)
            assert (await anext(updates)).seq == 5
            await gateway.stop()
            await heard.until("disconnected")
            await gateway.start()
            await heard.until("gap")
            gateway.robot.publish()  # the numbers begin again
            assert (await anext(updates)).seq == 1


async def test_a_command_of_an_earlier_life_is_never_run_again() -> None:
    heard = Heard()
    async with (
        asyncio.timeout(BOUND),
        Gateway() as gateway,
        Proxy(gateway.port) as proxy,
        connect(proxy.url, token=OPERATOR, on_notice=heard) as client,
    ):
        running = [
            asyncio.create_task(client.execute("/action/go", {"x": 1.0}, idempotency_key=key))
            for key in (None, "mine")
        ]
        for _ in running:
            await gateway.robot.started.get()
        proxy.mute = "down"  # whatever the gateway says of its end
        await gateway.stop()
        await heard.until("disconnected")
        proxy.mute = None
        await gateway.start()
        for one in running:
            with pytest.raises(ConnectionLost, match="is unknown whether") as lost:
                await one
            # This gateway knows no key of its earlier life: a repeat would run it again.
            assert (lost.value.status, lost.value.retryable) == ("failed", False)
        assert gateway.robot.ran == []


async def test_what_a_restarted_gateway_remembers_of_a_command_is_its_outcome(
    tmp_path: Path,
) -> None:
    heard = Heard()
    more = f'[store]\npath = "{tmp_path / "store.db"}"'
    async with (
        asyncio.timeout(BOUND),
        Gateway(more=more) as gateway,
        Proxy(gateway.port) as proxy,
        connect(proxy.url, token=OPERATOR, on_notice=heard) as client,
    ):
        running = asyncio.create_task(client.execute("/action/go", {"x": 1.0}))
        await gateway.robot.started.get()
        proxy.mute = "down"
        gateway.robot.release.set()
        await proxy.swallowed.wait()
        await gateway.stop()
        await heard.until("disconnected")
        proxy.mute = None
        await gateway.start()
        assert await running == {"x": 1.0, "y": 0.0}
        assert gateway.robot.ran == []


async def test_a_session_outlives_its_gateway_and_its_subscription_goes_on(
    tmp_path: Path,
) -> None:
    heard = Heard()
    more = f'[store]\npath = "{tmp_path / "store.db"}"'
    async with asyncio.timeout(BOUND), Gateway(more=more) as gateway:
        gateway.robot.publish(5)
        async with (
            connect(gateway.url, token=OPERATOR, on_notice=heard) as client,
            client.subscribe("/sensor/count") as subscription,
        ):
            updates = aiter(subscription)
            assert (await anext(updates)).seq == 5
            await gateway.stop()
            await heard.until("disconnected")
            await gateway.start()
            assert (await heard.until("reconnected")).facts == {"resumed": True}
            gateway.robot.publish()  # the numbers begin again
            while (await anext(updates)).seq != 1:
                pass
            assert subscription.duplicates == 0


async def test_nor_after_a_restart_at_which_the_gateways_clock_was_set_back(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As a computer without a battery does, whose power was cut."""
    heard = Heard()
    async with (
        asyncio.timeout(BOUND),
        Gateway() as gateway,
        Proxy(gateway.port) as proxy,
        connect(proxy.url, token=OPERATOR, on_notice=heard) as client,
    ):
        running = asyncio.create_task(client.execute("/action/go", {"x": 1.0}))
        await gateway.robot.started.get()
        proxy.mute = "down"
        await gateway.stop()
        await heard.until("disconnected")
        proxy.mute = None
        monkeypatch.setattr("rcp_gateway.status.now", lambda: now() - 3_600 * 10**9)
        await gateway.start()
        with pytest.raises(ConnectionLost, match="is unknown whether"):
            await running
        assert gateway.robot.ran == []
