"""A plan that the gateway's end cut off is failed with that reason, and nothing of it goes on."""

from __future__ import annotations

import shutil
from pathlib import Path

from kernel.world import kept_in, settled, world_of
from plugins.plans.planned import begun, echo, go, run, send


async def test_a_plan_that_a_crash_cut_off_is_failed_with_that_reason(tmp_path: Path) -> None:
    async with world_of(kept_in(tmp_path / "a.db")) as world:
        client = world.client()
        await run(client, echo("ended"), idempotency_key="ended")
        send(client, go(2.0), echo(), idempotency_key="cut-off")
        await begun(world)
        await settled(world.server.gateway.store)
        for suffix in (".head", "", "-wal"):
            shutil.copy(tmp_path / f"a.db{suffix}", tmp_path / f"b.db{suffix}")
    async with world_of(kept_in(tmp_path / "b.db")) as world:
        client = world.client()
        cut_off, ended = (await client.ask(type="read", path="/system/plans"))["body"]
        assert (cut_off["status"], ended["status"]) == ("failed", "completed")
        assert "stopped while the command was running" in cut_off["message"]
        assert ended["steps"][0]["result"] == "ended"
        again = await run(client, go(2.0), echo(), idempotency_key="cut-off")
        assert (again["status"], again["command"]) == ("failed", cut_off["command"])
        assert world.robot.started.empty()
