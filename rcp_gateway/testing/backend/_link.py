"""The link of a backend, if the author can break it: loss is reported and recovered from."""

from __future__ import annotations

import time

import pytest

from rcp_gateway.testing._client import Message
from rcp_gateway.testing._suite import eventually
from rcp_gateway.testing.backend._base import BackendTests, Robot
from rcp_kernel.model import Operation

__all__ = ["LinkTests"]

_TOLD = {"adapter_unavailable", "device_timeout"}
_WAIT = 8.0  # s in which a call over a broken link has ended


class LinkTests(BackendTests):
    """Tests of a link that breaks and recovers."""

    def _needs_a_link(self) -> None:
        if not self.link_breaks:
            pytest.skip("break_link and mend_link are not given")

    async def test_over_a_broken_link_calls_end_with_the_reason(self, robot: Robot) -> None:
        self._needs_a_link()
        await self.break_link()
        for resource in robot.having(Operation.READ):
            started = time.monotonic()
            reply = await robot.ask("read", resource.name, body={"fresh": True}, deadline=_WAIT)
            assert time.monotonic() - started < _WAIT, resource.name
            assert "error" not in reply or _is_told(reply), f"read {resource.name}: {reply}"
        for resource in robot.having(Operation.WRITE):
            value = self.values(resource.name)[0]
            reply = await robot.ask("write", resource.name, body=value, deadline=_WAIT)
            assert _is_told(reply), f"write {resource.name}: {reply}"
        for name, goal in self.goals().items():
            reply = await robot.ask("execute", name, body=goal.good, deadline=_WAIT)
            own = goal.local and reply["status"] == "completed"
            assert own or _is_told(reply), f"execute {name}: {reply}"
        await self.mend_link()  # or closing would try to halt it for as long as it may

    async def test_a_command_over_a_link_that_breaks_ends(self, robot: Robot) -> None:
        self._needs_a_link()
        for name in self.actions():
            id_ = await self.begin(name)
            await self.break_link()
            final = await robot.client.final(id_, _WAIT)
            assert final["status"] == "failed", final
            assert _is_told(final), final
            await self.mend_link()
            return

    async def test_a_broken_link_shows_in_the_state_and_a_mended_one_is_ready(
        self, robot: Robot
    ) -> None:
        self._needs_a_link()

        async def is_ready() -> bool:
            return robot.served.supervisor.state == "ready"

        async def is_not_ready() -> bool:
            return not await is_ready()

        await eventually(is_ready, "ready at first")
        await self.break_link()
        await eventually(is_not_ready, "a broken link shows")
        await self.mend_link()
        await eventually(is_ready, "a mended link is ready")
        for resource in robot.having(Operation.READ):
            reply = await robot.ask("read", resource.name)
            assert "error" not in reply or _is_told(reply), f"read {resource.name}: {reply}"


def _is_told(reply: Message) -> bool:
    return "error" in reply and reply["error"]["code"] in _TOLD
