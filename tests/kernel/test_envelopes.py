"""Commands stay inside the envelopes of those who send them."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from kernel.fenced import (
    AGENT,
    BLIND,
    BOTH,
    OPERATOR,
    code,
    drive,
    fenced,
    reconfigured,
    twist,
)
from kernel.world import BOUND, World
from rcp_kernel import inforce
from rcp_kernel.conditions import RATE
from rcp_kernel.errors import DeviceRejected, DeviceTimeout
from rcp_kernel.types import Twist

pytestmark = pytest.mark.anyio

SLOW = """
[[envelopes]]
name = "slow"
paths = ["/actuator/drive"]
roles = ["agent"]
bounds = { "linear.x" = { min = -0.5, max = 0.5 }, "angular.z" = { max = 1 } }
reason = "people walk here"
"""
EDGE = """
[[envelopes]]
name = "hall"
paths = ["/actuator/**", "/action/move"]
roles = ["agent"]
fence = { of = "sensor/pose", inside = { hall = [[0, -5], [10, -5], [10, 5], [0, 5]] } }
"""
GOALS = """
[[envelopes]]
name = "goals"
paths = ["/tenant/alpha/action/move", "/action/line_up"]
fence = { point = ["pose.position.x", "pose.position.y"], inside = { hall = [[0,0],[9,0],[9,9],[0,9]] }, outside = { pit = [[4,4],[5,4],[5,5]] } }
"""


class Clock:
    """Time that a test moves."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now = 1000.0
        monkeypatch.setattr(inforce, "clock", lambda: self.now)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    return Clock(monkeypatch)


def goal(x: Any, y: Any = 1.0, **more: Any) -> dict[str, Any]:
    return {"pose": {"position": {"x": x, "y": y}}, **more}


def reached(world: World, name: str = "actuator/drive") -> list[Any]:
    writes: list[tuple[str, Any]] = world.robot.writes
    return [value for path, value in writes if path == name]


# -- bounds --------------------------------------------------------------------------------------


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


# -- rate of change ------------------------------------------------------------------------------

GENTLE = SLOW.replace("bounds =", 'rate = { "linear.x" = 1.0 }\nbounds =').replace(
    "min = -0.5, max = 0.5", "min = -5, max = 5"
)


async def test_a_change_takes_its_time(clock: Clock) -> None:
    async with fenced(GENTLE) as world:
        client = world.client(AGENT)
        refusal = await drive(client, 0.5)
        assert refusal["error"]["code"] == "out_of_range"
        assert "changes too fast: from 0.0 to 0.5 at 1 m/s/s at most" in refusal["error"]["message"]
        clock.now += 0.5
        assert code(await drive(client, 0.5)) == "completed"
        clock.now += 0.25
        refusal = await drive(client, -0.5)
        assert refusal["error"]["details"]["allowed"] == {"min": 0.25, "max": 0.75}
        assert code(await drive(client, 0.25)) == "completed"


async def test_a_long_pause_is_no_licence_for_a_jump(clock: Clock) -> None:
    async with fenced(
        GENTLE.replace("/actuator/drive", "/actuator/raw")
        .replace("linear.x", "")
        .replace('"angular.z" = { max = 1 }', "")
        .replace("5 }, ", "5 } ")
    ) as world:
        client = world.client(AGENT)
        assert code(await client.ask(type="write", path="/actuator/raw", body=0.0)) == "completed"
        clock.now += 3600
        assert (
            code(await client.ask(type="write", path="/actuator/raw", body=1.5)) == "out_of_range"
        )
        assert code(await client.ask(type="write", path="/actuator/raw", body=1.0)) == "completed"


async def test_a_change_is_measured_from_whoever_wrote_last(clock: Clock) -> None:
    async with fenced(GENTLE) as world:
        assert code(await drive(world.client(OPERATOR), 3.0)) == "completed"
        clock.now += 0.5
        agent = world.client(AGENT)
        assert code(await drive(agent, 0.5)) == "out_of_range"
        assert code(await drive(agent, 2.5)) == "completed"


async def test_after_a_stop_a_change_is_measured_from_the_safe_value(clock: Clock) -> None:
    async with fenced(GENTLE) as world:
        agent, admin = world.client(AGENT), world.client("admin-admin-admin")
        assert code(await drive(world.client(OPERATOR), 3.0)) == "completed"
        assert code(await admin.ask(type="execute", path="/system/estop", body={})) == "completed"
        await admin.ask(type="execute", path="/system/estop", body={"reset": True})
        clock.now += 0.5
        assert code(await drive(agent, 3.0)) == "out_of_range"
        assert code(await drive(agent, 0.5)) == "completed"


async def test_after_the_dead_man_a_change_is_measured_from_the_safe_value(clock: Clock) -> None:
    async with fenced(GENTLE) as world:
        watcher = world.client(OPERATOR)
        id_ = watcher.send(type="subscribe", path="/actuator/drive")
        assert code(await drive(world.client(OPERATOR), 3.0, valid_for=0.05)) == "completed"
        await watcher.until(
            lambda m: m["type"] == "update" and m["id"] == id_ and m["body"]["linear"]["x"] == 0.0
        )
        clock.now += 0.5
        assert code(await drive(world.client(AGENT), 3.0)) == "out_of_range"
        assert code(await drive(world.client(AGENT), 0.5)) == "completed"


async def test_writes_that_are_under_way_count_already(clock: Clock) -> None:
    async with fenced(GENTLE) as world:
        answered, robot = asyncio.Event(), world.robot

        async def write(name: str, value: Any) -> None:
            robot.writes.append((name, value))
            await answered.wait()

        robot.write = write
        client = world.client(AGENT)
        clock.now += 1.0
        first = client.send(type="write", path="/actuator/drive", body=twist(0.9))
        assert code(await drive(client, -0.9)) == "out_of_range"
        answered.set()
        assert code(await client.final(first)) == "completed"


async def test_a_write_that_the_robot_refused_changed_nothing(clock: Clock) -> None:
    async with fenced(
        GENTLE.replace("drive", "raw")
        .replace("linear.x", "")
        .replace('"angular.z" = { max = 1 }', "")
        .replace("5 }, ", "5 } ")
    ) as world:
        client, robot = world.client(AGENT), world.robot
        outcomes: list[Exception | None] = [None, DeviceRejected("no"), DeviceTimeout("?"), None]

        async def write(_name: str, _value: Any) -> None:
            if (error := outcomes.pop(0)) is not None:
                raise error

        robot.write = write

        async def to(value: float) -> str:
            clock.now += 1.0
            return code(await client.ask(type="write", path="/actuator/raw", body=value))

        assert await to(0.0) == "completed"
        assert await to(1.0) == "device_rejected"
        assert await to(-1.0) == "device_timeout"
        assert await to(0.5) == "out_of_range"  # it may be at -1 by now
        assert await to(-0.5) == "completed"


async def test_the_first_value_of_a_path_without_a_safe_one_is_free(clock: Clock) -> None:
    table = '[[envelopes]]\nname = "e"\npaths = ["/actuator/speeds"]\nrate = { "*" = 1.0 }\n'
    async with fenced(table) as world:
        client = world.client()
        for body, wanted in [
            ([5.0, -5.0], "completed"),
            ([5.5, -5.5], "completed"),
            ([5.5], "out_of_range"),
            ([5.5, -5.5, 0.0], "out_of_range"),
            ([5.5, -4.0], "out_of_range"),
        ]:
            reply = await client.ask(type="write", path="/actuator/speeds", body=body)
            assert code(reply) == wanted, body
            clock.now += 0.5


# -- fences --------------------------------------------------------------------------------------


async def test_a_goal_outside_the_fence_or_in_a_forbidden_area_is_refused() -> None:
    async with fenced(GOALS) as world:
        client = world.client()
        for x, y, wanted in [
            (1, 1, None),
            (9, 9, None),
            (4.5, 4.6, None),
            (9.1, 1, "field"),
            (4.7, 4.3, "pit"),
            (4, 4, "pit"),
        ]:
            envelope = {
                "type": "execute",
                "path": "/action/move",
                "body": goal(x, y),
                "dry_run": True,
            }
            reply = await client.ask(**envelope)
            assert code(reply) == ("completed" if wanted is None else "out_of_range"), (x, y)
        refusal = await client.ask(type="execute", path="/action/move", body=goal(10, 1))
        assert (
            refusal["error"]["message"] == "the place (10, 1) of action 'move' is outside of hall"
        )
        assert refusal["error"]["details"]["fence"] == ["hall"]
        assert world.robot.writes == []


async def test_a_robot_outside_its_fence_takes_no_command_of_a_fenced_role() -> None:
    async with fenced(EDGE) as world:
        agent = world.client(AGENT)
        assert code(await drive(agent, 0.1)) == "precondition_failed"
        world.robot.at(1)
        assert code(await drive(agent, 0.1)) == "completed"
        world.robot.at(11)
        refusal = await drive(agent, 0.1)
        assert refusal["error"]["message"] == "the robot at (11, 0) is outside of hall"
        assert refusal["error"]["details"]["place"] == [11.0, 0.0]
        assert code(await drive(world.client(OPERATOR), -0.1)) == "completed"
        world.robot.at(9)
        assert code(await drive(agent, 0.1)) == "completed"


async def test_where_the_robot_is_is_told_to_those_who_may_read_it() -> None:
    async with fenced(EDGE.replace('"agent"', '"blind"')) as world:
        world.robot.at(11.25)
        refusal = await drive(world.client(BLIND), 0.1)
        assert refusal["error"]["code"] == "out_of_range"
        assert "11.25" not in str(refusal)


async def test_a_place_that_is_too_old_is_not_known(monkeypatch: pytest.MonkeyPatch) -> None:
    async with fenced(EDGE.replace('"sensor/pose",', '"sensor/pose", max_age = 0.05,')) as world:
        world.robot.at(1)
        entry = world.server.gateway.registry.entries["/tenant/alpha/sensor/pose"]
        monkeypatch.setattr(entry, "_heard", entry._heard - 0.1)  # pyright: ignore[reportPrivateUsage]
        assert code(await drive(world.client(AGENT), 0.1)) == "precondition_failed"


async def test_a_robot_that_leaves_its_fence_is_stopped_at_once() -> None:
    async with fenced(EDGE) as world:
        agent, robot = world.client(AGENT), world.robot
        robot.at(9)
        assert code(await drive(agent, 0.5)) == "completed"
        robot.at(9.9)
        assert len(reached(world)) == 1
        robot.at(10.1)
        notice = await agent.notice("fence_left")
        assert notice["envelope"] == "hall"
        assert "is outside of hall" in notice["message"]
        watcher = world.client(OPERATOR)
        id_ = watcher.send(type="subscribe", path="/actuator/drive")
        await watcher.until(
            lambda m: m.get("id") == id_ and m["type"] == "update" and m["body"]["linear"]["x"] == 0
        )
        assert reached(world)[-1] == Twist()
        count = len(reached(world))
        robot.at(10.2)
        assert len(reached(world)) == count
        assert code(await drive(agent, -0.5)) == "out_of_range"


async def test_who_is_not_fenced_drives_on_outside() -> None:
    async with fenced(EDGE) as world:
        robot = world.robot
        robot.at(9)
        assert code(await drive(world.client(AGENT), 0.5)) == "completed"
        assert code(await drive(world.client(OPERATOR), 0.5)) == "completed"
        robot.at(11)
        assert not world.server.gateway.deadman._stops  # pyright: ignore[reportPrivateUsage]


async def test_an_action_that_leaves_the_fence_is_cancelled() -> None:
    async with fenced(EDGE) as world:
        agent, robot = world.client(AGENT), world.robot
        robot.at(9)
        id_ = agent.send(type="execute", path="/action/move", body=goal(20))
        await robot.started.get()
        robot.at(11)
        reply = await agent.final(id_)
        assert code(reply) == "cancelled"
        assert "is outside of hall" in reply["error"]["message"]


async def test_a_write_under_way_is_cut_short_when_the_robot_leaves_its_fence() -> None:
    async with fenced(EDGE) as world:
        agent, robot = world.client(AGENT), world.robot
        seen: asyncio.Queue[Any] = asyncio.Queue()

        async def write(_name: str, value: Any) -> None:
            seen.put_nowait(value)
            if value != Twist():
                await asyncio.Event().wait()

        robot.write = write
        robot.at(9)
        id_ = agent.send(type="write", path="/actuator/drive", body=twist(0.5))
        async with asyncio.timeout(BOUND):
            assert await seen.get() != Twist()
            robot.at(11)
            assert await seen.get() == Twist()
        assert code(await agent.final(id_)) in ("cancelled", "out_of_range")


# -- modes and queues ----------------------------------------------------------------------------

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
        assert "its mode cannot be known now" in refusal["error"]["message"]
        world.robot.host.publish("sensor/mode", "MANUAL")
        refusal = await drive(client, 0.1)
        assert refusal["error"]["message"] == (
            "/tenant/alpha/actuator/drive takes commands in the mode GUIDED, AUTO; its mode is MANUAL"
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


async def test_a_condition_refuses_unless_it_is_known_to_hold(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async with fenced(CHARGED) as world:
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
        entry = world.server.gateway.registry.entries["/tenant/alpha/sensor/level"]
        monkeypatch.setattr(entry, "_heard", entry._heard - 60)  # pyright: ignore[reportPrivateUsage]
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
        robot.host.withdraw("actuator/drive")
        robot.declare()
        assert code(await drive(client, 0.9)) == "out_of_range"


# -- dry runs ------------------------------------------------------------------------------------


async def test_a_dry_run_lists_the_envelopes_and_changes_nothing(clock: Clock) -> None:
    async with fenced(GENTLE + EDGE) as world:
        client, gateway = world.client(AGENT), world.server.gateway
        world.robot.at(1)
        clock.now += 1.0
        samples = gateway.registry.entries["/tenant/alpha/actuator/drive"].seq
        for _ in range(3):
            reply = await drive(client, 0.9, dry_run=True, idempotency_key="k")
            assert reply["body"]["envelopes"] == [
                {"envelope": "slow", "reason": "people walk here"},
                {"envelope": "hall"},
            ]
        assert code(await drive(client, 1.1, dry_run=True)) == "out_of_range"
        go = {"type": "execute", "path": "/action/move", "body": goal(1), "dry_run": True}
        assert (await client.ask(**go))["body"]["envelopes"] == [{"envelope": "hall"}]
        batch = await client.ask(type="batch", body=[go | {"id": "x"}])
        assert batch["body"][0]["dry_run"] is True
        assert world.robot.writes == []
        assert not gateway.commands.running
        assert gateway.registry.entries["/tenant/alpha/actuator/drive"].seq == samples
        assert gateway.deadman._timers == {}  # pyright: ignore[reportPrivateUsage]
        assert code(await drive(client, 0.5, idempotency_key="k")) == "completed"
