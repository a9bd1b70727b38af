"""A plan is checked whole before its first step, and everything that is wrong is told at once."""

from __future__ import annotations

from itertools import count
from typing import Any

import pytest

from kernel.world import CONFIG, Client, world_of
from plugins.plans.planned import (
    LIMIT,
    PEOPLE,
    begun,
    code,
    echo,
    faults,
    go,
    run,
    send,
    states,
    step,
)

HALF = "half-half-half-half"


async def test_more_faults_than_are_listed_are_counted() -> None:
    async with world_of() as world:
        wrong = [step("read", f"/sensor/none{number}") for number in range(130)]
        details = (await run(world.client(), *wrong))["error"]["details"]
        assert (len(details["faults"]), details["truncated"], details["count"]) == (100, True, 130)


async def plan(client: Client, **body: Any) -> dict[str, Any]:
    return await client.ask(type="execute", path="/system/plans", body=body)


async def test_everything_that_is_wrong_is_told_at_once_and_nothing_is_begun() -> None:
    async with world_of() as world:
        reply = await run(
            world.client(),
            step("write", LIMIT, 1.0),
            step("read", "/param/limt", id="typo"),
            step("write", LIMIT, 9, id="bound"),
            step("execute", "/action/go", "far", id="type"),
            step("read", "/action/go", id="operation"),
            step("write", LIMIT, {"$result": "bond/x"}, id="reference"),
            echo(when="sensor.levle > 0.0", id="condition"),
            echo(when="sensor.level >", id="syntax"),
            step("execute", "/system/plans", {"steps": []}, id="nested"),
            echo(id="twice"),
            echo(id="twice"),
            echo(after=["typo"], id="order"),
            echo(retry={"times": 1, "on": ["device_rejectd"]}, id="code"),
        )
        assert faults(reply) == {
            "typo": "unknown_path",
            "bound": "out_of_range",
            "type": "invalid_value",
            "operation": "unsupported_operation",
            "reference": "invalid_value",
            "condition": "unknown_path",
            "syntax": "invalid_value",
            "nested": "unsupported_operation",
            "twice": "duplicate_request",
            "order": "bad_request",
            "code": "invalid_value",
        }
        near = {
            f["step"]: f.get("details", {}).get("near") for f in reply["error"]["details"]["faults"]
        }
        assert near["typo"] == ["/tenant/alpha/param/limit"]
        assert near["reference"] == ["bound"]
        assert near["code"][0] == "device_rejected"
        assert world.robot.writes == []


async def test_a_dry_run_tells_what_would_be_sent_and_changes_nothing() -> None:
    async with world_of() as world:
        client = world.client()
        reply = await run(client, step("write", LIMIT, 1.0), go(2.0, id="there"), dry_run=True)
        assert reply["dry_run"] is True
        assert reply["body"]["steps"] == [
            {"step": "1", "do": "write", "path": "/tenant/alpha/param/limit", "value": 1.0},
            {"step": "there", "do": "execute", "path": "/tenant/alpha/action/go", "value": 2.0},
        ]
        assert (await client.ask(type="read", path="/system/plans"))["body"] == []
        assert world.robot.writes == []
        assert code(await run(client, step("write", LIMIT, 9), dry_run=True)) == "out_of_range"


async def test_a_plan_has_one_notation_and_some_steps() -> None:
    async with world_of() as world:
        client = world.client()
        for body in ({}, {"steps": []}, {"lines": "# nothing"}, {"lines": "", "symbolic": ""}):
            assert code(await plan(client, **body)) == "invalid_value"
        assert code(await plan(client, step=[echo()])) == "invalid_value"


async def test_bounds_of_steps_and_depth_hold() -> None:
    async with world_of(CONFIG + "\n[plans]\nsteps = 3\ndepth = 2\n") as world:
        client = world.client()
        assert code(await run(client, echo(), echo(), echo())) == "completed"
        assert code(await run(client, *[echo()] * 4)) == "out_of_range"
        deep = {"do": "sequence", "steps": [{"do": "sequence", "steps": [echo()]}]}
        assert code(await run(client, deep)) == "out_of_range"


@pytest.mark.parametrize(
    ("steps", "wrong"),
    [
        ([{"$result": "later"}, 1.0], "1"),
        ([1.0, {"$result": "1/distance"}], "later"),
    ],
)
async def test_a_reference_has_to_lead_to_a_result_that_is_there(
    steps: list[Any], wrong: str
) -> None:
    async with world_of() as world:
        first, later = (step("write", LIMIT, value) for value in steps)
        reply = await run(world.client(), first, later | {"id": "later"})
        assert faults(reply) == {wrong: "invalid_value"}


async def test_a_step_of_a_parallel_uses_results_of_those_after_which_it_runs() -> None:
    async with world_of() as world:
        read = step("read", LIMIT, id="read")
        write = step("write", LIMIT, {"$result": "read"})
        beside = {"do": "parallel", "steps": [read, write]}
        assert faults(await run(world.client(), beside)) == {"1.2": "invalid_value"}
        after = {"do": "parallel", "steps": [read, write | {"after": ["read"]}]}
        assert (await run(world.client(), after))["status"] == "completed"


async def test_a_result_that_is_missing_at_its_turn_fails_the_step() -> None:
    async with world_of() as world:
        read = step("read", LIMIT, id="read", when="param.limit > 2.0")
        reply = await run(world.client(), read, step("write", LIMIT, {"$result": "read"}))
        assert (code(reply), states(reply)["2"]) == ("precondition_failed", "failed")


async def test_a_step_may_do_only_what_its_sender_may() -> None:
    async with world_of(PEOPLE) as world:
        half = world.client(HALF)
        reply = await run(half, echo(), go(2.0), step("write", "/actuator/drive", {}))
        assert faults(reply) == {"2": "unknown_path", "3": "unknown_path"}
        assert code(await run(half, echo(when="sensor.level > 0.0"))) == "unknown_path"


async def test_what_is_hidden_is_not_among_the_names_that_are_near() -> None:
    async with world_of(PEOPLE) as world:
        reply = await run(world.client(HALF), step("execute", "/action/goo", 1.0))
        hidden = await run(world.client(HALF), step("execute", "/action/go", 1.0))
        for one in (reply, hidden):
            (fault,) = one["error"]["details"]["faults"]
            assert "near" not in fault.get("details", {})
        symbolic = await plan(world.client(HALF), symbolic="(goo alpha 1.0)")
        assert "'go'" not in str(symbolic)


async def test_others_see_a_plan_only_if_they_may_see_all_that_it_is_about() -> None:
    async with world_of(PEOPLE) as world:
        operator, half, guard = (
            world.client(t) for t in ("operator-operator", HALF, "admin-admin-admin")
        )
        id_ = send(operator, echo(), go(2.0))
        await begun(world)
        assert (await half.ask(type="read", path="/system/plans"))["body"] == []
        (seen,) = (await guard.ask(type="read", path="/system/plans"))["body"]
        reply = await half.ask(type="cancel", command=seen["command"])
        assert code(reply) == "unknown_path"
        reply = await half.ask(type="cancel", path="/system/plans")
        assert reply["body"]["cancelled"] == []
        reply = await guard.ask(type="cancel", command=seen["command"])
        assert reply["body"]["cancelled"] == [seen["command"]]
        assert (await operator.final(id_))["status"] == "cancelled"


async def test_a_value_in_a_plan_is_shown_to_who_may_read_it_alone() -> None:
    async with world_of(PEOPLE) as world:
        operator, half = world.client(), world.client(HALF)
        world.robot.host.publish("sensor/level", 1.0)
        await run(operator, step("read", "/sensor/*"))
        assert (await half.ask(type="read", path="/system/plans"))["body"] == []
        await run(operator, step("read", "/param/*"))
        (seen,) = (await half.ask(type="read", path="/system/plans"))["body"]
        assert seen["steps"][0]["path"] == "/tenant/alpha/param/*"


async def test_lines_of_the_command_syntax_are_a_plan() -> None:
    async with world_of() as world:
        lines = """
            # to the dock
            READ /tenant/alpha/param/limit
            write /param/limit 1.25
            execute /service/echo "done"
        """
        reply = await plan(world.client(), lines=lines)
        assert [one.get("result") for one in reply["body"]["steps"]] == [1.5, 1.25, "done"]


async def test_pairs_in_a_line_are_the_fields_of_a_value() -> None:
    async with world_of() as world:
        reply = await plan(world.client(), lines="write /actuator/drive linear.x=0.5 angular.z=0")
        assert reply["body"]["steps"][0]["result"]["linear"] == {"x": 0.5, "y": 0.0, "z": 0.0}


async def test_what_is_no_line_is_told_by_its_number() -> None:
    async with world_of() as world:
        lines = "execute /service/echo hi there\nfly /action/go 1\nwrite /param/limit\nread"
        assert faults(await plan(world.client(), lines=lines)) == {
            "line 1": "invalid_value",
            "line 2": "bad_request",
            "line 3": "invalid_value",
            "line 4": "bad_request",
        }


async def test_a_symbolic_plan_is_translated_by_the_table_and_by_the_schemas() -> None:
    async with world_of(PEOPLE) as world:
        world.robot.release.set()
        text = (
            "; by a planner\n(set_limit 1.25)\n(approach go far) (echo robot hello)\n(GO alpha 1.5)"
        )
        reply = await plan(world.client(), symbolic=text)
        steps = [
            (s["path"].removeprefix("/tenant/alpha"), s["result"]) for s in reply["body"]["steps"]
        ]
        assert steps == [
            ("/param/limit", 1.25),
            ("/action/go", 2.0),
            ("/service/echo", "hello"),
            ("/action/go", 1.5),
        ]


async def test_what_a_symbolic_plan_gets_wrong_is_told_by_its_line() -> None:
    async with world_of(PEOPLE) as world:
        text = (
            "(approach)\n(approach ../x far)\n(echoo alpha hi)\n(echo gamma hi)\n(go alpha 1 2)\ngo"
        )
        reply = await plan(world.client(), symbolic=text)
        assert faults(reply) == {
            "line 1": "invalid_value",
            "line 2": "invalid_path",
            "line 3": "unknown_path",
            "line 4": "unknown_path",
            "line 5": "invalid_value",
            "line 6": "bad_request",
        }
        near = reply["error"]["details"]["faults"][3]["details"]["near"]
        assert near == ["echo"]


async def test_times_let_actions_overlap_and_keep_those_apart_that_do_not() -> None:
    async with world_of(PEOPLE) as world:
        client = world.client()
        text = """
            0.000: (go alpha 2.0) [5.000]
            0.000: (echo alpha early) [2.000]
            2.001: (wait_in_line alpha 1) [2.000]
            5.002: (echo alpha late) [1.000]
        """
        id_ = client.send(type="execute", path="/system/plans", body={"symbolic": text})
        assert {await begun(world), await begun(world)} == {2.0, 1}
        (seen,) = (await client.ask(type="read", path="/system/plans"))["body"]
        assert [s["state"] for s in seen["steps"][1:]] == [
            "running",
            "completed",
            "running",
            "pending",
        ]
        world.robot.release.set()
        assert set(states(await client.final(id_)).values()) == {"completed"}


async def test_a_condition_that_costs_too_much_is_refused_with_the_way_out() -> None:
    dear = "sensor.level.all(x, " * 40 + "true" + ")" * 40
    async with world_of() as world:
        wait = {"do": "wait", "until": dear, "deadline": 5, "id": "dear"}
        reply = await run(world.client(), wait)
        assert (reply["status"], code(reply)) == ("rejected", "out_of_range")
        fault = reply["error"]["details"]["faults"][0]
        assert (fault["step"], fault["details"]["pointer"]) == ("dear", "/until")
        assert "too costly" in fault["message"]
        assert "fewer comprehensions" in fault["remedy"]


async def test_all_conditions_of_a_plan_together_are_bounded() -> None:
    texts = [f"sensor.level > {n}.0 || '{'a' * 90}' == 'b'" for n in range(150)]
    async with world_of() as world:
        reply = await run(world.client(), *(echo(when=text) for text in texts))
        assert code(reply) == "out_of_range"
        assert "the plan's conditions" in reply["error"]["message"]
        assert (await run(world.client(), *(echo(when="param.limit > 9.0") for _ in texts)))[
            "status"
        ] == "completed"


async def test_who_sends_new_conditions_without_end_is_told_to_wait(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # Each reading takes 0.1 s of the processor: 20 of them use up the next 20 s, however slow the
    # machine is. Dry runs, so that no condition is looked at.
    monkeypatch.setattr("rcp_plans.pace.thread_time", count(0.0, 0.1).__next__)
    async with world_of() as world:
        client = world.client()
        steps = [echo(when=f"1 == {n}") for n in range(20)]
        assert code(await run(client, *steps, dry_run=True)) == "completed"
        assert code(await run(client, *steps, dry_run=True)) == "rate_limited"
        assert code(await run(world.client("admin-admin-admin"), echo(when="true"))) == "completed"
