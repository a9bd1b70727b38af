"""What the ROS thread hands to the event loop, and to whom."""

from __future__ import annotations

import asyncio
import gc
from types import SimpleNamespace
from typing import Any, cast

import pytest

from rcp_kernel.spi import Host
from rcp_ros2.ros import Ticket

pytestmark = pytest.mark.anyio


async def test_an_error_for_a_waiter_that_was_cancelled_is_not_reported_as_a_bug() -> None:
    loop = asyncio.get_running_loop()
    reported: list[dict[str, Any]] = []
    loop.set_exception_handler(lambda _loop, context: reported.append(context))
    ticket = Ticket(cast("Host", SimpleNamespace(call_soon=loop.call_soon_threadsafe)))
    waiting = asyncio.create_task(ticket.wait(60.0))
    await asyncio.sleep(0)
    waiting.cancel()
    await asyncio.wait([waiting])
    ticket.fail(RuntimeError("stopped meanwhile"))
    await asyncio.sleep(0)
    assert ticket.done
    del ticket, waiting
    gc.collect()
    assert reported == []


async def test_an_error_is_raised_for_whoever_still_waits() -> None:
    loop = asyncio.get_running_loop()
    ticket = Ticket(cast("Host", SimpleNamespace(call_soon=loop.call_soon_threadsafe)))
    ticket.fail(RuntimeError("as it is"))
    assert await ticket.wait(60.0)
    with pytest.raises(RuntimeError, match="as it is"):
        ticket.result()


async def test_what_comes_for_a_waiter_that_gave_up_is_dropped() -> None:
    loop = asyncio.get_running_loop()
    ticket = Ticket(cast("Host", SimpleNamespace(call_soon=loop.call_soon_threadsafe)))
    waiting = asyncio.create_task(ticket.answer())
    await asyncio.sleep(0)
    waiting.cancel()
    await asyncio.wait([waiting])
    ticket.give("too late")
    await asyncio.sleep(0)
    assert waiting.cancelled()
    assert ticket.done


async def test_a_refusal_ends_the_wait_for_an_answer() -> None:
    ticket = Ticket(cast("Host", SimpleNamespace()))
    waiting = asyncio.create_task(ticket.answer())
    await asyncio.sleep(0)
    ticket.refuse(TimeoutError("nobody answers"))
    with pytest.raises(TimeoutError, match="nobody answers"):
        await waiting
