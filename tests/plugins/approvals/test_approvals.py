"""A person has to approve what the rules say: once, for one command of one principal."""

from __future__ import annotations

import asyncio
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from configuration import key, role, rule
from kernel.world import Client, World, features_of, kept_in, world_of
from plugins.plans.planned import GO, PEOPLE, begun, code, echo, faults, go, run, states, step
from rcp_gateway.testing import SteppedClock
from rcp_kernel.config.file import parse
from rcp_kernel.errors import Forbidden, UnknownPath
from rcp_kernel.features.approval import APPROVALS
from rcp_kernel.values import Encoding
from rcp_store.tokens import TokenFile

AGENT, GUARD, OWNED = "agent-agent-agent", "guard-guard-guard", "owned-owned-owned"
BLIND = "blind-blind-blind"


async def command(client: Client, value: float = 2.0, **more: Any) -> dict[str, Any]:
    return await client.ask(type="execute", path=GO, body=value, **more)


async def decide(
    client: Client, id_: str, decision: str = "approve", **more: Any
) -> dict[str, Any]:
    body = {"id": id_, "decision": decision, **more}
    return await client.ask(type="execute", path="/system/approvals", body=body)


async def asked(client: Client) -> str:
    reply = await command(client)
    assert code(reply) == "approval_required"
    return reply["error"]["details"]["approval"]


async def listed(client: Client) -> list[dict[str, Any]]:
    return (await client.ask(type="read", path="/system/approvals"))["body"]


async def test_a_command_passes_once_when_somebody_else_has_approved_it() -> None:
    async with world_of(PEOPLE) as world:
        agent, guard = world.client(AGENT), world.client(GUARD)
        id_ = await asked(agent)
        assert await asked(agent) == id_
        assert code(await command(agent, approval=id_)) == "approval_required"
        (question,) = await listed(guard)
        assert (question["approval"], question["principal"], question["value"]) == (id_, "agent", 2)
        assert (await decide(guard, id_, reason="clear"))["body"]["by"] == "guard"
        world.robot.release.set()
        assert code(await command(agent, approval=id_)) == "completed"
        assert code(await command(agent, approval=id_)) == "forbidden"
        assert code(await command(agent)) == "approval_required"
        assert [one["status"] for one in await listed(agent)] == ["pending", "used"]


async def test_a_request_that_is_refused_for_its_id_uses_no_approval_up() -> None:
    async with world_of(PEOPLE) as world:
        agent, guard = world.client(AGENT), world.client(GUARD)
        id_ = await asked(agent)
        await decide(guard, id_)
        plan = {"steps": [{"do": "wait", "until": "param.limit > 9.0", "deadline": 20}]}
        agent.send(type="execute", path="/system/plans", body=plan, id="taken")
        await agent.until(lambda m: m.get("id") == "taken" and m.get("status") == "in_progress")
        assert code(await command(agent, approval=id_, id="taken")) == "duplicate_request"
        world.robot.release.set()
        assert code(await command(agent, approval=id_)) == "completed"


async def test_an_approval_is_for_this_value_and_this_principal() -> None:
    async with world_of(PEOPLE) as world:
        agent, other, guard = world.client(AGENT), world.client(OWNED), world.client(GUARD)
        id_ = await asked(agent)
        await decide(guard, id_)
        assert code(await command(agent, 3.0, approval=id_)) == "forbidden"
        assert code(await command(other, approval=id_)) == "forbidden"
        assert world.robot.started.empty()


async def test_what_was_rejected_is_not_asked_again_before_it_expires() -> None:
    async with world_of(PEOPLE) as world:
        agent, guard = world.client(AGENT), world.client(GUARD)
        id_ = await asked(agent)
        await decide(guard, id_, "reject", reason="people are there")
        for more in ({}, {"approval": id_}):
            reply = await command(agent, **more)
            assert code(reply) == "forbidden"
            assert "people are there" in reply["message"]


async def test_an_approval_expires(stepped: SteppedClock) -> None:
    async with world_of(PEOPLE, clock=stepped.clock) as world:
        agent, guard = world.client(AGENT), world.client(GUARD)
        await guard.ask(type="subscribe", path="/system/approvals")
        id_ = await asked(agent)
        stepped.advance(200)
        assert await asked(agent) == id_
        stepped.advance(200)
        await guard.until(
            lambda m: m["type"] == "update" and [a["status"] for a in m["body"]] == ["expired"]
        )
        assert code(await decide(guard, id_)) == "forbidden"
        assert await asked(agent) != id_


async def test_nobody_approves_what_they_asked_for_by_a_request() -> None:
    async with world_of(PEOPLE) as world:
        for token in (AGENT, OWNED):
            client = world.client(token)
            assert code(await decide(client, await asked(client))) == "forbidden"


async def test_who_may_not_decide_or_does_not_see_the_path_learns_nothing_of_it() -> None:
    async with world_of(PEOPLE) as world:
        id_ = await asked(world.client(AGENT))
        for token in ("operator-operator", BLIND):
            client = world.client(token)
            assert code(await decide(client, id_)) in ("unknown_path", "forbidden")
        assert await listed(world.client(BLIND)) == []
        assert await listed(world.client(OWNED)) == []


async def test_the_person_at_a_client_answers_for_a_role_that_may_approve_its_own() -> None:
    async with world_of(PEOPLE) as world:
        approvals = world.server.client_api.service(APPROVALS)
        assert approvals is not None
        owned, agent = world.client(OWNED), world.client(AGENT)
        own, others = await asked(owned), await asked(agent)
        approvals.answer(owned.connection.session, own, "approve", None)
        (state,) = await listed(owned)
        assert (state["status"], state["by"]) == ("approved", "owned")
        with pytest.raises(Forbidden):
            approvals.answer(agent.connection.session, others, "approve", None)
        with pytest.raises(UnknownPath):
            approvals.answer(owned.connection.session, others, "approve", None)
        approvals.answer(agent.connection.session, others, "reject", None)
        world.robot.release.set()
        assert code(await command(owned, approval=own)) == "completed"


async def test_a_dry_run_tells_that_approval_is_needed_and_asks_for_none() -> None:
    async with world_of(PEOPLE) as world:
        agent = world.client(AGENT)
        reply = await command(agent, dry_run=True)
        assert (reply["status"], reply["body"]["approval"]) == ("completed", True)
        assert await listed(agent) == []


async def test_a_write_wants_approval_too_and_what_would_be_refused_anyway_is() -> None:
    async with world_of(PEOPLE) as world:
        agent = world.client(AGENT)
        drive: dict[str, Any] = {"type": "write", "path": "/actuator/drive"}
        assert code(await agent.ask(**drive, body={"linear": {"x": 1}})) == "approval_required"
        assert code(await agent.ask(**drive, body={"linear": "fast"})) == "invalid_value"


async def test_bringing_to_rest_never_wants_approval() -> None:
    async with world_of(PEOPLE) as world:
        agent = world.client(AGENT)
        drive: dict[str, Any] = {"type": "write", "path": "/actuator/drive"}
        assert code(await agent.ask(**drive, body={})) == "completed"
        assert code(await run(agent, step("write", "/actuator/drive", {}))) == "completed"


async def test_an_estop_never_wants_approval() -> None:
    async with world_of(PEOPLE.replace('"/actuator/**"', '"/actuator/**", "/**"')) as world:
        agent = world.client(AGENT)
        assert code(await agent.ask(type="execute", path="/system/estop")) == "completed"


async def test_a_decision_is_on_record() -> None:
    async with world_of(PEOPLE) as world:
        agent, guard, admin = (world.client(t) for t in (AGENT, GUARD, "admin-admin-admin"))
        id_ = await asked(agent)
        await decide(guard, id_, reason="clear")
        world.robot.release.set()
        await command(agent, approval=id_)
        sub = admin.send(type="subscribe", path="/system/audit", body={"history": 100})
        note = await admin.until(lambda m: m.get("body", {}).get("what") == "approval")
        facts = {
            key: note["body"].get(key) for key in ("principal", "approval", "asker", "outcome")
        }
        assert facts == {
            "principal": "guard", "approval": id_, "asker": "agent", "outcome": "approved"
        }  # fmt: skip
        used = await admin.until(
            lambda m: m.get("id") == sub and m.get("body", {}).get("outcome") == "accepted"
        )
        assert used["body"]["approval"] == id_


async def test_a_plan_wants_one_approval_for_all_its_steps() -> None:
    async with world_of(PEOPLE) as world:
        agent, guard = world.client(AGENT), world.client(GUARD)
        world.robot.release.set()
        steps = (go(2.0, id="there"), echo(), go(1.0, id="back"))
        dry = await run(agent, *steps, dry_run=True)
        assert dry["body"]["approval"] == ["there", "back"]
        reply = await run(agent, *steps)
        assert code(reply) == "approval_required"
        details = reply["error"]["details"]
        assert details["steps"] == ["there", "back"]
        assert world.robot.started.empty()
        await decide(guard, details["approval"])
        done = await run(agent, *steps, approval=details["approval"])
        assert set(states(done).values()) == {"completed"}
        other = await run(agent, *steps, echo(), approval=details["approval"])
        assert code(other) == "forbidden"


async def test_an_approval_of_a_plan_is_for_what_it_means_and_shows_it() -> None:
    async with world_of(PEOPLE) as world:
        agent, guard = world.client(AGENT), world.client(GUARD)
        plan = {
            "type": "execute",
            "path": "/system/plans",
            "body": {"symbolic": "(approach go far)"},
        }
        details = (await agent.ask(**plan))["error"]["details"]
        (question,) = await listed(guard)
        (step,) = question["value"]["steps"]
        assert (step["path"], step["value"]) == ("/tenant/alpha/action/go", 2.0)
        await decide(guard, details["approval"])
        config = parse(PEOPLE.replace("metres = 2.0", "metres = 3.0"), "test")
        world.server.gateway.reconfigure(config, features_of(config))
        assert code(await agent.ask(**plan, approval=details["approval"])) == "forbidden"


async def test_an_approved_plan_lets_nothing_else_pass() -> None:
    async with world_of(PEOPLE) as world:
        agent, guard = world.client(AGENT), world.client(GUARD)
        steps = (go(2.0),)
        id_ = (await run(agent, *steps))["error"]["details"]["approval"]
        await decide(guard, id_)
        running = asyncio.create_task(run(agent, *steps, approval=id_))
        await begun(world)
        assert code(await agent.ask(type="execute", path=GO, body=2.0)) in (
            "approval_required",
            "already_running",
        )
        world.robot.release.set()
        assert (await running)["status"] == "completed"


async def test_a_plan_cannot_decide() -> None:
    async with world_of(PEOPLE) as world:
        id_ = await asked(world.client(AGENT))
        admin = world.client("admin-admin-admin")
        decision = {"id": id_, "decision": "approve"}
        step = {"do": "execute", "path": "/system/approvals", "value": decision}
        assert faults(await run(admin, step)) == {"1": "unsupported_operation"}


async def test_too_many_questions_of_one_principal_are_refused() -> None:
    async with world_of(PEOPLE) as world:
        agent = world.client(AGENT)
        codes = [code(await command(agent, float(n))) for n in range(65)]
        assert set(codes[:64]) == {"approval_required"}
        assert codes[64] == "queue_full"


async def test_requests_without_a_session_use_approvals_of_their_principal() -> None:
    async with world_of(PEOPLE) as world:
        client_api = world.server.client_api
        id_ = await asked(world.client(AGENT))
        await decide(world.client(GUARD), id_)
        world.robot.release.set()
        session = client_api.session(client_api.authenticate(AGENT))
        reply = await client_api.request(session, _request(world, id_))
        assert reply.status == "completed"


def _request(_world: World, id_: str) -> Any:
    from rcp_kernel.wire import decode_request

    data = f'{{"type": "execute", "path": "{GO}", "body": 2.0, "approval": "{id_}"}}'
    return decode_request(data.encode(), Encoding.JSON)


async def test_an_approval_expires_though_the_clock_is_set_back(stepped: SteppedClock) -> None:
    async with world_of(PEOPLE, clock=stepped.clock) as world:
        agent, guard = world.client(AGENT), world.client(GUARD)
        id_ = await asked(agent)
        assert code(await decide(guard, id_)) == "completed"
        stepped.adjust(-86_400)
        stepped.advance(400)
        assert code(await command(agent, approval=id_)) == "forbidden"
        assert world.robot.started.empty()


async def test_an_approval_expires_while_the_computer_is_suspended(stepped: SteppedClock) -> None:
    """Monotonic time stands still then."""
    async with world_of(PEOPLE, clock=stepped.clock) as world:
        agent, guard = world.client(AGENT), world.client(GUARD)
        id_ = await asked(agent)
        assert code(await decide(guard, id_)) == "completed"
        stepped.adjust(8 * 3600)
        assert code(await command(agent, approval=id_)) == "forbidden"
        assert world.robot.started.empty()


async def test_nobody_approves_with_another_credential_what_they_asked_for(tmp_path: Path) -> None:
    both = role("both", rule("*", "/**"), rule("*", "/system/**"), may_approve=True, approve=[GO])
    text = kept_in(
        tmp_path / "store.db", PEOPLE + both + key("pat", "pat-pat-pat-pat-pat", role="both")
    )
    with closing(TokenFile(tmp_path / "store.db")) as tokens:
        _, token = tokens.create("pat", (("*", ("both",)),), None)
        _, another = tokens.create("sam", (("*", ("both",)),), None)
    async with world_of(text) as world:
        id_ = await asked(world.client("pat-pat-pat-pat-pat"))
        again = world.client(token)
        reply = await decide(again, id_)
        assert code(reply) == "forbidden"
        assert "your own command" in reply["message"]
        kept = world.client(
            "pat-pat-pat-pat-pat"
        )  # nor in one session, which goes on with the token
        await kept.ask(type="hello", body={"token": token})
        assert code(await decide(kept, id_)) == "forbidden"
        assert code(await decide(world.client(another), id_)) == "completed"
