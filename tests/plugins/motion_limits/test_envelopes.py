"""Commands stay inside the envelopes of those who send them."""

from __future__ import annotations

from typing import Any

import pytest

from kernel.fenced import (
    AGENT,
    BLIND,
    BOTH,
    GOALS,
    OPERATOR,
    SLOW,
    code,
    drive,
    fenced,
    goal,
    reached,
    reconfigured,
)
from rcp_gateway.testing import SteppedClock
from rcp_kernel.access.conditions import RATE

pytestmark = pytest.mark.anyio


async def test_a_field_beyond_its_bound_is_refused_with_whose_bound_and_why() -> None:
    async with fenced(SLOW) as world:
        client = world.client(AGENT)
        assert code(await drive(client, 0.5, -7.0)) == "completed"
        refusal = await drive(client, 0.6)
        assert refusal["status"] == "rejected"
        assert refusal["error"]["message"] == (
            "field 'linear.x' of actuator 'drive' exceeds allowed range: "
            "0.6 > 0.5 m/s (people walk here)"
        )
        assert refusal["error"]["details"] == {
            "field": "linear.x",
            "pointer": "/linear/x",
            "value": 0.6,
            "unit": "m/s",
            "bound": "<= 0.5",
            "envelope": "slow",
            "reason": "people walk here",
        }
        assert code(await drive(client, 0.0, 1.01)) == "out_of_range"
        assert len(reached(world)) == 1


async def test_an_envelope_holds_those_who_have_one_of_its_roles() -> None:
    async with fenced(SLOW) as world:
        assert code(await drive(world.client(OPERATOR), 2.0)) == "completed"
        assert code(await drive(world.client(AGENT), 2.0)) == "out_of_range"
        assert code(await drive(world.client(BOTH), 2.0)) == "out_of_range"


async def test_an_envelope_without_roles_holds_everybody() -> None:
    async with fenced(SLOW.replace('roles = ["agent"]', "")) as world:
        assert code(await drive(world.client(OPERATOR), 2.0)) == "out_of_range"


async def test_bringing_to_rest_is_never_refused() -> None:
    forward = SLOW.replace("min = -0.5", "min = 0.2") + 'modes = ["AUTO"]\n'
    async with fenced(forward) as world:
        client = world.client(AGENT)
        assert code(await drive(client, 0.1)) == "mode_forbids"
        assert code(await drive(client, 0.0)) == "completed"


@pytest.mark.parametrize(
    ("path", "bounds", "good", "bad"),
    [
        ("speeds", '"*" = { max = 1 }', [[], [1, 0.5]], [[0, 1.1], [2]]),
        ("speeds", '"1" = { max = 1 }', [[5, 1]], [[0, 1.1], [0]]),
        ("raw", '"" = { min = -1 }', [-1, 1e300], [-1.1, "NaN", "Infinity", "-Infinity"]),
        (
            "arm",
            '"allJoints.*.velocity" = { max = 1 }',
            [{"allJoints": [{"velocity": 1}, {}]}],
            [{"allJoints": [{}, {"velocity": 2}]}],
        ),
        (
            "arm",
            '"topSpeed" = { max = 1 }',
            [{"allJoints": [], "topSpeed": 1}],
            [{"allJoints": [], "topSpeed": 2}, {"allJoints": []}],
        ),
        (
            "arm",
            '"topSpeed" = { max = 1, optional = true }',
            [{"allJoints": []}],
            [{"allJoints": [], "topSpeed": 2}],
        ),
        (
            "any",
            '"a.b" = { max = 1 }',
            [{"a": {"b": 1}}],
            [{}, {"a": 1}, {"a": {"b": "1"}}, {"a": {"b": True}}, {"a": {"b": 2}}, {"a": None}],
        ),
        ("any", '"*.v" = { max = 1 }', [{"p": {"v": 1}}], [{"p": {"v": 1}, "q": {"v": 2}}]),
        ("grip", '"" = { allow = ["open", "shut"] }', ["open"], ["squeeze"]),
        (
            "any",
            '"a" = { allow = [1, "x", true] }',
            [{"a": 1}, {"a": 1.0}, {"a": True}],
            [{"a": 0}],
        ),
        ("any", '"a" = { allow = [1] }', [{"a": 1}], [{"a": True}, {"a": "1"}, {}]),
    ],
)
async def test_bounds_reach_into_every_kind_of_value(
    path: str, bounds: str, good: list[Any], bad: list[Any]
) -> None:
    table = f'[[envelopes]]\nname = "e"\npaths = ["/actuator/{path}"]\nbounds = {{ {bounds} }}\n'
    async with fenced(table) as world:
        client = world.client()
        for value in good:
            reply = await client.ask(type="write", path=f"/actuator/{path}", body=value)
            assert code(reply) == "completed", (value, reply)
        for value in bad:
            reply = await client.ask(type="write", path=f"/actuator/{path}", body=value)
            assert code(reply) == "out_of_range", (value, reply)
        assert len(reached(world, f"actuator/{path}")) == len(good)


async def test_long_integers_are_compared_exactly() -> None:
    table = '[[envelopes]]\nname = "e"\npaths = ["/param/count"]\nbounds = { "" = { max = 9007199254740992 } }\n'
    async with fenced(table) as world:
        client = world.client()
        for body, wanted in [
            ("9007199254740992", "completed"),
            ("9007199254740993", "out_of_range"),
            ("9223372036854775807", "out_of_range"),
        ]:
            assert code(await client.ask(type="write", path="/param/count", body=body)) == wanted


async def test_an_envelope_that_does_not_fit_its_path_lets_nothing_through_and_says_so() -> None:
    odd = SLOW.replace("linear.x", "linear.w")
    async with fenced(odd) as world:
        refusal = await drive(world.client(AGENT), 0.1)
        assert refusal["error"]["code"] == "precondition_failed"
        assert "actuator 'drive' has no field 'linear.w'" in refusal["error"]["message"]
        assert code(await drive(world.client(OPERATOR), 0.1)) == "completed"
        status = (await world.client(OPERATOR).ask(type="status"))["body"]
        assert status["state"] == "degraded"
        assert status["envelopes"] == {
            "/tenant/alpha/actuator/drive": ["slow: actuator 'drive' has no field 'linear.w'"]
        }
        await reconfigured(world, SLOW)
        assert code(await drive(world.client(AGENT), 0.1)) == "completed"
        status = (await world.client(OPERATOR).ask(type="status"))["body"]
        assert (status["state"], status["envelopes"]) == ("ok", {})


GUIDED = """
[[envelopes]]
name = "guided"
paths = ["/actuator/drive"]
modes = ["GUIDED", "AUTO"]
"""


async def test_a_mode_that_is_not_named_or_not_known_forbids() -> None:
    async with fenced(GUIDED) as world:
        client = world.client()
        refusal = await drive(client, 0.1)
        assert refusal["error"]["code"] == "mode_forbids"
        assert "its mode is unknown" in refusal["error"]["message"]
        world.robot.host.publish("sensor/mode", "MANUAL")
        refusal = await drive(client, 0.1)
        assert refusal["error"]["message"] == (
            "/tenant/alpha/actuator/drive accepts commands in mode GUIDED, AUTO; its mode is MANUAL"
        )
        assert refusal["error"]["details"]["mode"] == "MANUAL"
        world.robot.host.publish("sensor/mode", "AUTO")
        assert code(await drive(client, 0.1)) == "completed"


CHARGED = """
[[envelopes]]
name = "charged"
paths = ["/actuator/drive", "/action/line_up"]
when = "sensor.level > 1.0"
"""


async def test_a_condition_refuses_unless_it_is_known_to_hold(stepped: SteppedClock) -> None:
    async with fenced(CHARGED, stepped.clock) as world:
        client, publish = world.client(), world.robot.host.publish
        refusal = await drive(client, 0.1)
        assert refusal["error"]["code"] == "precondition_failed"
        assert refusal["error"]["message"] == (
            "the condition sensor.level > 1.0 does not hold: sensor.level is unknown"
        )
        publish("sensor/level", 0.5)
        refusal = await drive(client, 0.1)
        assert refusal["error"]["details"]["values"] == {"sensor.level": 0.5}
        publish("sensor/level", 2.0)
        assert code(await drive(client, 0.1)) == "completed"
        stepped.advance(60)
        assert code(await drive(client, 0.1)) == "precondition_failed"
        assert code(await drive(client, 0.0)) == "completed"


async def test_what_a_condition_is_about_is_told_to_those_who_may_read_it() -> None:
    async with fenced(CHARGED) as world:
        world.robot.host.publish("sensor/level", 0.5)
        refusal = await drive(world.client(BLIND), 0.1)
        assert refusal["error"]["code"] == "precondition_failed"
        assert "level" not in str(refusal)
        assert "0.5" not in str(refusal)


async def test_a_condition_that_ceases_to_hold_refuses_what_waits() -> None:
    async with fenced(CHARGED) as world:
        client, robot = world.client(), world.robot
        robot.host.publish("sensor/level", 2.0)
        first = client.send(type="execute", path="/action/line_up", body=goal(1))
        second = client.send(type="execute", path="/action/line_up", body=goal(2))
        await client.until(lambda m: m.get("id") == second and m.get("status") == "pending")
        robot.host.publish("sensor/level", 0.5)
        robot.release.set()
        assert code(await client.final(first)) == "completed"
        assert code(await client.final(second)) == "precondition_failed"
        assert len(reached(world, "action/line_up")) == 1


async def test_sensors_that_envelopes_ask_for_are_kept_running() -> None:
    async with fenced("") as world:
        robot = world.robot
        assert ("sensor/mode", RATE) not in robot.watched
        await reconfigured(world, GUIDED)
        await drive(world.client(), 0.1)
        assert ("sensor/mode", RATE) in robot.watched
        await reconfigured(world, "")
        await drive(world.client(), 0.1)
        assert ("sensor/mode", RATE) in robot.left


async def test_a_command_that_waited_is_checked_again_when_its_turn_comes() -> None:
    async with fenced(GOALS) as world:
        client, robot = world.client(), world.robot
        first = client.send(type="execute", path="/action/line_up", body=goal(1))
        second = client.send(type="execute", path="/action/line_up", body=goal(8))
        await client.until(lambda m: m.get("id") == second and m.get("status") == "pending")
        await reconfigured(world, GOALS.replace("[9,", "[5,"))
        robot.release.set()
        assert code(await client.final(first)) == "completed"
        assert code(await client.final(second)) == "out_of_range"
        assert [value.pose.position.x for _, value in robot.writes] == [1.0]


async def test_a_reload_of_envelopes_acts_at_once() -> None:
    async with fenced("") as world:
        client = world.client(AGENT)
        assert code(await drive(client, 0.9)) == "completed"
        await reconfigured(world, SLOW)
        assert code(await drive(client, 0.9)) == "out_of_range"
        await reconfigured(world, SLOW.replace("0.5", "1.5"))
        assert code(await drive(client, 0.9)) == "completed"
        await reconfigured(world, "")
        assert code(await drive(client, 9.0)) == "completed"


async def test_a_resource_that_is_declared_anew_is_bound_anew() -> None:
    async with fenced(SLOW) as world:
        client, robot = world.client(AGENT), world.robot
        robot.remove("actuator/drive")
        robot.declare()
        assert code(await drive(client, 0.9)) == "out_of_range"
