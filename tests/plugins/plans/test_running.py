"""What plans do: order, side by side, conditions, tries, fallbacks, and how they end."""

from __future__ import annotations

import asyncio
from collections.abc import Generator
from pathlib import Path
from typing import Any

import pytest

from kernel.world import BOUND, CONFIG, kept_in, world_of
from plugins.plans.planned import LIMIT, begun, code, echo, go, run, send, states, step
from rcp_gateway.testing import eventually
from rcp_kernel.model import Resource
from rcp_kernel.spi import Progress


async def test_steps_follow_each_other_and_later_ones_use_results_of_earlier_ones() -> None:
    async with world_of() as world:
        client = world.client()
        reply = await run(
            client,
            step("read", LIMIT, id="before"),
            echo("0.5", id="said"),
            step("write", LIMIT, {"$result": "before"}),
        )
        assert reply["status"] == "completed"
        assert states(reply) == {"before": "completed", "said": "completed", "3": "completed"}
        assert [one.get("result") for one in reply["body"]["steps"]] == [1.5, "0.5", 1.5]
        assert world.robot.writes == [("param/limit", 1.5)]


async def test_a_step_that_reads_more_than_a_page_says_so_and_a_later_one_reads_on() -> None:
    async with world_of() as world:
        names = [f"param/many/p{number:04}" for number in range(1348)]
        world.robot.add(
            *(Resource(name=n, description="One of many.", value=float, live=True) for n in names)
        )
        for name in names:
            world.robot.host.publish(name, 0.5)
        first = await run(world.client(), step("read", "/param/many/*"))
        (state,) = first["body"]["steps"]
        assert (len(state["result"]), state["truncated"]) == (1000, True)
        rest = {"cursor": state["cursor"]}
        last = await run(world.client(), step("read", "/param/many/*", rest))
        assert len(last["body"]["steps"][0]["result"]) == 348
        assert "truncated" not in last["body"]["steps"][0]


async def test_each_change_of_a_step_is_told_with_the_part_done() -> None:
    async with world_of() as world:
        client = world.client()
        id_ = send(client, echo(), go(2.0, id="drive"))
        reply = await client.until(
            lambda m: m.get("id") == id_ and m.get("body", {}).get("feedback") == 1.0
        )
        assert (reply["body"]["step"], reply["body"]["state"]) == ("drive", "running")
        assert (reply["status"], reply["progress"]) == ("in_progress", 0.75)
        listed = (await client.ask(type="read", path="/system/plans"))["body"][0]
        assert listed["command"] == reply["command"]
        assert [one["state"] for one in listed["steps"]] == ["completed", "running"]
        world.robot.release.set()
        assert (await client.final(id_))["body"]["steps"][1]["result"] == 2.0
        listed = (await client.ask(type="read", path="/system/plans"))["body"][0]
        assert (listed["status"], listed["steps"][1]["result"]) == ("completed", 2.0)


async def test_the_list_of_plans_can_be_subscribed_to() -> None:
    async with world_of() as world:
        client = world.client()
        sub = client.send(type="subscribe", path="/system/plans")
        await client.final(sub)
        await run(client, echo())
        while (
            not (plans := (await client.update(sub))["body"]) or plans[0]["status"] != "completed"
        ):
            pass
        assert plans[0]["steps"][0]["result"] == "here"


async def test_a_step_that_fails_ends_the_plan_with_its_code_and_every_outcome() -> None:
    async with world_of() as world:
        reply = await run(world.client(), echo(), go(14, id="stumble"), echo(id="never"))
        assert (reply["status"], code(reply)) == ("failed", "device_rejected")
        assert reply["error"]["details"]["step"] == "stumble"
        assert states(reply) == {"1": "completed", "stumble": "failed", "never": "skipped"}


async def test_a_fallback_is_run_instead_and_the_plan_goes_on() -> None:
    async with world_of() as world:
        reply = await run(world.client(), go(14, fallback=[echo("instead")]), echo("after"))
        assert reply["status"] == "completed"
        assert states(reply) == {"1": "recovered", "1.fallback.1": "completed", "2": "completed"}


async def test_a_fallback_that_is_not_needed_is_skipped() -> None:
    async with world_of() as world:
        reply = await run(world.client(), echo(fallback=[echo("instead")]))
        assert states(reply) == {"1": "completed", "1.fallback.1": "skipped"}


async def test_a_fallback_that_fails_ends_the_plan() -> None:
    async with world_of() as world:
        reply = await run(world.client(), go(14, fallback=[go(13)]), echo("after"))
        assert reply["error"]["details"]["step"] == "1.fallback.1"
        assert states(reply) == {"1": "failed", "1.fallback.1": "failed", "2": "skipped"}


async def test_a_step_is_tried_again_after_the_codes_that_it_names() -> None:
    async with world_of() as world:
        client = world.client()
        write = step("write", LIMIT, 1.0, retry={"times": 2, "on": ["device_rejected"]})
        world.robot.fail_writes = 2
        reply = await run(client, write)
        assert (reply["status"], reply["body"]["steps"][0]["tries"]) == ("completed", 3)
        world.robot.fail_writes = 3
        reply = await run(client, write)
        assert (code(reply), reply["body"]["steps"][0]["tries"]) == ("device_rejected", 3)


async def test_a_step_is_not_tried_again_after_other_codes() -> None:
    async with world_of() as world:
        world.robot.fail_writes = 1
        reply = await run(world.client(), step("write", LIMIT, 1.0, retry={"times": 5}))
        assert (code(reply), reply["body"]["steps"][0]["tries"]) == ("device_rejected", 1)


@pytest.mark.parametrize("cut", [16, 17])  # with feedback before, and without
async def test_a_step_that_the_robot_may_have_acted_on_is_not_tried_again(cut: int) -> None:
    async with world_of() as world:
        reply = await run(world.client(), go(cut, retry={"times": 3}))
        assert (code(reply), reply["body"]["steps"][0]["tries"]) == ("adapter_unavailable", 1)
        assert reply["error"]["retryable"] is False
        assert world.robot.started.qsize() == 1


async def test_a_sequence_is_tried_again_as_a_whole() -> None:
    async with world_of() as world:
        world.robot.fail_writes = 1
        steps = [echo("again"), step("write", LIMIT, 1.0)]
        retry = {"times": 1, "on": ["device_rejected"]}
        reply = await run(world.client(), {"do": "sequence", "steps": steps, "retry": retry})
        assert [one["tries"] for one in reply["body"]["steps"]] == [2, 2, 2]


async def test_steps_of_a_parallel_run_side_by_side() -> None:
    async with world_of() as world:
        client = world.client()
        line = step("execute", "/action/wait_in_line", 1)
        id_ = send(client, {"do": "parallel", "steps": [go(2.0), line]})
        assert {await begun(world), await begun(world)} == {2.0, 1}
        world.robot.release.set()
        assert (await client.final(id_))["status"] == "completed"


async def test_a_parallel_runs_no_more_at_once_than_its_limit() -> None:
    async with world_of() as world:
        client = world.client()
        cut = step("execute", "/action/cut_in", 5)  # would preempt the other, were it sent too
        again = step("execute", "/action/cut_in", 6)
        id_ = send(client, {"do": "parallel", "limit": 1, "steps": [cut, again]})
        assert await begun(world) == 5
        world.robot.release.set()
        assert await begun(world) == 6
        assert (await client.final(id_))["status"] == "completed"
        assert world.robot.stopped.qsize() == 0


async def test_the_first_failure_of_a_parallel_stops_the_others() -> None:
    async with world_of() as world:
        fails = {"do": "sequence", "steps": [echo(), step("execute", "/action/wait_in_line", 14)]}
        reply = await run(world.client(), {"do": "parallel", "steps": [go(2.0), fails]}, echo())
        assert code(reply) == "device_rejected"
        assert states(reply)["1.1"] == "cancelled"
        assert states(reply)["2"] == "skipped"
        assert world.robot.stopped.qsize() == 1


async def test_a_parallel_that_needs_any_ends_with_the_first_that_completes() -> None:
    async with world_of() as world:
        steps = [go(2.0), {"do": "sequence", "steps": [echo(), echo()]}]
        reply = await run(
            world.client(), {"do": "parallel", "need": "any", "steps": steps}, echo("after")
        )
        assert reply["status"] == "completed"
        assert (states(reply)["1.1"], states(reply)["2"]) == ("cancelled", "completed")
        assert world.robot.stopped.qsize() == 1


async def test_a_parallel_that_needs_any_fails_when_all_have() -> None:
    async with world_of() as world:
        steps = [go(14), step("execute", "/action/wait_in_line", 13)]
        reply = await run(world.client(), {"do": "parallel", "need": "any", "steps": steps})
        assert (reply["status"], code(reply)) == ("failed", "device_rejected")
        assert set(states(reply).values()) == {"failed"}


async def test_a_step_of_a_parallel_begins_after_those_that_it_names() -> None:
    async with world_of() as world:
        client = world.client()
        steps = [go(2.0, id="first"), echo("second", id="second", after=["first"])]
        id_ = send(client, {"do": "parallel", "steps": steps})
        await begun(world)
        listed = (await client.ask(type="read", path="/system/plans"))["body"][0]
        assert listed["steps"][2]["state"] == "pending"
        world.robot.release.set()
        assert states(await client.final(id_))["second"] == "completed"


async def test_a_step_does_not_begin_after_one_that_failed() -> None:
    async with world_of() as world:
        steps = [go(14, id="first"), echo("second", after=["first"]), echo("third")]
        reply = await run(world.client(), {"do": "parallel", "need": "any", "steps": steps})
        assert states(reply)["1.3"] == "completed"
        steps.pop()
        reply = await run(world.client(), {"do": "parallel", "need": "any", "steps": steps})
        assert states(reply) == {"1": "failed", "first": "failed", "1.2": "failed"}


async def test_cancel_stops_a_step_whose_first_reply_waits_for_its_record(tmp_path: Path) -> None:
    async with world_of(kept_in(tmp_path / "a.db")) as world:
        client = world.client()
        id_ = send(client, go(2.0))
        await begun(world)  # before the store has committed that the step was accepted
        await client.ask(type="cancel", path="/system/plans")
        assert (await client.final(id_))["status"] == "cancelled"
        assert world.robot.stopped.qsize() == 1


@pytest.mark.parametrize("what", ["execute", "write"])
async def test_a_long_step_whose_turn_comes_after_its_plan_was_cancelled_does_not_go_on(
    what: str,
) -> None:
    async with world_of() as world:
        client, admin = world.client(), world.client("admin-admin-admin")
        spoken, turns = list[str](), world.server.client_api.turns
        owner = client.connection.session.principal.identity

        async def speak(value: Any, progress: Progress) -> Any:
            spoken.append(value)
            await asyncio.Event().wait()

        def others(busy: list[str]) -> Generator[None]:
            while busy:
                yield

        async def has_gone() -> bool:
            reply = await admin.ask(type="read", path="/system/commands")
            return "completed" in [one["status"] for one in reply["body"]]

        world.robot.behaviours["service/echo"] = speak
        world.robot.add(Resource(name="param/text", description="A text.", value=str))
        text = "a" * 60_000
        write = step("write", "/param/text", text)
        id_ = send(client, go(2.0), echo(text) if what == "execute" else write)
        await begun(world)
        before, meanwhile = ["busy"], ["busy"]
        turns.run(owner, others(before))
        world.robot.release.set()
        await eventually(has_gone, "the first step has ended")
        await has_gone()  # and its plan waits for its turn to go on
        turns.run(owner, others(meanwhile))  # work of the same person, behind which the step waits
        before.clear()
        await client.until(lambda m: m.get("id") == id_ and m.get("body", {}).get("step") == "2")
        cancelled = client.send(type="cancel", path="/system/plans")
        await client.final(cancelled)
        meanwhile.clear()
        reply = await client.final(id_)
        assert reply["status"] == "cancelled", reply
        await asyncio.wait_for(turns.finish(owner, others([])), BOUND)
        assert not spoken
        assert not world.robot.writes
        assert not world.server.gateway.journal.running


async def test_a_step_whose_condition_does_not_hold_is_skipped() -> None:
    async with world_of() as world:
        reply = await run(
            world.client(),
            echo("yes", when="param.limit > 1.0"),
            {"do": "sequence", "when": "param.limit > 2.0", "steps": [echo("no")]},
        )
        assert states(reply) == {"1": "completed", "2": "skipped", "2.1": "skipped"}


async def test_a_condition_that_cannot_be_known_fails_its_step() -> None:
    async with world_of() as world:
        reply = await run(world.client(), echo(when="sensor.level > 0.0"))
        assert (code(reply), states(reply)) == ("precondition_failed", {"1": "failed"})


async def test_a_wait_ends_when_its_condition_holds() -> None:
    async with world_of() as world:
        client = world.client()
        wait = {"do": "wait", "until": "actuator.drive.linear.x > 0.2", "deadline": 20}
        id_ = send(client, wait, echo("then"))
        await client.until(lambda m: m.get("id") == id_ and m["status"] == "in_progress")
        await client.ask(
            type="write", path="/actuator/drive", body={"linear": {"x": 0.3}}, valid_for=20
        )
        assert states(await client.final(id_)) == {"1": "completed", "2": "completed"}


async def test_a_wait_ends_in_time() -> None:
    async with world_of() as world:
        wait = {"do": "wait", "until": "param.limit > 2.0", "deadline": 0.2}
        reply = await run(world.client(), wait)
        assert (code(reply), states(reply)) == ("deadline_exceeded", {"1": "failed"})


@pytest.mark.parametrize("group", [False, True])
async def test_a_step_that_takes_longer_than_its_deadline_is_stopped(group: bool) -> None:  # noqa: FBT001
    async with world_of() as world:
        late: dict[str, Any] = go(2.0, deadline=0.1)
        if group:
            late = {"do": "sequence", "steps": [go(2.0)], "deadline": 0.1}
        reply = await run(world.client(), late)
        assert (reply["status"], code(reply)) == ("failed", "deadline_exceeded")
        assert world.robot.stopped.qsize() == 1


async def test_the_deadline_of_the_request_ends_the_plan() -> None:
    async with world_of() as world:
        client = world.client()
        reply = await run(client, go(2.0), echo(), deadline=0.1)
        assert (reply["status"], code(reply)) == ("failed", "deadline_exceeded")
        assert states(reply) == {"1": "cancelled", "2": "skipped"}
    assert world.robot.stopped.qsize() == 1


async def test_cancel_stops_what_runs_and_begins_nothing_more() -> None:
    async with world_of() as world:
        client = world.client()
        id_ = send(client, go(2.0, fallback=[echo("no")]), echo("never"))
        await begun(world)
        asked = await client.ask(type="cancel", path="/system/plans")
        assert len(asked["body"]["cancelled"]) == 1
        reply = await client.final(id_)
        assert reply["status"] == "cancelled"
        assert states(reply) == {"1": "cancelled", "1.fallback.1": "skipped", "2": "skipped"}
        assert world.robot.stopped.qsize() == 1


async def test_an_estop_ends_plans_and_no_fallback_runs() -> None:
    async with world_of() as world:
        client, admin = world.client(), world.client("admin-admin-admin")
        id_ = send(client, go(2.0, fallback=[echo("no")]), echo("never"))
        between = send(client, {"do": "wait", "until": "param.limit > 2.0", "deadline": 20}, echo())
        await begun(world)
        await admin.ask(type="execute", path="/system/estop")
        await admin.ask(type="execute", path="/system/estop", body={"reset": True})
        for reply in (await client.final(id_), await client.final(between)):
            assert reply["status"] == "cancelled"
            assert "emergency stop" in reply["message"]
        reply = await client.ask(type="read", path="/system/commands")
        assert not [c for c in reply["body"] if c["path"].endswith("echo")]


async def test_a_plan_is_refused_under_a_latched_estop() -> None:
    async with world_of() as world:
        client = world.client()
        await client.ask(type="execute", path="/system/estop")
        assert code(await run(client, go(2.0))) == "estop_active"


async def test_a_repeat_under_the_same_key_runs_nothing() -> None:
    async with world_of() as world:
        client = world.client()
        first = await run(client, step("write", LIMIT, 1.0), idempotency_key="k")
        again = await run(client, step("write", LIMIT, 1.0), idempotency_key="k")
        assert again["command"] == first["command"]
        assert len(world.robot.writes) == 1


async def test_steps_wait_for_a_quota_of_requests() -> None:
    text = CONFIG + "\n[quotas.principal]\nrequests = 20\nburst = 2\n"
    async with world_of(text) as world:
        reply = await run(world.client(), *(echo(str(n)) for n in range(5)))
        assert reply["status"] == "completed"


async def test_no_more_plans_of_a_tenant_run_than_may() -> None:
    async with world_of(CONFIG + "\n[plans]\nrunning = 1\n") as world:
        client = world.client()
        id_ = send(client, go(2.0))
        await begun(world)
        assert code(await run(client, echo())) == "queue_full"
        world.robot.release.set()
        await client.final(id_)
        assert code(await run(client, echo())) == "completed"


async def test_a_quota_of_plans_holds_for_a_principal() -> None:
    async with world_of(CONFIG + "\n[quotas.principal]\nplans = 1\n") as world:
        client, other = world.client(), world.client("admin-admin-admin")
        id_ = send(client, go(2.0))
        await begun(world)
        reply = await run(client, echo())
        assert reply["error"]["details"] == {"quota": "principal", "what": "plans", "limit": 1}
        assert code(await run(other, echo())) == "completed"
        world.robot.release.set()
        await client.final(id_)
        assert code(await run(client, echo())) == "completed"


async def test_a_result_that_is_too_long_is_told_by_its_length_and_can_be_used() -> None:
    async with world_of() as world:
        text = "x" * 300_000
        body = {"steps": [echo(text, id="long"), echo({"$result": "long"})]}
        text_size = CONFIG + "\n[plans]\nsize = 1000000\n"
        async with world_of(text_size) as roomy:
            client = roomy.client()
            reply = await client.ask(type="execute", path="/system/plans", body=body)
        assert [one["omitted"] for one in reply["body"]["steps"]] == [300_002, 300_002]
        reply = await world.client().ask(type="execute", path="/system/plans", body=body)
        assert code(reply) == "payload_too_large"


async def test_a_lease_that_an_earlier_step_acquires_counts() -> None:
    text = CONFIG + '\n[safety]\nlease_required = ["/action/**"]\n'
    async with world_of(text) as world:
        client = world.client()
        acquire = step(
            "execute", "/system/leases", {"do": "acquire", "scope": "/action", "ttl": 30}
        )
        assert code(await run(client, go(2.0))) == "lease_required"
        world.robot.release.set()
        reply = await run(client, acquire, go(2.0))
        assert states(reply) == {"1": "completed", "2": "completed"}
