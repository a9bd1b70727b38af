"""Steps that write several paths of one robot as one."""

from __future__ import annotations

from typing import Any

import pytest

from kernel.operations.test_atomic_writes import BOTH, LEFT, RIGHT, WHEELS, TwoWheels
from kernel.world import world_of
from plugins.plans.planned import PEOPLE, code, echo, faults, run, states

BOTH_STEP: dict[str, Any] = {"do": "write", "value": BOTH, "valid_for": 3.0, "id": "both"}


async def test_a_step_writes_several_paths_as_one_with_results_of_earlier_ones() -> None:
    async with world_of(make=TwoWheels) as world:
        client = world.client()
        speed = {"do": "read", "path": "/param/limit", "id": "limit"}
        value = {**BOTH, "/actuator/left": {"$result": "limit"}}
        reply = await run(client, speed, {**BOTH_STEP, "value": value})
        assert states(reply) == {"limit": "completed", "both": "completed"}
        assert world.robot.together[0] == dict(zip(WHEELS, (1.5, 0.5), strict=True))
        assert [one["path"] for one in reply["body"]["steps"][1]["result"]] == [LEFT, RIGHT]


@pytest.mark.parametrize(
    ("value", "fault"),
    [
        ({**BOTH, "/actuator/right": 9.0}, "out_of_range"),
        ({**BOTH, "/actuator/rite": 1.0}, "unknown_path"),
        ({**BOTH, "/param/limit": 1.0}, "not_implemented"),
        (2.0, "invalid_value"),
        ({}, "invalid_value"),
    ],
)
async def test_it_is_checked_before_the_plan_starts(value: Any, fault: str) -> None:
    async with world_of(make=TwoWheels) as world:
        reply = await run(world.client(), echo(), {**BOTH_STEP, "value": value})
        assert faults(reply) == {"both": fault}
        assert (world.robot.ran, world.robot.together) == ([], [])


async def test_an_approved_plan_may_write_all_of_them() -> None:
    async with world_of(PEOPLE, make=TwoWheels) as world:
        agent, guard = world.client("agent-agent-agent"), world.client("guard-guard-guard")
        asked = await run(agent, BOTH_STEP)
        assert code(asked) == "approval_required"
        details = asked["error"]["details"]
        assert details["steps"] == ["both"]
        decision = {"id": details["approval"], "decision": "approve"}
        await guard.ask(type="execute", path="/system/approvals", body=decision)
        reply = await run(agent, BOTH_STEP, approval=details["approval"])
        assert (code(reply), len(world.robot.together)) == ("completed", 1)
