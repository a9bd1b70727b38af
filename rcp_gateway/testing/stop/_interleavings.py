"""Stops, commands, leases, resets and reconnects in any order: the latch always wins."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from rcp_gateway.testing._client import Client
from rcp_gateway.testing._serve import OPERATOR
from rcp_gateway.testing._suite import eventually
from rcp_gateway.testing.backend._base import Robot
from rcp_gateway.testing.stop._rig import StopRig

__all__ = ["InterleavingTests"]

_STEPS = (
    "stop",
    "reset",
    "drive",
    "act",
    "cancel",
    "reconnect",
    "lease",
    "release",
    "hold",
    "wait",
)


class _Player:
    """Carries out steps without waiting for one before the next, and knows whether it is latched."""

    def __init__(self, rig: StopRig, robot: Robot) -> None:
        self._rig, self._robot = rig, robot
        self._admin: Client = rig.admin()
        self._client: Client = robot.served.client(OPERATOR)
        self._stops: list[str] = []
        self.latched = False

    async def play(self, step: str) -> None:
        """Do one step."""
        await getattr(self, step)()

    async def stop(self) -> None:
        """Request a stop."""
        self.latched = True
        body = {"scope": self._robot.served.supervisor.name}
        self._stops.append(await self._admin.send(type="execute", path=_ESTOP, body=body))

    async def reset(self) -> None:
        """Reset it."""
        self.latched = False
        await self._admin.send(type="execute", path=_ESTOP, body={"reset": True})

    async def drive(self) -> None:
        """Write a velocity."""
        for resource in self._rig.moving():
            if resource.safe is not None:
                body = self._rig.unsafe(resource)
                await self._send("write", self._robot.path(resource.name), body)
                return

    async def act(self) -> None:
        """Start an action, besides or instead of the running one."""
        for name in self._rig.actions():
            await self._send("execute", self._robot.path(name), self._rig.goals()[name].lasting)
            return

    async def cancel(self) -> None:
        """Cancel what runs."""
        for name in self._rig.actions():
            await self._send("cancel", self._robot.path(name), None)
            return

    async def hold(self) -> None:
        """Execute a hold."""
        await self._send("execute", self._robot.path("service/hold"), None)

    async def lease(self) -> None:
        """Acquire a lease."""
        await self._send("execute", "/system/leases", {"do": "acquire", "scope": "/tenant/t"})

    async def release(self) -> None:
        """Give control back."""
        await self._send("execute", "/system/leases", {"do": "release", "scope": "/tenant/t"})

    async def reconnect(self) -> None:
        """Disconnect, and connect again with a new session."""
        await self._client.close()
        self._client = self._robot.served.client(OPERATOR)

    async def wait(self) -> None:
        """Let pending work continue."""
        for _ in range(20):
            await asyncio.sleep(0)

    async def _send(self, type_: str, path: str, body: Any) -> None:
        fields: dict[str, Any] = {"type": type_, "path": path}
        await self._client.send(fields | ({} if body is None else {"body": body}))

    async def answers(self) -> None:
        """Check that each stop was answered, and truthfully."""
        for id_ in self._stops:
            reply = await self._admin.final(id_)
            assert reply["status"] in ("completed", "failed"), reply


_ESTOP = "/system/estop"


class InterleavingTests(StopRig):
    """Orders that hypothesis chooses."""

    async def test_in_any_order_a_latched_robot_is_at_rest(self) -> None:
        """Play orders of steps, and end each by a stop and a reset."""
        async with self.opened() as robot:
            prove = _law(self, robot)
            await prove()


def _law(rig: StopRig, robot: Robot) -> Any:
    pytest.importorskip("hypothesis", reason="it chooses the orders")
    from hypothesis import Phase, given, settings
    from hypothesis import strategies as st

    loop = asyncio.get_running_loop()

    @settings(max_examples=12, deadline=None, phases=[Phase.explicit, Phase.generate])
    @given(st.lists(st.sampled_from(_STEPS), min_size=2, max_size=12))
    def law(steps: list[str]) -> None:
        asyncio.run_coroutine_threadsafe(_play(rig, robot, steps), loop).result(120)

    async def prove() -> None:
        await asyncio.to_thread(law)

    return prove


async def _play(rig: StopRig, robot: Robot, steps: list[str]) -> None:
    player = _Player(rig, robot)
    for step in steps:
        await player.play(step)
    if not player.latched:
        await player.stop()
    await player.answers()
    await eventually(rig.at_rest, f"at rest after {steps}", 10.0)
    state = await rig.admin().request("read", _ESTOP)
    assert state["body"]["active"], state
    reset = await rig.admin().request("execute", _ESTOP, body={"reset": True})
    assert reset["status"] == "completed", reset
    assert await rig.at_rest(), f"it moves after the reset of {steps}"
