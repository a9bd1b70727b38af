"""Plans and approvals: several operations as one command, and commands that require approval."""

from __future__ import annotations

from typing import Any

from rcp_gateway.testing._client import Client, Message
from rcp_gateway.testing._serve import ADMIN, VIEWER
from rcp_gateway.testing._suite import eventually, proves
from rcp_gateway.testing.wire._base import ASKING, LOCAL, Wire, World

__all__ = ["Planning"]

_PLANS = "/system/plans"
_LIMIT = "/param/limit"
_NOTHING = "/service/nothing"


def go(mode: str = "quick", action: str = "go", **more: Any) -> Message:
    """Write a step that does as its mode says."""
    value = {"distance": 1.0, "mode": mode}
    return {"do": "execute", "path": f"/action/{action}", "value": value, **more}


def limit(value: Any, **more: Any) -> Message:
    """Write a step that writes."""
    return {"do": "write", "path": _LIMIT, "value": value, **more}


async def run(client: Client, *steps: Message, **fields: Any) -> Message:
    """Run a plan to its end."""
    return await client.request("execute", _PLANS, body={"steps": list(steps)}, **fields)


def states(reply: Message) -> list[str]:
    """Return the state of each step, in order."""
    return [step["state"] for step in reply["body"]["steps"]]


def code(reply: Message) -> str:
    """Return the error of a reply, or its status."""
    return reply.get("error", {}).get("code", reply["status"])


class Planning(Wire):
    """Tests of plans and approvals on every transport."""

    @proves("plan.steps")
    async def test_a_plan_runs_in_order_with_results_of_earlier_steps(self, world: World) -> None:
        client = await world.client()
        read = {"do": "read", "path": _LIMIT, "id": "before"}
        reply = await run(client, read, limit(0.5), limit({"$result": "before"}), go())
        assert states(reply) == ["completed"] * 4
        assert [step["result"] for step in reply["body"]["steps"]] == [1.5, 0.5, 1.5, 1.0]
        assert [value for _, value in world.robot().writes] == [0.5, 1.5]

    @proves("plan.checked")
    async def test_a_plan_is_checked_whole_before_its_first_step(self, world: World) -> None:
        client = await world.client()
        wrong = {"do": "read", "path": "/param/limmit", "id": "typo"}
        reply = await run(client, limit(1.0), wrong, limit(9.0, id="bound"))
        assert (reply["status"], code(reply)) == ("rejected", "unknown_path")
        faults = {f["step"]: f["code"] for f in reply["error"]["details"]["faults"]}
        assert faults == {"typo": "unknown_path", "bound": "out_of_range"}
        assert world.robot().writes == []

    @proves("plan.dry-run")
    async def test_a_dry_run_tells_what_would_be_sent(self, world: World) -> None:
        client = await world.client()
        reply = await run(client, limit(1.0), dry_run=True)
        assert (reply["status"], reply["dry_run"]) == ("completed", True)
        assert [(s["do"], s["value"]) for s in reply["body"]["steps"]] == [("write", 1.0)]
        assert code(await run(client, limit(9.0), dry_run=True)) == "out_of_range"
        assert world.robot().writes == []

    @proves("plan.failure")
    async def test_a_failed_step_ends_the_plan_or_falls_back(self, world: World) -> None:
        client = await world.client()
        reply = await run(client, go("stumble", id="walk"), limit(1.0))
        assert (reply["status"], code(reply)) == ("failed", "device_rejected")
        assert reply["error"]["details"]["step"] == "walk"
        assert states(reply) == ["failed", "skipped"]
        reply = await run(client, go("stumble", fallback=[limit(1.0)]), limit(2.0))
        assert states(reply) == ["recovered", "completed", "completed"]

    @proves("plan.parallel")
    async def test_steps_of_a_parallel_run_side_by_side(self, world: World) -> None:
        client, robot = await world.client(), world.robot()
        both = {"do": "parallel", "steps": [go("wait"), go("wait", "line")]}
        id_ = await client.send(type="execute", path=_PLANS, body={"steps": [both]})

        async def begun() -> bool:
            return len(robot.ran) == 2

        await eventually(begun, "both run")
        robot.release.set()
        assert states(await client.final(id_)) == ["completed"] * 3

    @proves("plan.cancel")
    async def test_cancel_stops_what_runs_and_begins_nothing_more(self, world: World) -> None:
        client, robot = await world.client(), world.robot()
        steps = [go("wait", fallback=[limit(0.5)]), limit(1.0)]
        id_ = await client.send(type="execute", path=_PLANS, body={"steps": steps})

        async def begun() -> bool:
            return bool(robot.ran)

        await eventually(begun, "it runs")
        (seen,) = (await client.request("read", _PLANS))["body"]
        assert [step["state"] for step in seen["steps"]] == ["running", "pending", "pending"]
        await client.request("cancel", command=seen["command"])
        reply = await client.final(id_)
        assert (reply["status"], states(reply)) == (
            "cancelled",
            ["cancelled", "skipped", "skipped"],
        )

        async def stopped() -> bool:
            return robot.stopped == ["action/go"]

        await eventually(stopped, "the robot is told")
        assert robot.writes == []

    @proves("plan.estop")
    async def test_an_estop_ends_plans(self, world: World) -> None:
        client, admin, robot = await world.client(), await world.client(ADMIN), world.robot()
        steps = [go("wait", fallback=[limit(0.5)]), limit(1.0)]
        id_ = await client.send(type="execute", path=_PLANS, body={"steps": steps})

        async def begun() -> bool:
            return bool(robot.ran)

        await eventually(begun, "it runs")
        await admin.request("execute", "/system/estop", body={}, deadline=0.5)
        await admin.request("execute", "/system/estop", body={"reset": True})
        assert (await client.final(id_))["status"] == "cancelled"
        assert robot.writes == []

    @proves("plan.notations")
    async def test_a_plan_is_steps_symbols_or_lines(self, world: World) -> None:
        client = await world.client()
        for body in (
            {"symbolic": "; one\n(go alpha 2.0) ; two\n(nothing alpha)"},
            {"lines": 'EXECUTE /action/go {"distance": 2.0}\nexecute /service/nothing'},
        ):
            reply = await client.request("execute", _PLANS, body=body)
            results = [step.get("result") for step in reply["body"]["steps"]]
            assert (states(reply), results) == (["completed"] * 2, [2.0, None])

    @proves("plan.rights")
    async def test_a_plan_has_the_rights_of_who_sent_it(self, world: World) -> None:
        local, viewer = await world.client(LOCAL), await world.client(VIEWER)
        hidden = {"do": "read", "path": "/sensor/secret", "id": "hidden"}
        other = {"do": "write", "path": "/tenant/beta/param/limit", "value": 1.0, "id": "other"}
        reply = await run(local, hidden, other)
        faults = {f["step"]: f["code"] for f in reply["error"]["details"]["faults"]}
        assert faults == {"hidden": "unknown_path", "other": "unknown_path"}
        assert code(await run(viewer, limit(1.0))) == "unknown_path"

    @proves("approval.asked", "approval.once")
    async def test_what_is_approved_passes_once(self, world: World) -> None:
        requester, admin, robot = (
            await world.client(ASKING),
            await world.client(ADMIN),
            world.robot(),
        )
        reply = await requester.request("execute", _NOTHING)
        assert (reply["status"], code(reply)) == ("rejected", "approval_required")
        id_ = reply["error"]["details"]["approval"]
        (listed,) = (await admin.request("read", "/system/approvals"))["body"]
        assert (listed["approval"], listed["status"]) == (id_, "pending")
        decision = {"id": id_, "decision": "approve", "reason": "nobody is near"}
        await admin.request("execute", "/system/approvals", body=decision)
        assert code(await requester.request("execute", _NOTHING, approval=id_)) == "completed"
        assert code(await requester.request("execute", _NOTHING, approval=id_)) == "forbidden"
        assert [name for name, _ in robot.ran] == ["service/nothing"]

    @proves("approval.others")
    async def test_nobody_approves_their_own(self, world: World) -> None:
        requester, other = await world.client(ASKING), await world.client(LOCAL)
        reply = await requester.request("execute", _NOTHING)
        decision = {"id": reply["error"]["details"]["approval"], "decision": "approve"}
        for client, codes in (
            (requester, ("forbidden", "unknown_path")),
            (other, ("unknown_path",)),
        ):
            reply = await client.request("execute", "/system/approvals", body=decision)
            assert code(reply) in codes

    @proves("approval.plan")
    async def test_a_plan_wants_one_approval(self, world: World) -> None:
        requester, admin = await world.client(ASKING), await world.client(ADMIN)
        steps = [limit(1.0), {"do": "execute", "path": _NOTHING, "id": "careful"}]
        reply = await run(requester, *steps)
        details = reply["error"]["details"]
        assert (code(reply), details["steps"]) == ("approval_required", ["careful"])
        assert world.robot().writes == []
        decision = {"id": details["approval"], "decision": "approve"}
        await admin.request("execute", "/system/approvals", body=decision)
        reply = await run(requester, *steps, approval=details["approval"])
        assert states(reply) == ["completed", "completed"]
