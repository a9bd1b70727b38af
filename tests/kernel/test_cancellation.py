"""A task that was cancelled ends, whatever is raised in place of the cancellation."""

from __future__ import annotations

import asyncio

import pytest

from rcp_protocol.cancellation import raise_if_cancelled
from rcp_protocol.timeouts import timeout

BOUND = 30.0  # s: only guards against hanging


async def test_a_task_group_that_fails_as_it_is_cancelled_does_not_keep_its_task_alive() -> None:
    failing, rounds = asyncio.Event(), 0

    async def fail() -> None:
        failing.set()
        raise LookupError

    async def body() -> None:
        nonlocal rounds
        while True:
            rounds += 1
            try:
                async with asyncio.TaskGroup() as group:
                    group.create_task(fail())
                    group.create_task(asyncio.Event().wait())
            except ExceptionGroup as error:
                raise_if_cancelled(error)
            await asyncio.sleep(0)

    task = asyncio.create_task(body())
    await failing.wait()
    task.cancel()
    await asyncio.wait([task], timeout=BOUND)
    assert task.cancelled()
    assert rounds == 1


async def test_what_fails_in_a_task_that_goes_on_is_only_an_error() -> None:
    raise_if_cancelled(LookupError())
    async with timeout(BOUND):  # its task has not been cancelled in any other way
        raise_if_cancelled()


async def test_a_limit_that_expired_within_is_no_cancellation() -> None:
    with pytest.raises(TimeoutError):
        async with timeout(0):
            await asyncio.Event().wait()
    raise_if_cancelled()
