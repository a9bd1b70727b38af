"""The guard on ROS 2: a real subscriber, action server and service are told to stop."""

from __future__ import annotations

import importlib.util
import os
import tempfile
from typing import Any

import pytest

from plugins.guard.bench import WITHIN, Bench, bench, until
from timing import in_one_of_three_attempts, in_time

pytestmark = [pytest.mark.anyio, pytest.mark.paired]
if importlib.util.find_spec("rclpy") is None:
    pytest.skip("rclpy is not installed", allow_module_level=True)
HEADER = "00010000"  # CDR, little-endian


@pytest.fixture(autouse=True)
def on_this_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setenv("ROS_LOG_DIR", tempfile.gettempdir())
    if "HOME" not in os.environ:
        monkeypatch.setenv("HOME", tempfile.gettempdir())


def plan(domain: int) -> dict[str, Any]:
    zero = {"topic": "/cmd_vel", "type": "geometry_msgs/msg/Twist", "reliable": True}
    halt = {"name": "/halt", "type": "std_srvs/srv/SetBool"}
    data = {
        "domain_id": domain,
        "publishers": [
            {"topic": "/strange", "type": "no_such/msg/Type", "data": HEADER},
            zero | {"data": HEADER + 48 * "00"},
        ],
        "cancel": ["/go"],
        "services": [halt | {"data": HEADER + "01"}],
    }
    return {"sender": "ros2", "data": data, "period": 0.05}


async def nearly_ready(scene: Bench) -> bool:
    facts = await scene.gateway.ask("guard", do="guard")
    plans = facts["guard"]["plans"]
    detail = plans[0]["detail"] or "" if plans else ""
    if "no_such/msg/Type" not in detail or "no s" in detail.replace("no_such", ""):
        return False
    assert "guard_sender" in facts["warnings"]
    return True


@pytest.mark.parametrize("how", ["SIGSTOP", "SIGKILL", "gil"])
@in_one_of_three_attempts
async def test_topics_goals_and_services_are_told(how: str) -> None:
    from backends.ros2.robot import fresh_domain

    domain = fresh_domain()
    async with bench(lambda _port: plan(domain), device=("ros2", str(domain))) as scene:
        device = scene.device
        await device.until(lambda fact: fact.get("told") == "running")
        # Ready but for the type that is not there, which does not keep the rest from being sent.
        await until(lambda: nearly_ready(scene))
        await scene.drive()
        at = await scene.freeze(how)
        seconds = await scene.stopped("topic") - at
        halted = await device.until(lambda fact: fact.get("by") == "service")
        cancelled = await device.until(lambda fact: fact.get("told") == "cancelled")
        assert halted["told"] is True
        print(  # noqa: T201 - the measured times
            f"ros2, {how}: topic after {seconds:.3f} s, service after {halted['at'] - at:.3f} s, "
            f"goal cancelled after {cancelled['at'] - at:.3f} s"
        )
        for one in (seconds, halted["at"] - at, cancelled["at"] - at):
            in_time(one, WITHIN)
