"""Samples reach the event loop in batches, in their order, and one that fails stops no others."""

from __future__ import annotations

import asyncio
import threading
from functools import partial
from typing import TYPE_CHECKING

import pytest

pytest.importorskip("zenoh")

from rcp_zenoh.inbox import received
from rcp_zenoh.session import configuration, opened

if TYPE_CHECKING:
    import zenoh

pytestmark = pytest.mark.anyio
_BOUND = 60.0  # s, on any machine
_COUNT = 20_000  # more than wait in the channel


async def test_what_arrives_while_the_loop_is_busy_is_handled_in_its_order() -> None:
    seen: list[int] = []
    turns: list[int] = []
    done = asyncio.Event()
    loop = asyncio.get_running_loop()

    def handle(sample: zenoh.Sample) -> None:
        number = int(sample.payload.to_string())
        seen.append(number)
        if number == 1:
            loop.call_soon(lambda: turns.append(len(seen)))
        if number == _COUNT - 1:
            done.set()
        if number == 500:
            raise ValueError("this one is odd")

    async with opened(configuration("router"), patient=False) as session:
        subscribe = partial(session.declare_subscriber, "a/*")
        async with received(subscribe, handle), asyncio.timeout(_BOUND):
            put = threading.Thread(
                target=lambda: [session.put("a/b", str(i)) for i in range(_COUNT)]
            )
            put.start()
            put.join(0.1)  # the loop is busy meanwhile
            await done.wait()
    put.join()
    assert seen == list(range(_COUNT))
    assert turns[0] < _COUNT, "nothing else had a turn"
    assert not [one for one in threading.enumerate() if one.name == "zenoh inbox"]
