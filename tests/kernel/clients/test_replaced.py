"""`hello` as another principal replaces a session: what it still owes is answered on its connection."""

from __future__ import annotations

import pytest

from kernel.world import world_of

pytestmark = pytest.mark.anyio
TOKEN = {"token": "admin-admin-admin"}


async def test_a_request_that_waits_for_its_turn_is_cancelled() -> None:
    async with world_of() as world:
        client = world.client()
        world.server.client_api.turns.add(1.0)  # this turn of the loop has no time for it
        waiting = client.send(type="discover", body={"limit": 1})
        hello = await client.ask(type="hello", body=TOKEN)
        assert hello["body"]["principal"] == "admin"
        reply = await client.final(waiting)
        assert (reply["status"], reply["error"]["code"]) == ("cancelled", "cancelled")
        assert "hello" in reply["message"]
        assert (await client.ask(type="discover", body={"limit": 1}))["status"] == "completed"


async def test_a_command_that_runs_ends_with_its_reply() -> None:
    async with world_of() as world:
        client = world.client()
        running = client.send(type="execute", path="/tenant/alpha/action/go", body=1)
        await client.until(lambda m: m.get("status") == "in_progress")
        await client.ask(type="hello", body=TOKEN)
        world.robot.release.set()
        assert (await client.final(running))["status"] == "completed"
