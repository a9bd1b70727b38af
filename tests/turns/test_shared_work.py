"""What several ask for at once is done once, and given to all of them."""

from __future__ import annotations

import asyncio

import pytest

from rcp_scheduling.shared_work import SharedWork

pytestmark = pytest.mark.anyio


class Work:
    """Counts how often it was begun, and ends when it is told to."""

    def __init__(self) -> None:
        self.begun = 0
        self.go_on = asyncio.Event()

    async def begin(self) -> int:
        self.begun += 1
        await self.go_on.wait()
        if self.begun == 1:
            return self.begun
        raise ZeroDivisionError


async def test_who_asks_meanwhile_shares_it_and_who_asks_later_has_it_done_anew() -> None:
    shared, work = SharedWork[int](asyncio.get_running_loop()), Work()
    asking = [asyncio.create_task(shared.result("key", work.begin)) for _ in range(3)]
    await asyncio.sleep(0)
    asking[0].cancel()  # whoever gives up takes it from nobody
    work.go_on.set()
    first = await asyncio.gather(*asking, return_exceptions=True)
    assert isinstance(first[0], asyncio.CancelledError)
    assert (first[1:], work.begun) == ([1, 1], 1)
    asking = [asyncio.create_task(shared.result("key", work.begin)) for _ in range(2)]
    second = await asyncio.gather(*asking, return_exceptions=True)
    assert [type(error) for error in second] == [ZeroDivisionError] * 2
    assert work.begun == 2


async def test_what_differs_is_not_shared() -> None:
    shared, work = SharedWork[int](asyncio.get_running_loop()), Work()
    asking = [asyncio.create_task(shared.result(key, work.begin)) for key in ("a", "b")]
    await asyncio.sleep(0)
    work.go_on.set()
    await asyncio.gather(*asking, return_exceptions=True)
    assert work.begun == 2
