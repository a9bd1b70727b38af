"""A lease is the block's as long as it runs: renewed, released, and cut short when it is lost."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

import pytest

import rcp_client
from plugins.client.gateway import ADMIN, OPERATOR, Gateway
from rcp_kernel.errors import LeaseHeld, LeaseLost

pytestmark = pytest.mark.anyio
BOUND = 60.0
SCOPE = "/tenant/alpha"
Connect = Callable[..., rcp_client.Client]


async def test_a_block_is_alone_in_command_and_leaves_the_scope_free(
    gateway: Gateway, connect: Connect
) -> None:
    async with connect(gateway) as mine, connect(gateway) as other:
        async with mine.lease(SCOPE, ttl=0.3, reason="mapping") as lease:
            await mine.write("/param/limit", 0.5)
            with pytest.raises(LeaseHeld):
                await other.write("/param/limit", 0.5)
            before = lease.facts["expires"]
            async with asyncio.timeout(BOUND):
                while lease.facts["expires"] == before:
                    await mine.ping()
            assert [one["reason"] for one in await other.leases()] == ["mapping"]
        assert await other.leases() == []
        await other.write("/param/limit", 0.5)


async def test_losing_it_cuts_the_block_short_with_the_reason(
    gateway: Gateway, connect: Connect
) -> None:
    async with connect(gateway) as mine, connect(gateway, token=ADMIN) as chief:
        began = asyncio.Event()

        async def work() -> None:
            async with mine.lease(SCOPE):
                began.set()
                await asyncio.Event().wait()

        task = asyncio.create_task(work())
        async with asyncio.timeout(BOUND):
            await began.wait()
            async with chief.lease(SCOPE, take=True, reason="a person in the cell"):
                with pytest.raises(LeaseLost, match="a person in the cell"):
                    await task
        assert not task.cancelled()


async def test_a_block_that_is_cancelled_by_somebody_else_stays_cancelled(
    gateway: Gateway, connect: Connect
) -> None:
    async with connect(gateway) as mine:

        async def work(began: asyncio.Event) -> None:
            async with mine.lease(SCOPE):
                began.set()
                await asyncio.Event().wait()

        began = asyncio.Event()
        task = asyncio.create_task(work(began))
        async with asyncio.timeout(BOUND):
            await began.wait()
            task.cancel()
            with pytest.raises(asyncio.CancelledError):
                await task
        assert await mine.leases() == []


async def test_what_is_handed_over_is_the_others(gateway: Gateway, connect: Connect) -> None:
    async with connect(gateway) as mine, connect(gateway, token=ADMIN) as chief:

        async def work() -> None:
            async with mine.lease(SCOPE) as lease:
                given = await lease.hand_over("admin")
                assert given["holder"] == "admin"
                await chief.write("/param/limit", 0.5)

        with pytest.raises(LeaseLost, match="handed over"):
            await work()
        with pytest.raises(LeaseHeld):
            await mine.write("/param/limit", 0.5)


async def test_a_lease_that_cannot_be_renewed_lapses_here_too(
    gateway: Gateway, connect: Connect
) -> None:
    async with connect(gateway, patience=0.2) as mine:

        async def work() -> None:
            async with mine.lease(SCOPE, ttl=0.5):
                await gateway.stop()
                await asyncio.Event().wait()

        async with asyncio.timeout(BOUND):
            with pytest.raises(LeaseLost):
                await work()


async def test_a_script_without_asyncio_is_told_at_the_end_of_its_block(gateway: Gateway) -> None:
    def lose(robot: rcp_client.Robot, chief: rcp_client.Robot) -> None:
        with robot.lease(SCOPE) as lease, chief.lease(SCOPE, take=True, reason="by hand"):
            while lease.lost is None:
                robot.ping()

    def script() -> None:
        with (
            rcp_client.Robot(gateway.url, token=ADMIN) as chief,
            rcp_client.Robot(gateway.url, token=OPERATOR) as robot,
        ):
            with robot.lease(SCOPE, ttl=5) as lease:
                robot.write("/param/limit", 0.5)
                lease.check()
                assert len(robot.leases()) == 1
            assert robot.leases() == []
            with pytest.raises(LeaseLost, match="by hand"):
                lose(robot, chief)

    async with asyncio.timeout(2 * BOUND):
        await asyncio.to_thread(script)
