"""What is waited for in a task that is being cancelled is waited for no longer than it may take.

On Python 3.11.2 `asyncio.timeout` raises no TimeoutError there: what a robot had not confirmed was
taken for cancelled, and processes were left behind.
"""

from __future__ import annotations

import asyncio
import signal
import sys
from collections.abc import Awaitable, Callable
from types import SimpleNamespace
from typing import Any

import pytest

from rcp_can.sdo import Sdo
from rcp_kernel.errors import DeviceTimeout
from rcp_mavlink import twins
from rcp_mavlink.motion import Motion
from rcp_offers import Offer, Offers, Take
from rcp_vda5050.link import NotStoppedError, Running

pytestmark = pytest.mark.anyio


async def cancelled(work: Callable[[], Awaitable[Any]]) -> Any:
    """Cancel work once it waits; return what becomes of it."""
    task = asyncio.ensure_future(work())
    await asyncio.sleep(0)
    task.cancel()
    return await asyncio.wait_for(task, 60)


async def at_its_end(clean_up: Callable[[], Awaitable[Any]]) -> Any:
    """Have a cancelled task clean up; return what becomes of it."""

    async def work() -> Any:
        try:
            await asyncio.Event().wait()
        except asyncio.CancelledError:
            return await clean_up()

    return await cancelled(work)


async def test_a_call_whose_cancel_its_client_does_not_confirm_is_not_cancelled(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("rcp_offers.offered._CANCEL", 0.05)
    offers, told = Offers(most=1, most_of_one=1, waiting=1), list[str]()

    def tell(waiting: Any) -> None:
        told.extend(waiting.calls)

    with offers.offering(Offer(name="go", kind="action"), None, tell) as offered:
        task = asyncio.ensure_future(offered.call(None, lambda *_, **__: None))
        while not told:  # noqa: ASYNC110 - a few turns
            await asyncio.sleep(0)
        offers.take(Take(call=told[0]), None)
        task.cancel()
        with pytest.raises(DeviceTimeout, match="has not confirmed the cancel"):
            await asyncio.wait_for(task, 60)


async def test_an_order_whose_robot_does_not_confirm_the_cancel_is_not_cancelled(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("rcp_vda5050.link._PATIENCE", 0.05)
    link: Any = SimpleNamespace(connected=False)
    running = Running(link, None)
    running.cancelled = True  # the robot has been asked to
    with pytest.raises(NotStoppedError, match="has not ended within"):
        await cancelled(running.result)


async def test_a_vehicle_that_does_not_confirm_that_it_holds_is_not_said_to(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("rcp_mavlink.motion._HOLDING", 0.05)
    given: Any = SimpleNamespace(parting=set(), _parted=lambda _: None)
    with pytest.raises(DeviceTimeout, match="did not confirm that it holds"):
        await at_its_end(lambda: Motion.shielded(given, asyncio.Event().wait))
    for stop in given.parting:
        stop.cancel()


async def test_a_node_that_does_not_respond_at_the_end_is_told() -> None:
    bus: Any = SimpleNamespace(send=lambda *_, **__: None, up=True, name="can0", state="up")
    with pytest.raises(DeviceTimeout, match="did not respond"):
        await at_its_end(lambda: Sdo(bus, 5).upload(0x6041))


async def test_a_simulated_vehicle_that_does_not_exit_is_killed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(twins, "_PATIENCE", 0.05)
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-c", "import time; time.sleep(600)", stdin=asyncio.subprocess.PIPE
    )
    await at_its_end(lambda: twins._end(process))  # noqa: SLF001
    assert process.returncode == -signal.SIGKILL
