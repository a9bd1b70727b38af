"""What a call would do is told before: hints of services that only read, and dry runs."""

from __future__ import annotations

import pytest

from plugins.mcp.rig import EVERY_TOOL, ROVER, Caller, Site, caller, site
from plugins.mcp.test_tools import error, words
from rcp_kernel.model import READS, Resource

pytestmark = pytest.mark.anyio


async def test_a_service_that_only_reads_says_so(operator: Caller, gateway: Site) -> None:
    gateway.robot.host.declare(
        Resource(
            name="service/list_logs", description="Lists the logs.", output=list[str], meta=READS
        )
    )
    hints = (await operator.tools())["service-list_logs"]["annotations"]
    assert (hints["readOnlyHint"], hints["destructiveHint"], hints["idempotentHint"]) == (
        True, False, True,
    )  # fmt: skip
    found = await operator.call("discover", path="/service/*")
    read_only = {
        one["path"].rpartition("/")[2]: one.get("read_only", False)
        for one in found["structuredContent"]["resources"]
    }
    assert read_only["list_logs"] is True
    assert read_only["double"] is False


async def test_a_dry_run_refuses_what_the_call_would() -> None:
    async with site(robots=ROVER, mcp=EVERY_TOOL) as rover, caller(rover) as operator:
        pillar = {"position": {"x": 8.0, "y": 7.0}}
        dry = await operator.call("action-move_to", **pillar, dry_run=True)
        real = await operator.call("action-move_to", **pillar)
        assert error(dry)["code"] == error(real)["code"] == "device_rejected"
        assert "obstacle" in words(dry)
        free = await operator.call("action-move_to", position={"x": 1.0, "y": 0.0}, dry_run=True)
        assert free["structuredContent"]["dry_run"] is True
        both = {"position": {"x": 1.0, "y": 0.0}, "yaw": 1.0, "orientation": {"w": 1.0}}
        assert (
            error(await operator.call("action-move_to", **both, dry_run=True))["code"]
            == "invalid_value"
        )
        await operator.call(
            "execute",
            path="/service/inject_fault",
            input={"fault": "sensor_stop", "target": "sensor/odometry", "seconds": 60},
        )
        blind = await operator.call("action-move_to", position={"x": 1.0, "y": 0.0}, dry_run=True)
        assert error(blind)["code"] == "precondition_failed"
