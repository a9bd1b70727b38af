"""Plans in the world of the kernel's tests."""

from __future__ import annotations

import asyncio
from typing import Any

from configuration import key, role, rule, table
from kernel.world import BOUND, CONFIG, Client, World

GO = "/action/go"
ECHO = "/service/echo"
LIMIT = "/param/limit"

PEOPLE = (
    CONFIG
    + table("plans.objects", far={"metres": 2.0})
    + table("plans.actions.approach", path="/action/{0}", value="{1.metres}")
    + table("plans.actions.set_limit", path="/param/limit", do="write", value="{0}")
    + role(
        "asks",
        rule("*", "/**"),
        rule("read execute", "/system/plans", "/system/estop"),
        approve=["/action/go", "/actuator/**"],
    )
    + role("owned", rule("*", "/**"), approve=["/action/go"], approve_own=True)
    + role("guard", rule("read", "/**"), may_approve=True)
    + role("blind", rule("read", "/sensor/**"), may_approve=True)
    + role(
        "half",
        rule("*", "/service/**", "/param/**"),
        rule("read subscribe execute", "/system/plans"),
    )
    + key("agent", "agent-agent-agent", role="asks")
    + key("owned", "owned-owned-owned")
    + key("guard", "guard-guard-guard")
    + key("blind", "blind-blind-blind")
    + key("half", "half-half-half-half")
)


def step(do: str, path: str, value: Any = None, **more: Any) -> dict[str, Any]:
    """Write an operation."""
    return {"do": do, "path": path, **({} if value is None else {"value": value}), **more}


def go(value: float, **more: Any) -> dict[str, Any]:
    """Write a step that waits until the robot is released, or fails as its value says."""
    return step("execute", GO, value, **more)


def echo(value: Any = "here", **more: Any) -> dict[str, Any]:
    """Write a step that completes at once."""
    return step("execute", ECHO, value, **more)


def send(client: Client, *steps: dict[str, Any], **envelope: Any) -> str:
    """Send a plan; return the request's id."""
    body = {"steps": list(steps)}
    return client.send(type="execute", path="/system/plans", body=body, **envelope)


async def run(client: Client, *steps: dict[str, Any], **envelope: Any) -> dict[str, Any]:
    """Run a plan to its end; return the final reply."""
    return await client.final(send(client, *steps, **envelope))


def states(reply: dict[str, Any]) -> dict[str, str]:
    """Return the state of each step by its id."""
    return {one["step"]: one["state"] for one in reply["body"]["steps"]}


def faults(reply: dict[str, Any]) -> dict[str, str]:
    """Return the code of each fault by its step."""
    assert reply["status"] == "rejected", reply
    return {one["step"]: one["code"] for one in reply["error"]["details"]["faults"]}


def code(reply: dict[str, Any]) -> str:
    """Return the error of a reply, or its status."""
    return reply.get("error", {}).get("code", reply["status"])


async def begun(world: World) -> Any:
    """Wait until the robot begins something; return its value."""
    async with asyncio.timeout(BOUND):
        return await world.robot.started.get()
