"""The record belongs to the tenants and paths it is about, and shows to nobody else."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncGenerator
from pathlib import Path
from typing import Any

import pytest

from configuration import backend, configuration, key, role, rule
from kernel.world import BOUND, Client, Robot, World, kept_in, settled, world_of
from rcp_kernel.access.visibility import Visibility
from rcp_kernel.model import Resource
from rcp_kernel.spi import Progress
from rcpd.examination import examined

pytestmark = pytest.mark.anyio
SECRET = 271.828
EVERYTHING = rule("*", "/**", "/system/**")
WORDS = "the password is swordfish"
CONFIG = (
    configuration(
        backend(),
        backend("other", "beta"),
        backend("dark", robot="dark"),
        key("both", "admin-of-alpha-and-beta", roles={"alpha": "admin", "beta": "admin"}),
        key("asks", "asks-in-alpha-and-beta", roles={"alpha": "asks", "beta": "asks"}),
        key("ada", "admin-of-alpha-alone", roles={"alpha": "admin"}),
        key("bea", "admin-of-beta-alone", roles={"beta": "admin"}),
        key("partial", "partial-partial-partial", roles={"alpha": "partial"}),
        key("unread", "sees-and-may-not-read", roles={"alpha": "unread"}),
        key("root", "admin-of-everything", role="admin"),
    )
    + role(
        "partial",
        EVERYTHING,
        deny=[rule("*", "/service/secret", "/sensor/hush", "/*/dark/**")],
        may_approve=True,
    )
    + role("unread", EVERYTHING, deny=[rule("read subscribe", "/sensor/hush")])
    + role("asks", EVERYTHING, approve=["/param/limit"])
)
BOTH, ASKS = "admin-of-alpha-and-beta", "asks-in-alpha-and-beta"
ADA, BEA, ROOT = "admin-of-alpha-alone", "admin-of-beta-alone", "admin-of-everything"
PARTIAL, UNREAD = "partial-partial-partial", "sees-and-may-not-read"
PLANS = "/system/plans"
ALPHA, BETA = "/tenant/alpha/param/limit", "/tenant/beta/param/limit"


class Talking(Robot):
    """A robot that has something to hide."""

    def declare(self) -> None:
        super().declare()
        self.add(
            Resource(name="service/secret", description="Answers.", input=str, output=str),
            Resource(name="sensor/hush", description="Quiet.", value=float, live=True),
        )
        self.host.publish("sensor/hush", SECRET)

    async def execute(self, name: str, value: Any, progress: Progress) -> Any:
        if name == "service/secret":
            return WORDS
        return await super().execute(name, value, progress)


@pytest.fixture
async def world() -> AsyncGenerator[World]:
    """Two tenants, and in one of them somebody from whom a robot, a service and a sensor are hidden."""
    async with world_of(CONFIG, make=Talking) as made:
        yield made


async def watched(world: World, token: str) -> Client:
    """Connect somebody who follows the record."""
    client = world.client(token)
    body = {"qos": {"depth": 500}, "initial": False}
    reply = await client.ask(type="subscribe", id="audit", path="/system/audit", body=body)
    assert reply["status"] == "completed", reply
    return client


async def heard(world: World, client: Client) -> list[dict[str, Any]]:
    """Return what somebody was told until a mark that all see, without the mark."""
    marker = world.client(client_token(client))
    await settled(world.server.gateway.store)
    await marker.ask(type="write", path=f"{place(client)}/param/limit", body=9.75, id="mark")
    found: list[dict[str, Any]] = []
    async with asyncio.timeout(BOUND):
        while True:
            record = (await client.update("audit"))["body"]
            if record.get("id") == "mark":
                return [one for one in found if one["what"] not in ("login", "logout")]
            found.append(record)


def client_token(client: Client) -> str:
    return {
        "ada": ADA,
        "bea": BEA,
        "root": ROOT,
        "partial": PARTIAL,
        "both": BOTH,
        "unread": UNREAD,
    }[client.connection.session.principal.name]


def place(client: Client) -> str:
    return f"/tenant/{client.connection.session.tenant or 'alpha'}"


def plan(*steps: dict[str, Any], **more: Any) -> dict[str, Any]:
    return {"type": "execute", "path": PLANS, "body": {"steps": list(steps)}, **more}


ACROSS = plan(
    {"do": "write", "path": ALPHA, "value": 1.25, "id": "here"},
    {"do": "read", "path": "/tenant/beta/sensor/hush", "id": "looks"},
    {"do": "execute", "path": "/tenant/beta/service/secret", "value": "in-beta", "id": "there"},
    {
        "do": "write",
        "path": BETA,
        "value": {"$result": "far"},
        "id": "away",
        "when": "param.limit > 99.0",
    },
)
ACROSS["body"]["steps"].insert(3, {"do": "read", "path": BETA, "id": "far"})


async def test_a_plan_across_tenants_shows_each_auditor_its_own_steps_alone(world: World) -> None:
    ada, bea, root = [await watched(world, token) for token in (ADA, BEA, ROOT)]
    done = await world.client(BOTH).ask(**ACROSS)
    assert done["status"] == "completed", done
    in_alpha, in_beta = await heard(world, ada), await heard(world, bea)
    for text in ("beta", str(SECRET), WORDS, "in-beta"):
        assert text not in json.dumps(in_alpha)
    assert [(r["what"], r["path"], r["value"]) for r in in_alpha] == [("write", ALPHA, 1.25)]
    trace = in_alpha[0]["x"].pop("x-traceparent")  # of the plan: what it did elsewhere is not in it
    assert done["command"].removeprefix("cmd-") in trace
    assert in_alpha[0]["x"] == {"x-plan": done["command"], "x-step": "here"}
    assert "alpha" not in json.dumps(in_beta)
    assert "1.25" not in json.dumps(in_beta)
    told = {(r["what"], r["x"]["x-step"]): r.get("value") for r in in_beta if "x" in r}
    assert told["read", "looks"] == SECRET
    assert told["execute", "there"] == "in-beta"
    ends = [r["value"] for r in in_beta if r["what"] == "command"]
    assert ends == [WORDS]
    everything = await heard(world, root)
    start, end = (r for r in everything if r.get("path") == PLANS)
    assert start["tenants"] == end["tenants"] == ["alpha", "beta"]
    assert [(s["step"], s["state"]) for s in end["steps"]] == [
        ("here", "completed"),
        ("looks", "completed"),
        ("there", "completed"),
        ("far", "completed"),
        ("away", "skipped"),
    ]
    assert WORDS not in json.dumps([start, end])


async def test_a_plan_with_something_hidden_is_on_record_without_it(world: World) -> None:
    partial, ada = await watched(world, PARTIAL), await watched(world, ADA)
    other = world.client(BOTH)
    steps = [
        {"do": "execute", "path": "/service/secret", "value": "knock", "id": "s"},
        {"do": "read", "path": "/sensor/hush", "id": "r"},
        {"do": "write", "path": "/param/limit", "value": 1.5, "id": "w"},
    ]
    done = await other.ask(**plan(*steps))
    assert done["status"] == "completed", done
    shown = await heard(world, partial)
    assert [(r["what"], r["path"]) for r in shown] == [("write", ALPHA)]
    for path in ("/system/audit", "/system/commands", PLANS):
        reply = await partial.ask(type="read", path=path)
        for text in ("secret", "hush", WORDS, str(SECRET), "knock"):
            assert text not in json.dumps(reply)
    whole = await heard(world, ada)
    assert len([r for r in whole if r.get("path") == PLANS]) == 2
    told = [r["value"] for r in whole if r["what"] == "command" and r["path"] != PLANS]
    assert told == [WORDS]


async def test_a_value_is_told_to_those_who_may_read_it(world: World) -> None:
    unread, ada = await watched(world, UNREAD), await watched(world, ADA)
    done = await world.client(BOTH).ask(**plan({"do": "read", "path": "/sensor/hush", "id": "r"}))
    assert done["status"] == "completed", done
    shown = await heard(world, unread)
    assert [(r["what"], r["path"]) for r in shown] == [("execute", PLANS), ("command", PLANS)]
    assert shown[1]["steps"][0]["state"] == "completed"
    for path in ("/system/audit", "/system/commands", PLANS):
        assert str(SECRET) not in json.dumps(await unread.ask(type="read", path=path))
    [read] = [r for r in await heard(world, ada) if r["what"] == "read"]
    assert read["value"] == SECRET


async def test_a_plan_that_is_refused_is_on_record_by_its_hash(world: World) -> None:
    ada, bea = await watched(world, ADA), await watched(world, BEA)
    bad = plan(
        {"do": "write", "path": BETA, "value": 99.5},
        {"do": "write", "path": ALPHA, "value": 1.125},
    )
    assert (await world.client(BOTH).ask(**bad))["error"]["code"] == "out_of_range"
    assert await heard(world, ada) == []
    [denial] = await heard(world, bea)
    assert denial["value"].keys() == {"length", "sha256"}
    assert "1.125" not in json.dumps(denial)


async def test_the_approval_of_a_plan_is_told_to_those_who_see_all_of_it(world: World) -> None:
    ada, bea, root = [await watched(world, token) for token in (ADA, BEA, ROOT)]
    asked = plan(
        {"do": "write", "path": ALPHA, "value": 1.0625, "id": "a"},
        {"do": "write", "path": BETA, "value": 1.1875, "id": "b"},
    )
    refused = await world.client(ASKS).ask(**asked)
    id_ = refused["error"]["details"]["approval"]
    for token in (ADA, BEA):
        assert (await world.client(token).ask(type="read", path="/system/approvals"))["body"] == []
    decided = await world.client(BOTH).ask(
        type="execute", path="/system/approvals", body={"id": id_, "decision": "approve"}
    )
    assert decided["status"] == "completed", decided
    for client in (ada, bea):
        assert not [r for r in await heard(world, client) if r["what"] == "approval"]
    [told] = [r for r in await heard(world, root) if r["what"] == "approval"]
    assert told["tenants"] == ["alpha", "beta"]
    assert "1.1875" not in json.dumps(told)


async def test_a_plan_that_read_the_record_shows_it_to_nobody_else(world: World) -> None:
    await world.client(BOTH).ask(type="write", path=BETA, body=1.375)
    step = {"do": "read", "path": "/system/commands"}
    root = world.client(ROOT)
    await root.ask(type="execute", path="/tenant/beta/service/secret", body="in-beta")
    done = await root.ask(**plan(step, {"do": "read", "path": ALPHA}))
    assert "in-beta" in json.dumps(done)
    for path in ("/system/commands", PLANS):
        reply = await world.client(ADA).ask(type="read", path=path)
        assert "in-beta" not in json.dumps(reply)


async def test_an_estop_is_on_record_in_each_tenant_with_its_request(world: World) -> None:
    ada, bea, partial = [await watched(world, token) for token in (ADA, BEA, PARTIAL)]
    sent = {"type": "execute", "path": "/system/estop", "id": "stop-1", "x-why": "test"}
    done = await world.client(BOTH).ask(**sent, body={"reason": "a person"})
    assert done["status"] == "completed", done
    here, there, some = [await heard(world, client) for client in (ada, bea, partial)]
    [told] = [r for r in here if r["what"] == "estop"]
    assert (told["id"], told["x"], told["tenant"]) == ("stop-1", {"x-why": "test"}, "alpha")
    assert sorted(told["robots"]) == ["dark", "robot"]
    assert "other" not in json.dumps(here)
    [told] = [r for r in there if r["what"] == "estop"]
    assert (told["id"], told["robots"], told["tenant"]) == ("stop-1", ["other"], "beta")
    [told] = [r for r in some if r["what"] == "estop"]
    assert told["robots"] == ["robot"]
    assert "dark" not in json.dumps(some)


async def test_an_estop_of_a_hidden_robot_is_not_shown(world: World) -> None:
    partial = await watched(world, PARTIAL)
    await world.client(BOTH).ask(type="execute", path="/system/estop", body={"scope": "dark"})
    assert await heard(world, partial) == []


async def test_what_names_something_hidden_is_not_shown(world: World) -> None:
    partial = await watched(world, PARTIAL)
    ada = world.client(ADA)
    lease = {"do": "acquire", "scope": "/sensor/dark"}
    await ada.ask(type="execute", path="/system/leases", body=lease)
    await ada.ask(type="execute", path="/service/echo", body="see sensor/hush")
    await ada.ask(
        type="write", path="/param/limit", body=1.0, **{"x-from": "/tenant/alpha/sensor/hush"}
    )
    assert await heard(world, partial) == []
    reply = await partial.ask(type="read", path="/system/commands")
    assert "hush" not in json.dumps(reply)


def shown_of(world: World) -> Any:
    """Return what decides of each record who is shown what of it."""
    [resource] = world.server.gateway.features.resources_of("audit")
    return resource.shows


async def test_a_record_of_very_many_names_is_cheap_to_judge(world: World) -> None:
    many = " ".join(f"/tenant/alpha/sensor/x{n}" for n in range(150))
    session = world.client(PARTIAL).connection.session
    weighed: list[str] = []
    weigh = type(session.rights).compute_mask

    def counted(rights: Any, path: str) -> int:
        weighed.append(path)
        return weigh(rights, path)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(type(session.rights), "compute_mask", counted)
        record = {"seq": 1, "what": "write", "tenant": "alpha", "path": ALPHA, "value": many}
        assert shown_of(world)(session, record) is None
        assert len(weighed) < 40
    whole = world.client(ROOT).connection.session
    assert shown_of(world)(whole, {**record, "seq": 2}) is not None


async def test_old_records_of_whole_plans_are_for_those_who_see_everything(tmp_path: Path) -> None:
    path = tmp_path / "store.db"
    old = {
        "steps": [{"step": "1", "do": "read", "path": "/tenant/beta/sensor/hush", "result": SECRET}]
    }
    async with world_of(kept_in(path, CONFIG), make=Talking) as world:
        events, session = world.server.gateway.event_bus, world.client(BOTH).connection.session
        # As gateways before this one wrote them: whole, in the tenant of the session.
        for what, value in (
            ("execute", {"lines": "read /tenant/beta/sensor/hush"}),
            ("command", old),
        ):
            facts = {"tenant": "alpha", "path": PLANS, "value": value, "session": session}
            events.note(what, principal=session.principal, **facts)
        facts = {"tenant": "alpha", "path": ALPHA, "value": {"steps": [{"value": SECRET}]}}
        events.note("denial", principal=session.principal, outcome="out_of_range", **facts)
        await settled(world.server.gateway.store)
    async with world_of(kept_in(path, CONFIG), make=Talking) as world:
        ada, root = world.client(ADA), world.client(ROOT)
        for client in (ada, root):
            body = {"history": 1000, "qos": {"depth": 1000}}
            await client.ask(type="subscribe", id="audit", path="/system/audit", body=body)
        assert str(SECRET) not in json.dumps(await heard(world, ada))
        assert json.dumps(await heard(world, root)).count(str(SECRET)) == 2
    assert examined(path).findings == []


async def test_a_record_of_one_robot_is_for_those_who_see_something_of_it(world: World) -> None:
    shown = shown_of(world)
    partial, ada = (world.client(token).connection.session for token in (PARTIAL, ADA))
    record = {"what": "stop", "tenant": "alpha", "path": "/system/estop", "outcome": "at_rest"}
    for seq, (robot, seen) in enumerate({"robot": True, "dark": False, "gone": False}.items()):
        told = {**record, "seq": seq, "robot": robot}
        assert shown(ada, told) == told
        assert shown(partial, told) == (told if seen else None)


async def test_a_record_is_judged_once_and_anew_when_the_tree_has_changed(world: World) -> None:
    shown, judge = shown_of(world), Visibility.mentions_hidden
    partial, ada = (world.client(token).connection.session for token in (PARTIAL, ADA))
    record = {"seq": 1, "what": "write", "tenant": "alpha", "path": ALPHA, "value": "sensor/later"}
    judged: list[Any] = []

    def counted(*facts: Any) -> bool:
        judged.append(facts)
        return judge(*facts)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Visibility, "mentions_hidden", counted)
        for session in (partial, ada, partial, ada):
            assert shown(session, record) is record
        assert len(judged) == 2
        dark = world.robots[-1].host
        dark.declare(Resource(name="sensor/later", description="Hidden.", value=int))
        assert [shown(session, record) for session in (partial, ada)] == [None, record]
        dark.withdraw("sensor/later")
        assert shown(partial, record) is record
        assert shown(partial, {**record, "seq": 2, "value": "service/secret"}) is None


async def test_looking_through_the_whole_record_takes_many_turns(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    gateway, client = world.server.gateway, world.client(PARTIAL)
    entry = gateway.registry.entries["/system/audit"]
    for seq in range(10_000, 11_000):
        value = {"seq": seq, "what": "write", "tenant": "alpha", "path": ALPHA}
        entry.publish({**value, "value": "service/secret"}, None)
    judge, spent = Visibility.mentions_hidden, 0.0

    def dear(*facts: Any) -> bool:
        nonlocal spent
        spent += 0.0001  # s: a slow machine's, on every machine
        return judge(*facts)

    monkeypatch.setattr(Visibility, "mentions_hidden", dear)
    monkeypatch.setattr("rcp_scheduling.turns.thread_time", lambda: spent)
    for envelope in (
        {"type": "read", "path": entry.path},
        {"type": "subscribe", "path": entry.path, "body": {"history": 1000}},
    ):
        began = spent
        turns = await turns_until_idle(client, envelope)
        assert turns > (spent - began) / 0.004 > 20  # twice what a turn has
        gateway.registry.generation += 1  # nothing is known of what may be seen any more


async def turns_until_idle(client: Client, envelope: dict[str, Any]) -> int:
    """Return how many turns of the loop a request takes, with all that follows from it."""
    turns, done = 0, asyncio.ensure_future(client.final(client.send(**envelope)))
    held = client.connection.session.subscriptions
    async with asyncio.timeout(BOUND):
        while not done.done() or any(subscription.awaited for subscription in held.values()):
            turns += 1
            await asyncio.sleep(0)
    return turns
