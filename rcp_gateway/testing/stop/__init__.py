"""The stop suite: whatever runs or fails, a stopped robot is at rest and stays at rest."""

from __future__ import annotations

import asyncio
import os
import time
from collections.abc import AsyncGenerator
from contextlib import AsyncExitStack, asynccontextmanager
from pathlib import Path
from typing import Any, ClassVar

import pytest

from rcp_gateway.testing._client import Message
from rcp_gateway.testing._load import measured_load
from rcp_gateway.testing._suite import BOUND, eventually
from rcp_gateway.testing.backend._base import Robot
from rcp_gateway.testing.stop._attempts import Attempts
from rcp_gateway.testing.stop._interleavings import InterleavingTests
from rcp_gateway.testing.stop._rig import StopRig
from rcp_gateway.testing.stop._situations import SITUATIONS, Situation

__all__ = ["SCOPES", "StopRig", "StopSuite"]

SCOPES = {"robot": "robot", "tenant": "/tenant/t", "all": None}
"""Scopes of a stop: the robot by its backend's name, its tenant, everything."""
_LOOK = 0.02  # s between two looks at the device
_ANSWERED = 20.0  # s that the first attempt may take: a lost store delays its reply
_STAYS = float(os.environ.get("RCP_STOP_STAYS", "1"))


class StopSuite(InterleavingTests):
    """All tests of a stop.

    Subclass it together with what you provide to `BackendSuite` (`kind`, `goals`, `at_rest`, …), and
    provide the faults that can be injected: `break_link` with `mend_link`, `freeze_device` with
    `thaw_device`, `freeze_feedback` with `thaw_feedback`, and `foreign_commander`. Situations without
    their fault are skipped. RCP_STOP_STAYS sets for how many seconds each robot is watched; use 10 for
    a release.
    """

    stop_within: ClassVar[float] = 3.0
    """Seconds until the device is at rest and that is confirmed, with the link whole; a busy machine
    is given up to twice as many, by what its other work takes."""
    stays: ClassVar[float] = _STAYS
    """Seconds for which all clients try to move it after the stop."""
    distant: ClassVar[bool] = False
    """Whether the reply comes over a link from where the device is measured: another commander
    may have moved it again when the reply arrives."""

    def test_no_test_of_the_stop_suite_is_changed_without_a_reason(self) -> None:
        """See that nothing was overridden or taken out but under xfail with a reason."""
        assert self.altered(StopSuite) == []

    @pytest.mark.parametrize("scope", SCOPES)
    @pytest.mark.parametrize("situation", SITUATIONS)
    async def test_it_comes_to_rest_and_stays_there(
        self, situation: str, scope: str, tmp_path: Path
    ) -> None:
        """Stop it in a situation, see it at rest, and see it stay there."""
        async with self._in(SITUATIONS[situation], tmp_path) as (case, robot):
            reply = await self._stop(case, robot, scope)
            await case.after(reply)
            with measured_load() as load:
                began = time.monotonic()
                await eventually(self.at_rest, "at rest", self.stop_within)
                await self._confirmed()
                took = time.monotonic() - began
            allowed = load.allows(self.stop_within, self.stop_within)
            assert took < allowed, f"confirmed after {took:.2f} s, allowed are {allowed:.2f} s"
            await self._stays_at_rest(case, robot)
            await case.end()

    @asynccontextmanager
    async def _in(
        self, kind: type[Situation], tmp_path: Path
    ) -> AsyncGenerator[tuple[Situation, Robot]]:
        kind.check(self)
        self.store = tmp_path / "rcp.sqlite3" if kind.store else None
        async with AsyncExitStack() as stack:
            robot = await stack.enter_async_context(self.opened())
            case = await stack.enter_async_context(kind.around(self, robot))
            yield case, robot

    async def _stop(self, case: Situation, robot: Robot, scope: str) -> Message:
        """Request the stop; check that `completed` implies that the device is at rest."""
        scopes = SCOPES[scope]
        body = {
            "scope": robot.served.supervisor.name if scopes == "robot" else scopes,
            "reason": "suite",
        }
        admin = self.admin()
        fields = {} if case.deadline is None else {"deadline": case.deadline}
        id_ = await admin.send(fields, type="execute", path="/system/estop", body=body)
        await case.during()
        reply = await admin.final(id_)
        if reply["status"] == "completed":
            if case.shoves and self.distant:
                await eventually(self.at_rest, "at rest again", self.stop_within)
            assert await self.at_rest(), f"told to be at rest, and is not: {reply}"
            states = reply["body"]["robots"].values()
            assert all(state["state"] == "confirmed" for state in states), reply
        else:
            assert reply["status"] == "failed", reply
            assert reply["error"]["code"] == "device_timeout", reply
        return reply

    async def _confirmed(self) -> None:
        """Wait until the gateway confirms that the device is at rest."""
        admin = self.admin()

        async def confirmed() -> bool:
            state = await admin.request("read", "/system/estop")
            robots: dict[str, Any] = state["body"]["robots"]
            assert robots, "nothing is latched"
            return all(robot["state"] == "confirmed" for robot in robots.values())

        await eventually(confirmed, "the stop is confirmed", BOUND)
        await admin.close()

    async def _stays_at_rest(self, case: Situation, robot: Robot) -> None:
        """Check that nothing moves it while all clients try."""
        attempts = Attempts(self, robot)
        task = asyncio.create_task(attempts.run())
        loop = asyncio.get_running_loop()
        end = loop.time() + self.stays
        try:
            while loop.time() < end or (not attempts.count and loop.time() < end + _ANSWERED):
                assert case.shoves or await self.at_rest(), f"it moves; tried: {attempts.last}"
                assert not task.done(), task.exception()
                await asyncio.sleep(_LOOK)
        finally:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)
        assert attempts.count, "nobody tried to move it"
        if case.shoves:
            await eventually(self.at_rest, "at rest again", self.stop_within)
