"""Robots in maintenance accept no commands, and everybody sees why."""

from __future__ import annotations

from importlib.metadata import entry_points
from pathlib import Path
from typing import ClassVar

import pytest
from rcp_gateway.testing import ADMIN, OPERATOR, FeatureGateway, FeatureSuite

import rcp_maintenance

PATH = "/system/maintenance"


class TestMaintenance(FeatureSuite):
    kind = rcp_maintenance.MAINTENANCE
    refusal = "mode_forbids"

    async def engage(self, gateway: FeatureGateway) -> None:
        begin = {"do": "begin", "reason": "new gripper"}
        reply = await gateway.admin.request("execute", PATH, body=begin)
        assert reply["status"] == "completed", reply

    async def release(self, gateway: FeatureGateway) -> None:
        reply = await gateway.admin.request("execute", PATH, body={"do": "end"})
        assert reply["status"] == "completed", reply

    async def test_whoever_watches_learns_who_works_and_why(self, gateway: FeatureGateway) -> None:
        watching = await gateway.admin.subscribe(PATH)
        assert (await gateway.admin.update(watching))["body"] == []
        await self.engage(gateway)
        (work,) = (await gateway.admin.update(watching))["body"]
        assert (work["tenant"], work["by"], work["reason"]) == ("t", "admin", "new gripper")
        refused = await gateway.operator.request("write", "/param/limit", body=0.5)
        assert "admin has been working on this robot" in refused["error"]["message"]


class TestExempt(FeatureSuite):
    """With a role that is exempt, and a store."""

    kind = rcp_maintenance.MAINTENANCE
    options: ClassVar = {"exempt": ["admin"]}

    async def test_a_role_that_is_exempt_may_command(self, gateway: FeatureGateway) -> None:
        await gateway.admin.request("execute", PATH, body={"do": "begin"})
        assert (await gateway.admin.request("write", "/param/limit", body=0.5))["status"] == (
            "completed"
        )


@pytest.mark.anyio
@pytest.mark.parametrize("anyio_backend", ["asyncio"])
async def test_work_outlives_a_restart(tmp_path: Path) -> None:
    class Kept(TestMaintenance):
        more = f'[store]\npath = "{tmp_path}/store.db"\n'

    suite = Kept()
    async with suite.opened() as gateway:
        await suite.engage(gateway)
    async with suite.opened() as gateway:
        assert [w["by"] for w in (await gateway.client(ADMIN).request("read", PATH))["body"]] == [
            "admin"
        ]
        refused = await gateway.client(OPERATOR).request("write", "/param/limit", body=0.5)
        assert refused["error"]["code"] == "mode_forbids"


def test_it_is_offered_under_its_name() -> None:
    points = entry_points(group="rcp.features", name="maintenance")
    assert [point.value for point in points] in ([], ["rcp_maintenance"])  # none: not installed
