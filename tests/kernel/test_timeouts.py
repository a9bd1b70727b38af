"""Time limits in tasks that are cancelled (Python 3.11.2 of Debian 12 has another `asyncio.timeout`)."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

import pytest

from rcp_protocol.timeouts import timeout, timeout_at

SHORT = 0.01  # s
BOUND = 30.0  # s: only guards against hanging


async def forever() -> None:
    await asyncio.Event().wait()


async def cancelled_within(clean_up: Callable[[], Awaitable[object]]) -> object:
    """Return what a clean-up gives, or raises, in a task that was cancelled."""
    result: object = None

    async def body() -> None:
        nonlocal result
        try:
            begun.set()
            await forever()
        finally:
            try:
                result = await clean_up()
            except BaseException as error:
                result = error

    begun = asyncio.Event()
    task = asyncio.create_task(body())
    await begun.wait()
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await asyncio.wait_for(task, BOUND)
    return result


async def test_a_limit_in_the_clean_up_of_a_cancelled_task_is_a_timeout() -> None:
    async def clean_up() -> None:
        async with timeout(SHORT):
            await forever()

    assert isinstance(await cancelled_within(clean_up), TimeoutError)


async def test_a_second_limit_follows_the_first() -> None:
    async def clean_up() -> list[str]:
        kept: list[str] = []
        for name in ("stop", "stop again"):
            try:
                async with timeout_at(asyncio.get_running_loop().time() + SHORT):
                    await forever()
            except TimeoutError:
                kept.append(name)
        return kept

    assert await cancelled_within(clean_up) == ["stop", "stop again"]


async def test_what_ends_in_time_leaves_no_limit_behind() -> None:
    async def clean_up() -> str:
        async with timeout(SHORT):
            await asyncio.sleep(0)
        async with timeout(None):
            await asyncio.sleep(2 * SHORT)  # the limit, if it were still there
        return "ended"

    assert await cancelled_within(clean_up) == "ended"


async def test_a_limit_in_the_past_expires_at_the_first_wait() -> None:
    with pytest.raises(TimeoutError):
        async with timeout_at(0.0):
            await forever()


async def test_a_cancellation_within_a_limit_stays_one() -> None:
    async def body() -> None:
        async with timeout(BOUND):
            begun.set()
            await forever()

    begun = asyncio.Event()
    task = asyncio.create_task(body())
    await begun.wait()
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await asyncio.wait_for(task, BOUND)


async def test_a_cancellation_at_the_moment_of_expiry_stays_one() -> None:
    async def body() -> None:
        async with timeout(None) as limit:
            limit.reschedule(asyncio.get_running_loop().time())
            asyncio.get_running_loop().call_soon(task.cancel)
            await forever()

    task = asyncio.create_task(body())
    with pytest.raises(asyncio.CancelledError):
        await asyncio.wait_for(task, BOUND)


async def test_a_limit_says_that_it_has_expired() -> None:
    limit = timeout(SHORT)
    with pytest.raises(TimeoutError):
        async with limit:
            await forever()
    assert limit.expired()


async def test_a_limit_says_that_another_one_of_its_block_has_expired() -> None:
    limit = timeout(BOUND)
    with pytest.raises(TimeoutError):
        async with limit:
            raise TimeoutError
    assert not limit.expired()


async def test_an_error_of_the_body_stays_what_it_is() -> None:
    with pytest.raises(LookupError):
        async with timeout(BOUND):
            raise LookupError
