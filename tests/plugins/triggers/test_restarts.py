"""A gateway that is killed delivers, after its restart, what it had on record: once."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from configuration import table
from durability.process import CONFIG, Served
from plugins.triggers.gateway import webhook
from plugins.triggers.receiver import receiver

pytestmark = pytest.mark.anyio
LIMIT = "/tenant/alpha/param/speed_limit"


async def test_a_killed_gateway_delivers_each_notification_once(tmp_path: Path) -> None:
    async with receiver() as ops:
        rule = {"robot": "/tenant/alpha", "when": "param.speed_limit > 1.0"}
        text = CONFIG + table(
            "features.triggers",
            targets={"ops": webhook(ops.url)},
            rules={"fast": {**rule, "alarm": True, "notify": ["ops"]}},
        )
        life = await asyncio.to_thread(Served, tmp_path, tmp_path / "store.db", text)
        ops.status = 503
        try:
            assert (await asyncio.to_thread(life.ask, "PUT", LIMIT, 1.5))["status"] == "completed"
            await ops.until(lambda: ops.asked >= 1)
            await asyncio.to_thread(life.kill)
            life = await asyncio.to_thread(Served, tmp_path, tmp_path / "store.db", text)
            await ops.until(lambda: ops.asked >= 2)
            await asyncio.to_thread(life.kill)
            ops.status = 200
            life = await asyncio.to_thread(Served, tmp_path, tmp_path / "store.db", text)
            (got,) = await ops.count(1)
            alarms = (await asyncio.to_thread(life.ask, "GET", "/system/alarms"))["body"]
            status = (await asyncio.to_thread(life.status))["triggers"]
        finally:
            await asyncio.to_thread(life.kill)
        # Every attempt, in each of three lives, was of the same notification.
        assert set(ops.ids) == {got.headers["webhook-id"]}
        assert [one["alarm"] for one in alarms] == [got.body["data"]["alarm"]]
        assert (len(ops.got), status["waiting"]) == (1, 0)
