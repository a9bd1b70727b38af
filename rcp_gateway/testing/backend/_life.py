"""A backend's life: it opens, closes, leaves nothing behind, and can be opened again."""

from __future__ import annotations

import asyncio
import gc
import threading
from contextlib import suppress
from typing import Any

import psutil

from rcp_gateway.testing._client import BOUND
from rcp_gateway.testing._suite import eventually
from rcp_gateway.testing.backend._base import BackendTests
from rcp_kernel.errors import RcpError
from rcp_kernel.model import Operation
from rcp_protocol.timeouts import timeout

__all__ = ["LifeTests"]

_POOLS = ("AnyIO worker thread", "asyncio_")  # of the event loop, which keeps them

_LETTING_GO = 5.0  # s


def _threads() -> set[threading.Thread]:
    return {t for t in threading.enumerate() if not t.name.startswith(_POOLS)}


def _sockets() -> set[Any]:
    return {(c.fd, c.laddr, c.raddr) for c in psutil.Process().net_connections("all")}


class LifeTests(BackendTests):
    """Tests of opening and closing."""

    async def test_it_opens_twice_in_a_row(self) -> None:
        for _ in range(2):
            async with self.opened() as robot:
                assert robot.resources, "it declared nothing"
                assert robot.served.supervisor.state in ("ready", "degraded"), (
                    robot.served.supervisor.detail
                )

    async def test_it_leaves_no_task_thread_or_socket_behind(self) -> None:
        async with self.opened():  # what a library keeps for the process exists from here
            pass
        gc.collect()
        tasks, threads, sockets = asyncio.all_tasks(), _threads(), _sockets()
        async with self.opened() as robot:
            for resource in robot.having(Operation.SUBSCRIBE):
                await robot.client.subscribe(robot.path(resource.name))

        left: list[Any] = []

        async def gone() -> bool:
            gc.collect()
            left[:] = [*(asyncio.all_tasks() - tasks), *(_threads() - threads)]
            left.extend(_sockets() - sockets)
            return not left

        with suppress(AssertionError):
            await eventually(gone, "nothing is left", _LETTING_GO)
        assert not left, f"left behind: {left}"

    async def test_it_is_open_within_the_time_a_start_waits(self) -> None:
        for _ in range(3):  # a busy machine may delay it
            async with self.opened():
                if self.prompt:
                    return
        raise AssertionError("a gateway had started without it")

    async def test_calls_after_the_end_are_answered_or_refused(self) -> None:
        async with self.opened() as robot:
            readable = robot.having(Operation.READ)
        for resource in readable:
            try:
                async with timeout(BOUND):
                    await robot.backend.read(resource.name)
            except RcpError:
                continue

    async def test_the_loops_thread_alone_is_used_for_what_is_the_loops(self) -> None:
        async with self.opened() as robot:
            for resource in robot.having(Operation.SUBSCRIBE):
                await robot.client.subscribe(robot.path(resource.name))
            await robot.client.request("ping")
            host = robot.served.life.host
        assert host.wrong_thread == set(), "use `publish_batch` or `call_soon` from other threads"
