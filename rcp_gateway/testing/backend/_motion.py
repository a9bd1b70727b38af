"""Motion: whatever happens to clients, gateway or e-stop, moving parts come to rest."""

from __future__ import annotations

import asyncio

from rcp_gateway.testing.backend._base import BackendTests, Robot
from rcp_protocol.timeouts import timeout

__all__ = ["MotionTests"]


class MotionTests(BackendTests):
    """Ways to bring it to rest."""

    async def test_a_halt_brings_it_to_rest(self, robot: Robot) -> None:
        await self.set_in_motion()
        async with timeout(self.cancel_within):
            await robot.backend.halt()
        await self.comes_to_rest("halt")

    async def test_a_halt_of_what_rests_is_harmless(self, robot: Robot) -> None:
        for _ in range(2):
            async with timeout(self.cancel_within):
                await robot.backend.halt()
        if self.moving():
            await self.comes_to_rest("two halts")

    async def test_halts_side_by_side_bring_it_to_rest(self, robot: Robot) -> None:
        await self.set_in_motion()
        async with timeout(self.cancel_within):
            await asyncio.gather(robot.backend.halt(), robot.backend.halt())
        await self.comes_to_rest("two halts at once")

    async def test_an_estop_brings_it_to_rest_and_ends_its_commands(self, robot: Robot) -> None:
        command = await self.set_in_motion()
        stop = await robot.client.request("execute", "/system/estop")
        assert (stop["status"], stop["body"]["active"]) == ("completed", True)
        if command is not None:
            final = await robot.client.final(command, self.cancel_within)
            assert final["status"] != "completed", final
        await self.comes_to_rest("the e-stop")
        reset = await self.admin().request("execute", "/system/estop", body={"reset": True})
        assert reset["body"]["active"] is False
        await self.comes_to_rest("the reset")

    async def test_it_is_closed_at_rest(self) -> None:
        async with self.twin() as self.device:
            async with self.served_by_device():
                await self.set_in_motion()
            assert await self.at_rest()

    async def test_a_velocity_lapses_when_its_client_is_lost(self, robot: Robot) -> None:
        for resource in self.moving():
            if resource.safe is None or resource.valid_for is None:
                continue
            body = self.unsafe(resource)
            await robot.ask("write", resource.name, body=body, valid_for=0.1)
            await robot.client.close()
            await self.comes_to_rest(f"{resource.name} had lapsed")
            return
