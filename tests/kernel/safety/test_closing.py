"""A backend that was closed under a latched e-stop: nothing repeats a stop that nobody can send."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from contextlib import AsyncExitStack, asynccontextmanager

import pytest
from structlog.testing import capture_logs

from configuration import backend
from kernel.motion.test_latches import ADMIN, HEAD
from kernel.world import BOUND, NoOptions
from rcp_gateway.testing import ScriptedRobot, scripted, serve
from rcp_kernel.config.file import parse
from rcp_kernel.model import Resource
from rcp_kernel.spi import BackendKind, Host, MotionState

pytestmark = pytest.mark.anyio
TWO = HEAD + backend("quick", robot="r1") + backend("late", use="late", robot="r2")


def robot(host: Host) -> ScriptedRobot:
    return ScriptedRobot(host, Resource(name="action/r1/go", description="Goes."))


async def test_a_closed_backend_is_not_halted_again_while_others_close() -> None:
    closing, go = asyncio.Event(), asyncio.Event()

    @asynccontextmanager
    async def late(_config: NoOptions, host: Host) -> AsyncGenerator[ScriptedRobot]:
        try:
            yield ScriptedRobot(host, Resource(name="action/r2/go", description="Goes."))
        finally:
            closing.set()
            await go.wait()

    kinds = scripted(robot), BackendKind("late", NoOptions, late)
    async with AsyncExitStack() as stack, asyncio.timeout(BOUND):
        served = await stack.enter_async_context(serve(parse(TWO, "test"), *kinds))
        for one in served.server.supervisors:
            await one.settled.wait()
        reply = await served.client(ADMIN).request("execute", "/system/estop", body={})
        assert reply["status"] == "completed", reply
        quick = next(one for one in served.server.supervisors if one.name == "quick")
        stops = served.server.gateway.stops
        assert stops.of(quick.whole) is not None
        with capture_logs() as said:
            ending = asyncio.ensure_future(stack.aclose())
            await closing.wait()
            try:
                async with asyncio.timeout(60):
                    while stops.of(quick.whole) is not None:  # noqa: ASYNC110 - nothing tells of it
                        await asyncio.sleep(0.01)
            finally:
                go.set()
                await ending
    assert not [one for one in said if one["event"] == "halt_failed"], said


async def test_a_backend_that_measures_nothing_while_it_closes_is_not_halted_again() -> None:
    halts = list[str]()

    class Closing(ScriptedRobot):
        """At rest until its devices are given up."""

        given_up = False

        def motion(self, robot: str | None) -> MotionState | None:
            return MotionState(None if self.given_up else True, "closed" if self.given_up else "")

        async def halt(self) -> None:
            halts.append("given up" if self.given_up else "halted")

    @asynccontextmanager
    async def late(_config: NoOptions, host: Host) -> AsyncGenerator[ScriptedRobot]:
        found = Closing(host, Resource(name="action/r2/go", description="Goes."))
        try:
            yield found
        finally:
            found.given_up = True
            await asyncio.sleep(0.3)  # several looks at its motion

    one = HEAD + backend("late", use="late", robot="r2")
    async with AsyncExitStack() as stack, asyncio.timeout(BOUND):
        served = await stack.enter_async_context(
            serve(parse(one, "test"), BackendKind("late", NoOptions, late))
        )
        for supervisor in served.server.supervisors:
            await supervisor.settled.wait()
        reply = await served.client(ADMIN).request("execute", "/system/estop", body={})
        assert reply["status"] == "completed", reply
    assert "given up" not in halts
