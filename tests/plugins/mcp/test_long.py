"""Actions that take a while: progress, patience, cancellation by rule, deadlines."""

from __future__ import annotations

import asyncio
from typing import Any

import anyio

from plugins.mcp.rig import BOUND, EVERY_TOOL, Caller, Site, caller, site

PROGRESS = {"progressToken": "p"}


async def started(made: Site) -> None:
    """Wait until the robot goes."""
    async with asyncio.timeout(BOUND):
        await made.robot.started.get()


async def test_feedback_is_progress_that_rises_and_the_result_is_structured(
    gateway: Site, operator: Caller
) -> None:
    asked = asyncio.create_task(
        operator.ask("tools/call", name="action-go", arguments={"x": 4}, meta=PROGRESS)
    )
    await started(gateway)
    async with asyncio.timeout(BOUND):
        while not operator.notifications:  # noqa: ASYNC110 - the stream is read by the task
            await asyncio.sleep(0.01)
    gateway.robot.release.set()
    result = await asked
    received = [one["params"] for one in operator.notifications]
    assert all(one["progressToken"] == "p" for one in received)
    parts = [one["progress"] for one in received]
    assert parts == sorted(set(parts))
    assert result["structuredContent"]["status"] == "completed"
    assert result["structuredContent"]["result"] == {"x": 4, "y": 0}


async def test_after_the_patience_there_is_a_command_to_ask_about_and_to_cancel(
    gateway: Site, operator: Caller
) -> None:
    result = await operator.call("action-go", x=4, wait=0.1)
    facts = result["structuredContent"]
    assert facts["status"] == "in_progress"
    reply = await operator.call("status", command=facts["command"])
    assert reply["structuredContent"]["command"]["status"] == "in_progress"
    running = (await operator.call("status"))["structuredContent"]["running"]
    assert [one["command"] for one in running] == [facts["command"]]
    ended = await operator.call("cancel", command=facts["command"])
    assert ended["structuredContent"]["cancelled"] == [facts["command"]]
    async with asyncio.timeout(BOUND):
        await gateway.robot.stopped.get()


async def test_a_deadline_ends_the_action(gateway: Site, operator: Caller) -> None:
    result = await operator.call("action-go", x=4, deadline=0.2)
    assert result["structuredContent"]["error"]["code"] == "deadline_exceeded"
    assert gateway.robot.stopped.qsize()


async def leave(made: Caller, tool: str, **arguments: Any) -> None:
    """Call a tool and go away once it has said something."""
    params = {"name": tool, "arguments": arguments, "meta": PROGRESS}
    headers = {"mcp-method": "tools/call", "mcp-name": tool}
    body = made.body("tools/call", params)
    with anyio.fail_after(BOUND):
        async with made.http.stream("POST", made.url, headers=headers, json=body) as response:
            async for line in response.aiter_lines():
                if line.startswith("data:"):
                    return


async def test_who_cancels_the_call_stops_the_robot(gateway: Site, operator: Caller) -> None:
    tool = (await operator.tools())["action-go"]
    assert "Cancelling the call stops the robot." in tool["description"]
    await leave(operator, "action-go", x=4)
    async with asyncio.timeout(BOUND):
        await gateway.robot.stopped.get()


async def test_an_action_keeps_going_by_rule_and_its_tool_says_so() -> None:
    async with (
        site(mcp=EVERY_TOOL + 'keeps_going = ["/action/go"]\nfeedback = 50.0') as made,
        caller(made) as client,
    ):
        tool = (await client.tools())["action-go"]
        assert "does not cancel the command" in tool["description"]
        await leave(client, "action-go", x=4)
        running = (await client.call("status"))["structuredContent"]["running"]
        assert len(running) == 1
        assert made.robot.stopped.empty()
        made.robot.release.set()
