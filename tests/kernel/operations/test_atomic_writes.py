"""Writes of several paths of one robot as one: all of them act, or none does."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from typing import Any

import pytest

from configuration import backend, key
from kernel.fenced import code
from kernel.world import BOUND, CONFIG, Client, Robot, World, kept_in, world_of
from plugins.plans.planned import PEOPLE
from rcp_kernel.errors import AdapterUnavailable, DeviceRejected, DeviceTimeout
from rcp_kernel.model import Resource
from rcp_kernel.types import quantity

pytestmark = pytest.mark.anyio
SPEED = quantity("m/s", ge=-2, le=2)
WHEEL = {"value": SPEED, "safe": 0.0, "valid_for": 5.0, "atomic": "wheels"}
WHEELS = ("actuator/left", "actuator/right")
LEFT, RIGHT = (f"/tenant/alpha/{name}" for name in WHEELS)
BOTH = {"/actuator/left": 1.0, "/actuator/right": 0.5}
ADMIN = "admin-admin-admin"


class TwoWheels(Robot):
    """Has two wheels, and more that is not part of their group."""

    def declare(self) -> None:
        super().declare()
        self.add(
            *(Resource(name=name, description="A wheel.", **WHEEL) for name in WHEELS),
            Resource(name="param/trim", description="A trim.", value=SPEED, atomic="wheels"),
            Resource(name="param/other", description="Another.", value=SPEED, atomic="others"),
        )


class Flushes(Client):
    """Notes how many messages come at a time."""

    def __init__(self, *arguments: Any) -> None:
        self.sizes: list[int] = []
        super().__init__(*arguments)

    def _flush(self) -> None:
        before = len(self.inbox)
        super()._flush()
        self.sizes.append(len(self.inbox) - before)


async def busy(value: Any) -> Any:
    """Refuse a value."""
    raise DeviceRejected("the drive is switched off")


@pytest.fixture
async def wheels() -> AsyncGenerator[World]:
    async with world_of(make=TwoWheels) as world:
        yield world


async def write(client: Any, body: Any = BOTH, **fields: Any) -> dict[str, Any]:
    return await client.ask(type="write", body=body, **fields)


def faults(reply: dict[str, Any]) -> dict[str, str]:
    return {fault["path"]: fault["code"] for fault in reply["error"]["details"]["faults"]}


async def test_two_values_are_one_write_with_one_reply(wheels: World) -> None:
    reply = await write(wheels.client(), id="both")
    assert (reply["id"], reply["status"], reply["type"]) == ("both", "completed", "write")
    assert "path" not in reply
    assert reply["body"] == [
        {"path": LEFT, "status": "completed", "body": 1.0, "seq": 1},
        {"path": RIGHT, "status": "completed", "body": 0.5, "seq": 1},
    ]
    assert wheels.robot.together == [dict(zip(WHEELS, (1.0, 0.5), strict=True))]
    assert wheels.robot.writes == []


async def test_the_values_in_force_are_those_of_the_robot(wheels: World) -> None:
    async def slower(value: Any) -> Any:
        return value / 2

    wheels.robot.takes["actuator/right"] = slower
    reply = await write(wheels.client())
    assert [one["body"] for one in reply["body"]] == [1.0, 0.25]
    read = await wheels.client().ask(type="read", path=RIGHT)
    assert read["body"] == 0.25


async def test_all_that_is_wrong_is_named_and_nothing_is_written(wheels: World) -> None:
    body = {"/actuator/left": 9.0, "/actuator/right": "fast", "/actuator/none": 1, "/param/trim": 1}
    reply = await write(wheels.client(), body)
    assert reply["error"]["code"] == "out_of_range"
    assert reply["error"]["path"] == LEFT
    assert faults(reply) == {
        LEFT: "out_of_range",
        RIGHT: "invalid_value",
        "/tenant/alpha/actuator/none": "unknown_path",
    }
    assert wheels.robot.together == []


async def test_what_the_robot_refuses_names_the_item_and_changes_nothing(wheels: World) -> None:
    wheels.robot.takes["actuator/right"] = busy
    reply = await write(wheels.client())
    assert (code(reply), reply["error"]["path"]) == ("device_rejected", RIGHT)
    assert reply["error"]["origin"] == "robot"
    assert wheels.robot.moving == set()
    assert wheels.server.gateway.registry.entries[LEFT].seq == 0


@pytest.mark.parametrize("body", [None, {}, [], 1, "x", {"linear": {"x": 1}}, {"left": 1.0}])
async def test_a_body_that_maps_no_paths_is_a_write_without_a_path(
    wheels: World, body: Any
) -> None:
    reply = await write(wheels.client(), body)
    assert code(reply) == "bad_request"
    assert "`path` is missing" in reply["message"]


async def test_no_path_is_written_twice(wheels: World) -> None:
    reply = await write(wheels.client(), {"/actuator/left": 1.0, LEFT: 2.0})
    assert (code(reply), faults(reply)) == ("bad_request", {LEFT: "bad_request"})


@pytest.mark.parametrize(
    "other", ["/param/other", "/param/limit", "/tenant/alpha/actuator/second/left"]
)
async def test_what_the_robot_cannot_write_as_one_is_not_written_one_by_one(other: str) -> None:
    text = CONFIG + backend("second", robot="second")
    async with world_of(text, make=TwoWheels) as world:
        reply = await write(world.client(), {"/actuator/left": 1.0, other: 1.0})
        assert (code(reply), reply["status"]) == ("not_implemented", "rejected")
        assert reply["error"]["details"]["groups"][LEFT] == "wheels"
        assert [(r.together, r.writes) for r in world.robots] == [([], [])] * 2


async def test_one_path_alone_needs_no_group(wheels: World) -> None:
    reply = await write(wheels.client(), {"/param/limit": 1.0})
    assert (reply["status"], wheels.robot.writes) == ("completed", [("param/limit", 1.0)])


@pytest.mark.parametrize(
    ("body", "limit"),
    [
        ({f"/actuator/a{n}": 1 for n in range(65)}, 64),
        ({"/actuator/left": "x" * 20_000}, 16_384),
        ({f"/actuator/a{n}": 1 for n in range(20_000)}, 16_384),
    ],
)
async def test_its_size_is_bounded(wheels: World, body: Any, limit: int) -> None:
    reply = await write(wheels.client(), body)
    assert (code(reply), reply["error"]["details"]["limit"]) == ("payload_too_large", limit)


async def test_an_estop_while_it_is_under_way_lets_none_of_them_act(wheels: World) -> None:
    asked, go = asyncio.Event(), asyncio.Event()

    async def slowly(value: Any) -> Any:
        asked.set()
        await go.wait()

    wheels.robot.takes["actuator/right"] = slowly
    client = wheels.client()
    id_ = client.send(type="write", body=BOTH)
    async with asyncio.timeout(BOUND):
        await asked.wait()
    stopped = await wheels.client(ADMIN).ask(type="execute", path="/system/estop")
    go.set()
    assert (code(await client.final(id_)), stopped["status"]) == ("estop_active", "completed")
    assert (wheels.robot.together, wheels.robot.moving) == ([], set())
    assert code(await write(client)) == "estop_active"


async def test_a_lease_on_one_of_them_refuses_all(wheels: World) -> None:
    owner, other = wheels.client(ADMIN), wheels.client()
    taken = {"do": "acquire", "scope": "/actuator/right"}
    await owner.ask(type="execute", path="/system/leases", body=taken)
    reply = await write(other)
    assert (code(reply), faults(reply)) == ("lease_held", {RIGHT: "lease_held"})
    assert wheels.robot.together == []


async def test_losing_one_of_them_to_another_commander_cuts_all(wheels: World) -> None:
    asked = asyncio.Event()

    async def never(value: Any) -> Any:
        asked.set()
        await asyncio.Event().wait()

    wheels.robot.takes["actuator/right"] = never
    agent, person = wheels.client(), wheels.client(ADMIN)
    taken = {"do": "acquire", "scope": "/actuator/right", "take": True, "reason": "mine"}
    held = {"do": "acquire", "scope": "/actuator/right"}
    text = "/system/leases"
    await agent.ask(type="execute", path=text, body=held)
    id_ = agent.send(type="write", body=BOTH)
    async with asyncio.timeout(BOUND):
        await asked.wait()
    del wheels.robot.takes["actuator/right"]
    await person.ask(type="execute", path=text, body=taken)
    assert code(await agent.final(id_)) == "lease_lost"
    assert wheels.robot.together in ([], [dict.fromkeys(WHEELS, 0.0)])
    assert not wheels.robot.moving


async def test_they_come_to_rest_as_one_when_their_time_is_over(wheels: World) -> None:
    client = wheels.client()
    await client.ask(type="subscribe", id="s", path="/actuator/*", body={"initial": False})
    reply = await write(client, valid_for=0.05)
    assert reply["status"] == "completed"
    async with asyncio.timeout(BOUND):
        while len(wheels.robot.together) < 2 or wheels.server.gateway.deadman.driving:
            await client.update("s")
    assert wheels.robot.together[1:] == [dict.fromkeys(WHEELS, 0.0)]
    assert wheels.robot.writes == []


async def test_a_later_write_to_one_leaves_the_window_of_the_other(wheels: World) -> None:
    client = wheels.client()
    await client.ask(type="subscribe", id="s", path=RIGHT, body={"initial": False})
    await write(client, valid_for=0.2)
    alone = await client.ask(type="write", path=LEFT, body=0.3, valid_for=60.0)
    assert alone["status"] == "completed"
    values = [(await client.update("s"))["body"] for _ in range(2)]
    assert values == [0.5, 0.0]
    assert wheels.robot.writes == [("actuator/left", 0.3), ("actuator/right", 0.0)]
    assert wheels.robot.moving == {"actuator/left"}


async def test_one_that_cannot_stop_as_one_stops_by_itself(wheels: World) -> None:
    client = wheels.client()
    await client.ask(type="subscribe", id="s", path=LEFT, body={"initial": False})
    await write(client, valid_for=0.05)

    async def stuck(value: Any) -> Any:
        raise AdapterUnavailable("no answer")

    wheels.robot.takes["actuator/right"] = stuck
    await client.ask(type="subscribe", id="r", path=RIGHT, body={"initial": False})
    assert [(await client.update("s"))["body"] for _ in range(2)] == [1.0, 0.0]
    assert wheels.robot.moving == {"actuator/right"}
    del wheels.robot.takes["actuator/right"]
    while (await client.update("r"))["body"]:
        pass
    assert wheels.robot.moving == set()


async def test_a_write_whose_effect_is_unknown_is_stopped_as_one(wheels: World) -> None:
    async def lost(value: Any) -> Any:
        del wheels.robot.takes["actuator/right"]
        raise DeviceTimeout("no answer")

    wheels.robot.takes["actuator/right"] = lost
    client = wheels.client()
    await client.ask(type="subscribe", id="s", path=LEFT, body={"initial": False})
    reply = await write(client)
    assert (code(reply), reply["error"]["path"]) == ("device_timeout", RIGHT)
    assert (await client.update("s"))["body"] == 0.0
    assert wheels.robot.together == [dict.fromkeys(WHEELS, 0.0)]


async def test_subscribers_get_all_new_values_in_one_flush(wheels: World) -> None:
    client = Flushes(wheels.server.client_api, "operator-operator")
    await client.ask(type="subscribe", id="s", path="/actuator/*", body={"initial": False})
    client.sizes.clear()
    await write(wheels.client())
    for _ in WHEELS:
        await client.update("s")
    assert [size for size in client.sizes if size] == [2]


async def test_of_two_commanders_nobody_sees_a_mixture(wheels: World) -> None:
    watcher = Flushes(wheels.server.client_api, "operator-operator")
    await watcher.ask(type="subscribe", id="s", path="/actuator/*", body={"initial": False})
    one, other = wheels.client(), wheels.client(ADMIN)
    paths = tuple(BOTH)
    sent = [
        (client, client.send(type="write", body=dict.fromkeys(paths, speed)))
        for speed in (0.1, 0.2, 0.3, 0.4)
        for client in (one, other)
    ]
    for client, id_ in sent:
        assert (await client.final(id_))["status"] == "completed"
    last = {path: await watcher.update("s") for path in paths}
    assert len({update["body"] for update in last.values()}) == 1
    while watcher.inbox:
        pair = [await watcher.update("s") for _ in paths]
        assert len({update["body"] for update in pair}) == 1


async def test_a_key_is_for_all_of_them(wheels: World) -> None:
    client = wheels.client()
    first = await write(client, idempotency_key="k")
    again = await write(client, idempotency_key="k", id="again")
    assert (again["body"], again["id"]) == (first["body"], "again")
    assert len(wheels.robot.together) == 1
    other = await write(client, {"/actuator/left": 1.0}, idempotency_key="k")
    assert code(other) == "duplicate_request"


async def test_a_dry_run_checks_all_of_them_and_writes_none(wheels: World) -> None:
    reply = await write(wheels.client(), {**BOTH, "/param/trim": 1.0}, dry_run=True, valid_for=3.0)
    assert (reply["dry_run"], wheels.robot.together) == (True, [])
    assert reply["body"] == [
        {"path": LEFT, "write": 1.0, "valid_for": 3.0},
        {"path": RIGHT, "write": 0.5, "valid_for": 3.0},
        {"path": "/tenant/alpha/param/trim", "write": 1.0},
    ]
    assert code(await write(wheels.client(), {"/param/trim": 1.0}, valid_for=1.0)) == "bad_request"


async def test_every_path_counts_as_a_request() -> None:
    text = CONFIG + "\n[quotas.principal]\nrequests = 0.001\nburst = 3\n"
    async with world_of(text, make=TwoWheels) as world:
        client = world.client()
        assert (await write(client))["status"] == "completed"
        assert code(await write(client)) == "rate_limited"
        assert len(world.robot.together) == 1
        rest = await write(client, dict.fromkeys(BOTH, 0.0))
        assert rest["status"] == "completed"


async def test_paths_that_do_not_exist_count_too() -> None:
    text = CONFIG + "\n[quotas.principal]\nrequests = 0.001\nburst = 3\n"
    async with world_of(text, make=TwoWheels) as world:
        client = world.client()
        guesses = {f"/actuator/guess{number}": 0 for number in range(3)}
        assert code(await write(client, guesses)) == "unknown_path"
        assert code(await write(client, {"/actuator/guess9": 0})) == "rate_limited"


async def test_a_hidden_path_is_answered_as_one_that_is_not_there() -> None:
    rules = """
[roles.half]
allow = [{ operations = ["read", "write"], paths = ["/actuator/left"] }]
"""
    async with world_of(CONFIG + rules + key("half", "half-half-half-half"), TwoWheels) as world:
        client = world.client("half-half-half-half")
        hidden = await write(client)
        missing = await write(client, {"/actuator/left": 1.0, "/actuator/rigid": 0.5})
        told = [r["error"]["details"]["faults"][0]["message"] for r in (hidden, missing)]
        assert told[0].replace("right", "rigid") == told[1]
        assert [code(r) for r in (hidden, missing)] == ["unknown_path"] * 2
        assert world.robot.together == []


async def test_the_record_names_each_path_under_one_id(tmp_path: Any) -> None:
    async with world_of(kept_in(tmp_path / "store"), make=TwoWheels) as world:
        client = world.client()
        assert (await write(client, id="mine"))["status"] == "completed"
        assert code(await write(client, {"/actuator/left": 9.0, "/actuator/right": 9.0}))
        records = [r.value for r in world.server.gateway.registry.entries["/system/audit"].ring]
        done = [r for r in records if r["what"] == "write"]
        assert [(r["path"], r["value"], r["id"]) for r in done] == [
            (LEFT, 1.0, "mine"),
            (RIGHT, 0.5, "mine"),
        ]
        assert len({r["together"] for r in done}) == 1
        denied = [r for r in records if r["what"] == "denial"]
        assert [(r["path"], r["outcome"]) for r in denied] == [
            (LEFT, "out_of_range"),
            (RIGHT, "out_of_range"),
        ]


async def test_discovery_names_the_group(wheels: World) -> None:
    found = await wheels.client().ask(type="discover", path="/actuator/left")
    assert found["body"]["resources"][0]["atomic"] == "wheels"


async def test_one_approval_is_for_all_values_once() -> None:
    async with world_of(PEOPLE, make=TwoWheels) as world:
        agent, guard = world.client("agent-agent-agent"), world.client("guard-guard-guard")
        asked = await write(agent)
        assert code(asked) == "approval_required"
        id_ = asked["error"]["details"]["approval"]
        assert (await write(agent))["error"]["details"]["approval"] == id_
        (question,) = (await guard.ask(type="read", path="/system/approvals"))["body"]
        assert question["value"] == {LEFT: 1.0, RIGHT: 0.5}
        decision = {"id": id_, "decision": "approve"}
        await guard.ask(type="execute", path="/system/approvals", body=decision)
        faster = {"/actuator/left": 2.0, "/actuator/right": 0.5}
        assert code(await write(agent, faster, approval=id_)) == "forbidden"
        assert code(await write(agent, approval=id_)) == "completed"
        assert code(await write(agent, approval=id_)) == "forbidden"
        assert len(world.robot.together) == 1
        assert code(await write(agent, dict.fromkeys(BOTH, 0.0))) == "completed"


async def test_a_motion_limit_on_one_keeps_all_from_the_robot() -> None:
    slow = """
[[envelopes]]
name = "slow"
roles = ["operator"]
paths = ["/actuator/right"]
bounds = { "" = { max = 0.4 } }
"""
    async with world_of(CONFIG + slow, make=TwoWheels) as world:
        reply = await write(world.client())
        assert (code(reply), faults(reply)) == ("out_of_range", {RIGHT: "out_of_range"})
        assert world.robot.together == []


async def test_its_key_outlives_the_gateway(tmp_path: Any) -> None:
    config = kept_in(tmp_path / "store")
    async with world_of(config, make=TwoWheels) as world:
        first = await write(world.client(), idempotency_key="k")
    async with world_of(config, make=TwoWheels) as world:
        again = await write(world.client(), idempotency_key="k")
        assert (again["status"], again["body"]) == ("completed", first["body"])
        assert world.robot.together == []


async def test_records_show_a_reader_only_the_paths_that_it_may_see() -> None:
    rules = """
[roles.half]
allow = [{ operations = ["read", "subscribe"], paths = ["/actuator/left", "/system/audit"] }]
"""
    async with world_of(CONFIG + rules + key("half", "half-half-half-half"), TwoWheels) as world:
        await write(world.client())
        await write(world.client(), {"/actuator/left": 9.0, "/actuator/right": 88888.0})
        reader = world.client("half-half-half-half")
        options = {"history": 100}
        await reader.ask(type="subscribe", id="s", path="/system/audit", body=options)
        await write(world.client(), {"/actuator/left": 0.25, "/actuator/right": 0.125})
        seen: list[dict[str, Any]] = []
        while not seen or seen[-1].get("value") != 0.25:
            seen.append((await reader.update("s"))["body"])
        told = [(one["what"], one["path"]) for one in seen if one["what"] in ("write", "denial")]
        assert told == [("write", LEFT), ("denial", LEFT), ("write", LEFT)]
        assert RIGHT not in str(seen)
        assert "88888" not in str(seen)  # no time of a record has so many digits that are alike


async def test_a_link_cut_while_it_is_under_way_leaves_no_part_of_it(wheels: World) -> None:
    asked, go = asyncio.Event(), asyncio.Event()

    async def slowly(value: Any) -> Any:
        asked.set()
        await go.wait()
        raise ConnectionError("cut")

    wheels.robot.takes["actuator/right"] = slowly
    client = wheels.client()
    id_ = client.send(type="write", body=BOTH)
    async with asyncio.timeout(BOUND):
        await asked.wait()
    wheels.robot.lose()
    go.set()
    reply = await client.final(id_)
    assert (code(reply), reply["status"]) == ("adapter_unavailable", "failed")
    assert reply["error"]["retryable"] is False
    del wheels.robot.takes["actuator/right"]
    wheels.robot.find()
    await client.ask(type="subscribe", id="s", path="/actuator/*")
    stopped = {(await client.update("s"))["path"] for _ in WHEELS}
    assert (stopped, wheels.robot.moving) == ({LEFT, RIGHT}, set())


class Brake(TwoWheels):
    """Has a parameter with a safe value in the group of its wheels."""

    def declare(self) -> None:
        super().declare()
        brake = Resource(
            name="param/boost", description="A boost.", value=SPEED, safe=0.0, atomic="wheels"
        )
        self.add(brake)


async def test_a_safe_value_ahead_of_it_spares_no_value_its_approval() -> None:
    text = PEOPLE.replace('"/actuator/**"]', '"/actuator/**", "/param/**"]')
    async with world_of(text, make=Brake) as world:
        agent = world.client("agent-agent-agent")
        assert code(await write(agent, {"/param/boost": 0.0, **BOTH})) == "approval_required"
        assert world.robot.together == []
