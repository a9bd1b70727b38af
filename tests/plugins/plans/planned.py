"""Plans in the world of the kernel's tests."""

from __future__ import annotations

import asyncio
from typing import Any

from kernel.world import BOUND, CONFIG, Client, World

GO = "/action/go"
ECHO = "/service/echo"
LIMIT = "/param/limit"

PEOPLE = (
    CONFIG
    + """
[plans.objects]
far = { metres = 2.0 }

[plans.actions.approach]
path = "/action/{0}"
value = "{1.metres}"

[plans.actions.set_limit]
path = "/param/limit"
do = "write"
value = "{0}"

[roles.asks]
allow = [{ operations = ["*"], paths = ["/**"] },
         { operations = ["read", "execute"], paths = ["/system/plans", "/system/estop"] }]
approve = ["/action/go", "/actuator/**"]

[roles.owned]
allow = [{ operations = ["*"], paths = ["/**"] }]
approve = ["/action/go"]
approve_own = true

[roles.guard]
allow = [{ operations = ["read"], paths = ["/**"] }]
may_approve = true

[roles.blind]
allow = [{ operations = ["read"], paths = ["/sensor/**"] }]
may_approve = true

[roles.half]
allow = [{ operations = ["*"], paths = ["/service/**", "/param/**"] },
         { operations = ["read", "subscribe", "execute"], paths = ["/system/plans"] }]

[[keys]]
name = "agent"
role = "asks"
key = "agent-agent-agent"

[[keys]]
name = "owned"
role = "owned"
key = "owned-owned-owned"

[[keys]]
name = "guard"
role = "guard"
key = "guard-guard-guard"

[[keys]]
name = "blind"
role = "blind"
key = "blind-blind-blind"

[[keys]]
name = "half"
role = "half"
key = "half-half-half-half"
"""
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
