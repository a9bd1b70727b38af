"""A cable that is pulled, at every bad moment: nothing is lost unsaid, nothing happens twice."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

import pytest

from plugins.client.gateway import ADMIN, BOUND, Gateway, Point
from plugins.client.heard import Heard
from plugins.client.proxy import Proxy
from rcp_client import Client, ConnectionLost, Notice
from rcp_kernel.errors import DeadlineExceeded

pytestmark = pytest.mark.anyio
Connect = Callable[..., Client]


async def test_a_log_across_many_cuts_is_what_was_published(
    gateway: Gateway, proxy: Proxy, connect: Connect
) -> None:
    heard, log = Heard(), list[int]()
    gateway.robot.publish()
    async with (
        asyncio.timeout(60),
        connect(proxy, on_notice=heard) as client,
        client.subscribe("/sensor/count", reliable=True) as subscription,
    ):
        updates = aiter(subscription)

        async def take(until: int) -> None:
            while not log or log[-1] < until:
                log.append((await anext(updates)).body)

        for cut in range(1, 6):
            gateway.robot.publish(20)
            await take(gateway.robot.published - 10)  # the rest of them is under way at the cut
            proxy.cut()
            gateway.robot.publish(20)
            await heard.until("reconnected", cut)
        gateway.robot.publish(5)
        await take(gateway.robot.published)
    assert log == list(range(1, gateway.robot.published + 1))
    assert "gap" not in heard.codes
    assert all(n.facts["resumed"] for n in heard.notices if n.code == "reconnected")


async def test_two_subscriptions_of_one_path_each_go_on_without_a_seam(
    gateway: Gateway, proxy: Proxy, connect: Connect
) -> None:
    heard = Heard()
    gateway.robot.publish()
    async with (
        asyncio.timeout(BOUND),
        connect(proxy, on_notice=heard) as client,
        client.subscribe("/sensor/count", reliable=True) as ahead,
    ):
        first = aiter(ahead)
        seen = [(await anext(first)).seq]
        gateway.robot.publish(5)
        seen += [(await anext(first)).seq for _ in range(5)]
        async with client.subscribe("/sensor/count", reliable=True) as behind:
            second = aiter(behind)
            late = [(await anext(second)).seq]
            proxy.cut()
            gateway.robot.publish(3)
            await heard.until("reconnected")
            seen += [(await anext(first)).seq for _ in range(3)]
            late += [(await anext(second)).seq for _ in range(3)]
    assert seen == list(range(1, 10))
    assert late == [6, 7, 8, 9]


async def test_a_gap_says_which_samples_are_lost(
    gateway: Gateway, proxy: Proxy, connect: Connect
) -> None:
    heard = Heard()
    gateway.robot.publish()
    async with (
        asyncio.timeout(BOUND),
        connect(proxy, on_notice=heard) as client,
        client.subscribe("/sensor/count", reliable=True, qos={"depth": 5000}) as subscription,
    ):
        events = subscription.events()
        assert (await anext(events)).seq == 1  # pyright: ignore[reportAttributeAccessIssue]
        proxy.refuse = True
        proxy.cut()
        await heard.until("disconnected")
        gateway.robot.publish(1500)
        proxy.refuse = False
        gap = await heard.until("gap")
        log = [item async for item in _take(events, 1000)]
    assert gap.path == "/tenant/alpha/sensor/count"
    assert gap.facts["lost"] == 500
    assert [gap.facts["first"], gap.facts["last"]] == [2, 501]
    assert log == list(range(502, 1502))
    assert heard.codes.count("gap") == 1


async def _take(events: Any, count: int) -> Any:
    while count:
        item = await anext(events)
        if not isinstance(item, Notice):
            count -= 1
            yield item.seq


async def test_a_command_goes_on_while_its_client_is_away(
    gateway: Gateway, proxy: Proxy, connect: Connect
) -> None:
    heard = Heard()
    async with asyncio.timeout(BOUND), connect(proxy, on_notice=heard) as client:
        running = asyncio.create_task(client.execute("/action/go", {"x": 1.0}, type=Point))
        await gateway.robot.started.get()
        proxy.cut()
        await heard.until("reconnected")
        gateway.robot.release.set()
        assert await running == Point(1.0)
    assert gateway.robot.ran == [("action/go", Point(1.0))]


async def test_commands_that_were_accepted_are_not_sent_again_to_the_session_that_tells_of_them(
    connect: Connect,
) -> None:
    """A repeat may be refused, here for want of room, while the command itself runs on."""
    heard = Heard()
    async with (
        asyncio.timeout(BOUND),
        Gateway(in_flight=4) as gateway,
        Proxy(gateway.port) as proxy,
        connect(proxy, on_notice=heard) as client,
    ):
        running = [await client.start("/action/go", {"x": x}) for x in (0.0, 1.0, 2.0, 3.0)]
        for cut in (1, 2):
            proxy.cut()
            await heard.until("reconnected", cut)
            await client.ping()  # whatever was sent before is answered
        gateway.robot.release.set()
        assert [(await command.result())["x"] for command in running] == [0.0, 1.0, 2.0, 3.0]


async def test_a_result_that_came_while_away_is_heard_on_return(
    gateway: Gateway, proxy: Proxy, connect: Connect
) -> None:
    heard = Heard()
    async with asyncio.timeout(BOUND), connect(proxy, on_notice=heard) as client:
        handle = await client.start("/action/go", {"x": 2.0})
        proxy.refuse = True
        proxy.cut()
        await heard.until("disconnected")
        gateway.robot.release.set()
        proxy.refuse = False
        assert await handle.result() == {"x": 2.0, "y": 0.0}
        assert len(await client.commands()) == 1


@pytest.mark.parametrize("lost", ["up", "down"])
async def test_an_execute_without_an_answer_is_sent_again_and_run_once(
    gateway: Gateway, proxy: Proxy, connect: Connect, lost: Any
) -> None:
    """Whether the request or the answer to it was lost on the way."""
    async with asyncio.timeout(BOUND), connect(proxy) as client:
        gateway.robot.release.set()
        proxy.mute = lost
        running = asyncio.create_task(client.execute("/action/go", {"x": 3.0}))
        await proxy.swallowed.wait()
        proxy.cut()
        assert await running == {"x": 3.0, "y": 0.0}
    assert gateway.robot.ran == [("action/go", Point(3.0))]


@pytest.mark.parametrize("lost", ["up", "down"])
async def test_a_write_without_an_answer_is_sent_again_and_done_once(
    gateway: Gateway, proxy: Proxy, connect: Connect, lost: Any
) -> None:
    async with asyncio.timeout(BOUND), connect(proxy) as client:
        proxy.mute = lost
        writing = asyncio.create_task(client.write("/param/limit", 0.5))
        await proxy.swallowed.wait()
        proxy.cut()
        assert await writing == 0.5
    assert gateway.robot.writes == [("param/limit", 0.5)]


@pytest.mark.parametrize("lost", ["up", "down"])
async def test_a_subscribe_without_an_answer_begins_with_the_present_value(
    gateway: Gateway, proxy: Proxy, connect: Connect, lost: Any
) -> None:
    gateway.robot.publish(3)
    async with asyncio.timeout(BOUND), connect(proxy) as client:
        proxy.mute = lost
        subscription = client.subscribe("/sensor/count")
        first = asyncio.ensure_future(anext(aiter(subscription)))
        await proxy.swallowed.wait()
        proxy.cut()
        assert (await first).body == 3
        assert subscription.paths == ["/tenant/alpha/sensor/count"]


async def test_a_reset_of_the_estop_is_never_repeated(
    gateway: Gateway, proxy: Proxy, connect: Connect
) -> None:
    """It might undo a stop that somebody made meanwhile."""
    async with asyncio.timeout(BOUND), connect(proxy, token=ADMIN) as client:
        await client.estop()
        proxy.mute = "up"
        resetting = asyncio.create_task(client.estop(reset=True))
        await proxy.swallowed.wait()
        proxy.cut()
        with pytest.raises(ConnectionLost):
            await resetting
        assert (await client.read("/system/estop"))["active"]


async def test_requests_made_while_away_wait_for_the_return(
    gateway: Gateway, proxy: Proxy, connect: Connect
) -> None:
    heard = Heard()
    async with asyncio.timeout(BOUND), connect(proxy, on_notice=heard) as client:
        proxy.refuse = True
        proxy.cut()
        await heard.until("disconnected")
        reading = asyncio.create_task(client.read("/param/limit"))
        proxy.refuse = False
        assert await reading == 1.5


async def test_a_request_does_not_wait_beyond_its_deadline(
    gateway: Gateway, proxy: Proxy, connect: Connect, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rcp_client.channel.MARGIN", 0.1)
    async with asyncio.timeout(BOUND), connect(proxy) as client:
        proxy.mute = "up"
        with pytest.raises(DeadlineExceeded, match="did not answer"):
            await client.read("/param/limit", deadline=0.1)
        proxy.refuse = True
        proxy.cut()
        with pytest.raises(ConnectionLost, match="no connection"):
            await client.read("/param/limit", deadline=0.1)


def _asked(client: Client) -> list[asyncio.Task[Any]]:
    write = {"type": "write", "path": "/param/limit", "body": 1.0}
    return [
        asyncio.ensure_future(one)
        for one in (
            client.read("/param/limit"),
            client.write("/param/limit", 1.0),
            client.write("/param/limit", 1.0, idempotency_key="w"),
            client.write("/param/limit", 1.0, dry_run=True),
            client.write_all({"/param/limit": 1.0}),
            client.request(write),
            client.batch([write]),
            client.batch([{**write, "idempotency_key": "b"}, {"type": "ping"}]),
            client.execute("/action/go", {"x": 1.0}),
            client.execute("/action/go", {"x": 1.0}, idempotency_key="x"),
            client.execute("/action/go", {"x": 1.0}, dry_run=True),
            client.hold(),
            client.estop(),
            client.estop(reset=True),
        )
    ]


_SAFE = [True, False, True, True, *[False] * 3, True, False, *[True] * 4, False]


async def _errors(asked: list[asyncio.Task[Any]]) -> list[Any]:
    return await asyncio.gather(*asked, return_exceptions=True)


async def test_what_may_have_acted_may_be_repeated_only_with_a_key_of_the_caller(
    gateway: Gateway, proxy: Proxy, connect: Connect
) -> None:
    async with asyncio.timeout(BOUND):
        async with connect(proxy) as client:
            proxy.mute = "up"
            asked = _asked(client)
            await proxy.swallowed.wait()
        lost = await _errors(asked)
        assert all(isinstance(error, ConnectionLost) for error in lost)
        assert [error.retryable for error in lost] == _SAFE
        assert {error.status for error in lost if not error.retryable} == {"failed"}
        unsent = await _errors(_asked(client))
    assert all(isinstance(error, ConnectionLost) and error.retryable for error in unsent)


async def test_the_same_holds_for_an_answer_that_is_late(
    gateway: Gateway, proxy: Proxy, connect: Connect, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in ("channel", "client"):
        monkeypatch.setattr(f"rcp_client.{module}.MARGIN", 0.1)
    heard = Heard()
    async with asyncio.timeout(BOUND), connect(proxy, deadline=0.1, on_notice=heard) as client:
        proxy.mute = "up"
        late = await _errors(_asked(client))
        assert all(isinstance(error, DeadlineExceeded) for error in late)
        assert [error.retryable for error in late] == _SAFE
        proxy.refuse = True
        proxy.cut()
        await heard.until("disconnected")
        unsent = await _errors(_asked(client))
        assert all(isinstance(error, ConnectionLost) and error.retryable for error in unsent)


async def test_a_silent_connection_is_noticed_and_replaced(
    gateway: Gateway, proxy: Proxy, connect: Connect
) -> None:
    heard = Heard()
    async with asyncio.timeout(BOUND), connect(proxy, on_notice=heard, heartbeat=0.1) as client:
        proxy.mute = "down"
        await heard.until("disconnected")
        proxy.mute = None
        await heard.until("reconnected")
        assert await client.read("/param/limit") == 1.5


async def test_patience_ends(gateway: Gateway, proxy: Proxy, connect: Connect) -> None:
    gateway.robot.publish()
    async with asyncio.timeout(BOUND), connect(proxy, patience=0.3) as client:
        handle = await client.start("/action/go", {"x": 1.0})
        async with client.subscribe("/sensor/count") as subscription:
            updates = aiter(subscription)
            await anext(updates)
            proxy.refuse = True
            proxy.cut()
            with pytest.raises(ConnectionLost, match="unreachable"):
                await handle.result()
            with pytest.raises(ConnectionLost, match="unreachable"):
                await anext(updates)
        with pytest.raises(ConnectionLost):
            await client.ping()


async def test_a_duration_ends_also_while_away(
    gateway: Gateway, proxy: Proxy, connect: Connect
) -> None:
    gateway.robot.publish()
    async with asyncio.timeout(BOUND), connect(proxy) as client:
        log: list[int] = []
        async for update in client.subscribe("/sensor/count", duration=0.2):
            log.append(update.seq)
            proxy.refuse = True
            proxy.cut()
    assert log == [1]


async def test_a_count_is_reached_across_a_cut(
    gateway: Gateway, proxy: Proxy, connect: Connect
) -> None:
    heard = Heard()
    gateway.robot.publish()
    async with asyncio.timeout(BOUND), connect(proxy, on_notice=heard) as client:
        subscription = client.subscribe("/sensor/count", reliable=True, count=10)
        log: list[int] = []
        async with subscription:
            async for update in subscription:
                log.append(update.seq)
                if update.seq == 1:
                    gateway.robot.publish(4)
                if update.seq == 5:
                    proxy.cut()
                    gateway.robot.publish(10)
    assert log == list(range(1, 11))
