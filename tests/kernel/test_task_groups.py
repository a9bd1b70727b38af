"""Task groups that fail, in tasks that are cancelled, limited in time, or go on.

Before Python 3.13, those of asyncio confuse the cancellations.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

import pytest

from rcp_protocol.task_groups import TaskGroup
from rcp_protocol.timeouts import timeout

SHORT = 0.01  # s
BOUND = 30.0  # s: only guards against hanging


async def forever() -> None:
    await asyncio.Event().wait()


async def fail() -> None:
    raise LookupError


async def fail_when_cancelled() -> None:
    try:
        await forever()
    finally:
        raise LookupError


async def fail_while_waiting() -> None:
    async with TaskGroup() as group:
        group.create_task(fail())


async def fail_within() -> None:
    async with TaskGroup() as group:
        group.create_task(fail())
        await forever()


FAILING = pytest.mark.parametrize("failing", [fail_while_waiting, fail_within])


@FAILING
async def test_a_task_whose_group_fails_is_not_cancelled(
    failing: Callable[[], Awaitable[None]],
) -> None:
    with pytest.raises(ExceptionGroup):
        await failing()
    task = asyncio.current_task()
    assert task is not None
    assert not task.cancelling()
    await asyncio.sleep(0)


@FAILING
async def test_a_limit_expires_as_one_after_a_group_has_failed(
    failing: Callable[[], Awaitable[None]],
) -> None:
    async def limited() -> None:
        async with timeout(SHORT):
            try:
                await failing()
            except ExceptionGroup:
                await forever()

    with pytest.raises(TimeoutError):
        await limited()


@pytest.mark.parametrize("children", [[fail_when_cancelled], [fail, fail_when_cancelled]])
async def test_a_cancellation_outlasts_a_group_that_fails(
    children: list[Callable[[], Awaitable[None]]],
) -> None:
    started = asyncio.Event()

    async def starting(child: Callable[[], Awaitable[None]]) -> None:
        started.set()
        await child()

    async def body() -> None:
        try:
            async with TaskGroup() as group:
                for child in children:
                    group.create_task(starting(child))
        except ExceptionGroup:
            await asyncio.sleep(0)

    task = asyncio.create_task(body())
    await started.wait()
    task.cancel()
    await asyncio.wait([task], timeout=BOUND)
    assert task.cancelled()


async def test_an_earlier_cancellation_does_not_count_again() -> None:
    async def body() -> None:
        try:
            started.set()
            await forever()
        finally:
            async with TaskGroup() as group:
                done = group.create_task(asyncio.sleep(0, "stopped"))
            cleaned.append(await done)

    started, cleaned = asyncio.Event(), list[str]()
    task = asyncio.create_task(body())
    await started.wait()
    task.cancel()
    await asyncio.wait([task], timeout=BOUND)
    assert task.cancelled()
    assert cleaned == ["stopped"]
