"""Approval: a person at the client decides, by rule; the model has no part in it."""

from __future__ import annotations

import json
from collections.abc import AsyncGenerator
from typing import Any

import pytest

from configuration import key, role, rule
from plugins.mcp.rig import Caller, Site, caller, site

AGENT, CAREFUL = "agent-of-these-tests", "careful-agent-of-these-tests"
RULES = (
    role("asking", rule("*", "/**"), approve=["/action/go", "/param/limit"], approve_own=True)
    + role("careful", rule("*", "/**"), approve=["/action/go"])
    + key("agent", "agent-of-these-tests", role="asking", tenants=["alpha"])
    + key("careful", "careful-agent-of-these-tests", tenants=["alpha"])
    + key("boss", "boss-of-these-tests", role="admin")
)
GO: dict[str, Any] = {"name": "action-go", "arguments": {"x": 1}}
YES = {"action": "accept", "content": {"approve": True}}


@pytest.fixture
async def made() -> AsyncGenerator[Site]:
    async with site(more=RULES) as found:
        found.robot.release.set()
        yield found


@pytest.fixture
async def agent(made: Site) -> AsyncGenerator[Caller]:
    async with caller(made, AGENT, elicitation={}) as client:
        yield client


def code(result: dict[str, Any]) -> str:
    return result["structuredContent"]["error"]["code"]


async def test_the_person_at_the_client_is_asked_and_lets_it_pass(
    made: Site, agent: Caller
) -> None:
    reply = await agent.ask("tools/call", **GO)
    assert reply["resultType"] == "input_required"
    question = reply["inputRequests"]["approval"]
    assert question["method"] == "elicitation/create"
    assert '/tenant/alpha/action/go with {"x":1}' in question["params"]["message"]
    assert made.robot.started.empty()
    done = await agent.ask(
        "tools/call", **GO, inputResponses={"approval": YES}, requestState=reply["requestState"]
    )
    assert done["structuredContent"]["status"] == "completed"
    again = await agent.ask("tools/call", **GO)
    assert again["resultType"] == "input_required"


async def test_a_tool_says_whether_it_may_want_approval(agent: Caller) -> None:
    tools = await agent.tools()
    assert "approval" in tools["action-go"]["inputSchema"]["properties"]
    assert "approval" not in tools["service-double"]["inputSchema"]["properties"]


async def test_a_write_is_asked_about_too(made: Site, agent: Caller) -> None:
    write = {"name": "write", "arguments": {"path": "/param/limit", "value": 2}}
    reply = await agent.ask("tools/call", **write)
    assert made.robot.writes == []
    await agent.ask(
        "tools/call", **write, inputResponses={"approval": YES}, requestState=reply["requestState"]
    )
    assert made.robot.writes == [("param/limit", 2.0)]


@pytest.mark.parametrize(
    "answer",
    [
        {"action": "decline"},
        {"action": "accept", "content": {"approve": False}},
        {"action": "accept", "content": {"approve": "yes"}},
        {"action": "accept"},
    ],
)
async def test_anything_but_a_yes_is_a_no(
    made: Site, agent: Caller, answer: dict[str, Any]
) -> None:
    reply = await agent.ask("tools/call", **GO)
    done = await agent.ask(
        "tools/call", **GO, inputResponses={"approval": answer}, requestState=reply["requestState"]
    )
    assert code(done) == "forbidden"
    assert made.robot.started.empty()
    assert code(await agent.ask("tools/call", **GO)) == "forbidden"


async def test_an_answer_counts_for_what_was_asked_only(made: Site, agent: Caller) -> None:
    reply = await agent.ask("tools/call", **GO)
    state, answers = reply["requestState"], {"approval": YES}
    other = {"name": "action-go", "arguments": {"x": 2}}
    refused = await agent.send("tools/call", **other, inputResponses=answers, requestState=state)
    assert refused["error"]["code"] == -32602
    forged = await agent.send(
        "tools/call", **GO, inputResponses=answers, requestState=state[:-2] + "AA"
    )
    assert forged["error"]["code"] == -32602
    async with caller(made, CAREFUL, elicitation={}) as stranger:
        stolen = await stranger.send("tools/call", **GO, inputResponses=answers, requestState=state)
        assert stolen["error"]["code"] == -32602
    assert made.robot.started.empty()


async def test_where_the_rules_want_another_person_nobody_is_asked_here(made: Site) -> None:
    async with (
        caller(made, CAREFUL, elicitation={}) as careful,
        caller(made, "boss-of-these-tests") as boss,
    ):
        refused = await careful.call("action-go", x=1)
        assert code(refused) == "approval_required"
        id_ = refused["structuredContent"]["error"]["details"]["approval"]
        assert code(await careful.call("action-go", x=1, approval=id_)) == "approval_required"
        decision = {"id": id_, "decision": "approve"}
        await boss.call("execute", path="/system/approvals", input=decision)
        done = await careful.call("action-go", x=1, approval=id_)
        assert done["structuredContent"]["status"] == "completed"


async def test_a_client_that_cannot_ask_is_told_what_else_there_is(made: Site) -> None:
    async with caller(made, AGENT) as silent:
        refused = await silent.call("action-go", x=1)
        assert code(refused) == "approval_required"
        assert "approval" in refused["structuredContent"]["error"]["remedy"]
        assert "requestState" not in json.dumps(refused)
