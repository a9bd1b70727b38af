"""Plans of the simulated rover: from Python, and by `rcpctl plan` as a person runs it."""

from __future__ import annotations

import asyncio
import json
import os
import subprocess
import sys
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from configuration import backend, key, listener, role, table
from rcp_client import Client, Feedback, connect
from rcp_gateway.server import Server, prepare, running
from rcp_kernel.config.file import parse
from rcp_kernel.errors import ApprovalRequired, Cancelled, DeviceRejected, UnknownPath

pytestmark = pytest.mark.anyio
BIN = Path(sys.executable).parent
BOUND = 60.0  # s
CONFIG = (
    table("transports", http=False, sse=False)
    + listener(grace=0.1)
    + backend("rover", use="sim", world="empty", noise=0.0, time_scale=10.0)
    + role("careful", approve=["/action/dock"])
    + key("operator", "operator-of-these-plans")
    + key("agent", "agent-of-these-plans", role=["agent", "careful"])
    + key("admin", "admin-of-these-plans")
    + table("plans.objects", box1={"position": {"x": 0.5, "y": 0.5}})
)


@asynccontextmanager
async def rover() -> AsyncGenerator[Server]:
    """Serve one simulated rover on a port of its own."""
    async with running(prepare(parse(CONFIG, "test"), "test")) as server:
        yield server


def client_of(server: Server, token: str = "operator-of-these-plans") -> Client:
    """Make a client of a running gateway."""
    return connect(url_of(server), token=token)


def url_of(server: Server) -> str:
    """Return where the gateway listens."""
    facts = next(t for t in server.status.transports if t["name"] == "asgi")
    return facts["address"] if "address" in facts else facts["url"]


def move(x: float, y: float = 0.0, **more: Any) -> dict[str, Any]:
    """Write a step that drives."""
    value = {"position": {"x": x, "y": y}}
    return {"do": "execute", "path": "/action/move_to", "value": value, **more}


def states(steps: list[dict[str, Any]]) -> list[str]:
    """Return the state of each step."""
    return [step["state"] for step in steps]


async def test_a_rover_drives_a_plan_and_every_step_is_told() -> None:
    async with asyncio.timeout(BOUND), rover() as server, client_of(server) as client:
        received: list[Feedback] = []
        steps = await client.plan(
            [
                {"do": "read", "path": "/sensor/pose", "id": "start"},
                {"do": "write", "path": "/param/speed_limit", "value": 2.0},
                move(1.0, id="out"),
                {"do": "wait", "until": "sensor.pose.position.x > 0.8", "deadline": 10},
                {
                    "do": "execute",
                    "path": "/action/move_to",
                    "value": {"position": {"$result": "start/position"}},
                },
            ],
            on_feedback=received.append,
        )
        assert states(steps) == ["completed"] * 5
        pose = await client.read("/sensor/pose")
        assert abs(pose["position"]["x"] - steps[0]["result"]["position"]["x"]) < 0.2
        assert {f.body["step"] for f in received if f.body} >= {"out", "5"}
        assert any(f.body["step"] == "out" and f.body.get("feedback") for f in received if f.body)


async def test_a_fault_is_tried_again_and_then_falls_back() -> None:
    async with asyncio.timeout(BOUND), rover() as server, client_of(server) as client:
        refuse = {"fault": "refuse", "target": "action/move_to"}
        await client.execute("/service/inject_fault", refuse)
        clear = {"do": "execute", "path": "/service/clear_faults"}
        retry = {"times": 2, "on": ["device_rejected"]}
        steps = await client.plan([move(0.5, retry=retry, fallback=[clear]), move(0.5)])
        assert states(steps) == ["recovered", "completed", "completed"]
        assert steps[0]["tries"] == 3
        await client.execute("/service/inject_fault", refuse)
        with pytest.raises(DeviceRejected) as failed:
            await client.plan([move(0.0), move(1.0)])
        assert states((failed.value.details or {})["body"]["steps"]) == ["failed", "skipped"]


async def test_a_cancelled_plan_leaves_the_rover_at_rest() -> None:
    async with asyncio.timeout(BOUND), rover() as server, client_of(server) as client:
        driving = asyncio.Event()

        def heard(feedback: Feedback) -> None:
            if feedback.body and feedback.body.get("feedback"):
                driving.set()

        running_ = asyncio.create_task(client.plan([move(8.0), move(0.0)], on_feedback=heard))
        await driving.wait()
        (plan, *_) = await client.read("/system/plans")
        await client.cancel(plan["command"])
        with pytest.raises(Cancelled):
            await running_
        odometry = await client.read("/sensor/odometry")
        assert abs(odometry["twist"]["linear"]["x"]) < 0.05
        ended = (await client.read("/system/plans"))[0]
        assert states(ended["steps"]) == ["cancelled", "skipped"]


async def test_the_first_of_two_goals_ends_the_other() -> None:
    async with asyncio.timeout(BOUND), rover() as server, client_of(server) as client:
        near = {"do": "wait", "until": "sensor.pose.position.x > 0.5", "deadline": 20}
        race = {"do": "parallel", "need": "any", "steps": [move(9.0), near]}
        steps = await client.plan([race])
        assert states(steps) == ["completed", "cancelled", "completed"]


async def test_a_planner_names_rovers_actions_and_objects() -> None:
    async with asyncio.timeout(BOUND), rover() as server, client_of(server) as client:
        steps = await client.plan(
            "; found in 0.01 s\n(move_to alpha 0.5 0.0)\n(move-to rover box1)"
        )
        assert [s["result"]["pose"]["position"]["y"] > 0.3 for s in steps] == [False, True]
        with pytest.raises(UnknownPath) as wrong:
            await client.plan("(mov_to alpha 1.0 2.0)")
        (fault,) = (wrong.value.details or {})["faults"]
        assert fault["details"]["near"][0] == "move_to"


async def test_a_person_approves_what_an_agent_asks_for() -> None:
    async with (
        asyncio.timeout(BOUND),
        rover() as server,
        client_of(server, "agent-of-these-plans") as agent,
        client_of(server, "admin-of-these-plans") as person,
    ):
        plan = "move_to alpha 0.5 0.0", "dock alpha"
        text = "\n".join(f"({action})" for action in plan)
        assert [s.get("approval") for s in await agent.plan(text, dry_run=True)] == [None, True]
        with pytest.raises(ApprovalRequired) as asked:
            await agent.plan(text)
        id_ = (asked.value.details or {})["approval"]
        assert [one["approval"] for one in await person.approvals()] == [id_]
        listed = await _rcpctl(server, "approvals", token="admin-of-these-plans")
        assert json.loads(listed.stdout)["approval"] == id_
        why = "the way is free"
        approve = ("approve", id_, "--reason", why, "--text")
        shown = await _rcpctl(server, *approve, token="admin-of-these-plans")
        assert "approved" in shown.stdout, shown.stderr
        assert states(await agent.plan(text, approval=id_)) == ["completed", "completed"]


async def test_rcpctl_runs_and_checks_plans(tmp_path: Path) -> None:
    async with asyncio.timeout(BOUND * 2), rover() as server:
        good, bad = tmp_path / "good.json", tmp_path / "bad.txt"
        good.write_text(json.dumps([move(0.3), {"do": "read", "path": "/param/speed_limit"}]))
        bad.write_text("# wrong\nexecute /action/mov_to x=1\nwrite /param/speed_limit 99\n")
        checked = await _rcpctl(server, "plan", str(good), "--dry-run", "--text")
        assert checked.returncode == 0, checked.stderr
        assert "/tenant/alpha/action/move_to" in checked.stdout
        done = await _rcpctl(server, "plan", str(good))
        assert done.returncode == 0, done.stderr
        assert states(json.loads(done.stdout)["body"]["steps"]) == ["completed", "completed"]
        output = await _rcpctl(server, "plan", str(good), "--text")
        assert "completed" in output.stdout
        refused = await _rcpctl(server, "plan", str(bad), "--text")
        assert refused.returncode == 3
        assert "Did you mean /tenant/alpha/action/move_to?" in refused.stderr
        assert "out_of_range" in refused.stderr


async def _rcpctl(
    server: Server, *arguments: str, token: str = "operator-of-these-plans"
) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "RCP_URL": url_of(server), "RCP_TOKEN": token}
    process = await asyncio.create_subprocess_exec(
        BIN / "rcpctl",
        *arguments,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
        env=environment,
    )
    out, err = await process.communicate()
    return subprocess.CompletedProcess(
        arguments, process.returncode or 0, out.decode(), err.decode()
    )
