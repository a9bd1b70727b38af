"""Rules with conditions: what is not known denies, feeds pause, and a reload acts both ways."""

from __future__ import annotations

from collections.abc import AsyncGenerator
from typing import Any

import msgspec
import pytest

from configuration import key
from kernel.world import CONFIG, Client, World, world_of
from rcp_gateway.server import prepare
from rcp_gateway.testing import SteppedClock
from rcp_kernel.clock import Clock
from rcp_kernel.config.file import parse
from rcp_kernel.contract.identity import Principal
from rcp_kernel.errors import ConfigError
from rcp_kernel.model import Resource
from rcp_scheduling import turns

pytestmark = pytest.mark.anyio
LEVEL = "/tenant/alpha/sensor/level"
DRIVE = "/tenant/alpha/actuator/drive"
TOKEN = "driver-driver-driver"


def rules(allow: str, deny: str = "[]") -> str:
    driver = key("driver", TOKEN)
    return f"{CONFIG}{driver}\n[roles.driver]\nallow = {allow}\ndeny = {deny}\n"


AUTO = "when = \"mode == 'auto'\""
LOOK = '{ operations = ["read", "subscribe"], paths = ["/**"] }'
WHILE_AUTO = f'[{{ operations = ["*"], paths = ["/sensor/level", "/actuator/**"], {AUTO} }}'
ALLOW = f'{WHILE_AUTO}, {{ operations = ["read"], paths = ["/sensor/mode"] }}]'
BLIND = f"{WHILE_AUTO}]"
NOT_MANUAL = "[{ operations = ['*'], paths = ['/actuator/**'], when = \"mode == 'manual'\" }]"
ALL = '[{ operations = ["*"], paths = ["/**"] }]'


def mode(world: World, name: str) -> None:
    world.robot.host.publish("sensor/mode", name)


@pytest.fixture
async def world(gateway_clock: Clock) -> AsyncGenerator[World]:
    """A robot with a mode, and a driver who may drive while it is `auto`."""
    async with world_of(rules(ALLOW), clock=gateway_clock) as made:
        made.robot.add(Resource(name="sensor/mode", description="A mode.", value=str, live=True))
        yield made


def drive(client: Client, x: float = 0.1) -> str:
    return client.send(type="write", path=DRIVE, body={"linear": {"x": x}})


def reload(world: World, *texts: str) -> None:
    world.server.gateway.reconfigure(parse(rules(*texts), "test"))


async def test_an_allow_counts_only_while_its_condition_holds(world: World) -> None:
    client = world.client(TOKEN)
    unknown = await client.final(drive(client))
    assert unknown["error"]["code"] == "forbidden"
    mode(world, "manual")
    refused = (await client.final(drive(client)))["error"]
    assert refused["code"] == "forbidden"
    assert "`mode == 'auto'`" in refused["message"]
    assert refused["details"] == {"condition": "mode == 'auto'"}
    mode(world, "auto")
    assert (await client.final(drive(client)))["status"] == "completed"


async def test_a_deny_counts_unless_its_condition_certainly_fails(world: World) -> None:
    reload(world, ALL, NOT_MANUAL)
    client = world.client(TOKEN)
    assert (await client.final(drive(client)))["error"]["code"] == "forbidden"
    mode(world, "manual")
    assert (await client.final(drive(client)))["error"]["code"] == "forbidden"
    mode(world, "auto")
    assert (await client.final(drive(client)))["status"] == "completed"
    world.server.supervisors[0].report("unplugged", down=True)
    assert (await client.final(drive(client)))["error"]["code"] == "forbidden"


async def test_a_condition_is_not_told_to_those_who_may_not_read_what_it_is_about(
    world: World,
) -> None:
    reload(world, BLIND)
    client = world.client(TOKEN)
    mode(world, "manual")
    refused = (await client.final(drive(client)))["error"]
    assert refused["code"] == "forbidden"
    assert "mode" not in str(refused)
    id_ = client.send(type="subscribe", path="/sensor/*")
    assert (await client.final(id_))["body"]["paths"] == [LEVEL]
    assert "mode" not in str(await client.notice("paused"))


async def test_what_is_there_does_not_change_with_a_condition(world: World) -> None:
    client = world.client(TOKEN)
    found: list[Any] = []
    for name in ("manual", "auto"):
        mode(world, name)
        body = (await client.ask(type="discover", path="/**"))["body"]
        found.append([(r["path"], r["operations"]) for r in body["resources"]])
    assert found[0] == found[1]
    assert (DRIVE, ["read", "write", "subscribe"]) in found[0]


async def test_reads_of_every_kind_respect_a_condition(world: World) -> None:
    client = world.client(TOKEN)
    world.robot.host.publish("sensor/level", 1.0)
    for name, allowed in (("auto", True), ("manual", False), ("auto", True)):
        mode(world, name)
        one = await client.ask(type="read", path=LEVEL)
        assert (one["status"] == "completed") is allowed
        many = await client.ask(type="read", path="/sensor/*")
        assert (LEVEL in [item["path"] for item in many["body"]]) is allowed
        batch = await client.ask(type="batch", body=[{"type": "read", "path": LEVEL}])
        assert (batch["body"][0]["status"] == "completed") is allowed


async def test_a_command_that_waited_is_refused_if_its_condition_has_lapsed(world: World) -> None:
    reload(world, f'[{{ operations = ["execute"], paths = ["/action/**"], {AUTO} }}]')
    client = world.client(TOKEN)
    mode(world, "auto")
    first = client.send(type="execute", path="/action/wait_in_line", body=1)
    await world.robot.started.get()
    second = client.send(type="execute", path="/action/wait_in_line", body=2)
    await client.until(lambda m: m.get("id") == second and m["status"] == "pending")
    mode(world, "manual")
    world.robot.release.set()
    assert (await client.final(first))["status"] == "completed"
    assert (await client.final(second))["error"]["code"] == "forbidden"
    assert world.robot.started.empty()


async def test_whoever_set_something_going_may_stop_it_whatever_the_condition(
    world: World,
) -> None:
    reload(world, f'[{{ operations = ["execute"], paths = ["/action/**"], {AUTO} }}]')
    client, operator = world.client(TOKEN), world.client()
    mode(world, "auto")
    going = client.send(type="execute", path="/action/go", body=1)
    await world.robot.started.get()
    mode(world, "manual")
    assert (await client.ask(type="cancel", path="/action/go"))["status"] == "completed"
    assert (await client.final(going))["status"] == "cancelled"
    operator.send(type="execute", path="/action/go", body=1)
    await world.robot.started.get()
    refused = await client.ask(type="cancel", path="/action/go")
    assert refused["error"]["code"] == "forbidden"


async def test_a_subscription_pauses_while_its_condition_does_not_hold(
    world: World, stepped: SteppedClock
) -> None:
    host, client = world.robot.host, world.client(TOKEN)
    mode(world, "auto")
    id_ = (await client.ask(type="subscribe", path=LEVEL))["body"]["subscription"]
    host.publish("sensor/level", 1.0)
    assert (await client.update(id_))["body"] == 1.0
    mode(world, "manual")
    stepped.advance(5)
    paused = await client.notice("paused")
    assert (paused["id"], paused["path"], paused["condition"]) == (id_, LEVEL, "mode == 'auto'")
    host.publish("sensor/level", 2.0)
    host.publish("sensor/level", 3.0)
    mode(world, "auto")
    stepped.advance(5)
    await client.notice("resumed")
    assert (await client.update(id_))["body"] == 3.0
    host.publish("sensor/level", 4.0)
    assert (await client.update(id_))["body"] == 4.0
    assert not [m for m in client.inbox if m["type"] == "update"]


async def test_a_condition_that_is_due_while_new_rights_take_effect_pauses_nothing(
    world: World, stepped: SteppedClock, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(turns, "_TURN", 0.0)  # one step in each turn of the loop
    names = [f"sensor/n{number}" for number in range(100)]
    world.robot.add(*(Resource(name=n, description="Any.", value=float, live=True) for n in names))
    reload(world, f'[{{ operations = ["subscribe"], paths = ["/sensor/**"], {AUTO} }}]')
    client = world.client(TOKEN)
    mode(world, "auto")
    id_ = (await client.ask(type="subscribe", path="/**"))["body"]["subscription"]
    reload(world, '[{ operations = ["subscribe"], paths = ["/sensor/lazy"] }]')
    stepped.advance(5)
    last = f"/tenant/alpha/{names[-1]}"
    await client.until(lambda m: m.get("path") == last and m["code"] == "resource_removed")
    assert not [m for m in client.inbox if m.get("id") == id_ and m.get("code") == "paused"]


async def test_a_client_that_was_away_misses_nothing_but_what_it_might_not_have(
    world: World, stepped: SteppedClock
) -> None:
    host, client = world.robot.host, world.client(TOKEN)
    mode(world, "auto")
    hello = (await client.ask(type="hello"))["body"]
    id_ = (await client.ask(type="subscribe", path=LEVEL, body={"qos": {"depth": 10}}))["id"]
    mode(world, "manual")
    stepped.advance(5)
    await client.notice("paused")
    client.connection.close()
    host.publish("sensor/level", 1.0)
    other = world.client(TOKEN)
    await other.ask(
        type="hello", body={"session": hello["session"], "resume_token": hello["resume_token"]}
    )
    mode(world, "auto")
    stepped.advance(5)
    await other.notice("resumed")
    host.publish("sensor/level", 2.0)
    await other.until(lambda m: m["type"] == "update" and m["id"] == id_ and m["body"] == 2.0)


async def test_a_reload_acts_on_open_subscriptions_both_ways(world: World) -> None:
    reload(world, f"[{LOOK}]")
    client = world.client(TOKEN)
    id_ = (await client.ask(type="subscribe", path="/**"))["body"]["subscription"]
    reload(world, '[{ operations = ["subscribe"], paths = ["/sensor/lazy"] }]')
    gone = await client.notice("resource_removed")
    assert gone["id"] == id_
    await client.until(lambda m: m.get("path") == LEVEL and m["code"] == "resource_removed")
    reload(world, f"[{LOOK}]")
    came = await client.until(lambda m: m.get("path") == LEVEL and m["code"] == "resource_added")
    assert came["id"] == id_
    world.robot.host.publish("sensor/level", 1.0)
    await client.until(lambda m: m["type"] == "update" and m["path"] == LEVEL)


async def test_a_reload_may_put_a_subscription_under_a_condition_and_free_it(
    world: World,
) -> None:
    reload(world, ALL)
    client = world.client(TOKEN)
    mode(world, "manual")
    id_ = (await client.ask(type="subscribe", path=LEVEL))["body"]["subscription"]
    reload(world, ALLOW)
    assert (await client.notice("paused"))["id"] == id_
    reload(world, ALL)
    assert (await client.notice("resumed"))["id"] == id_


async def test_what_conditions_of_rules_are_about_is_watched(world: World) -> None:
    client = world.client(TOKEN)
    reload(
        world,
        '[{ operations = ["write"], paths = ["/actuator/**"], when = "sensor.lazy > 5.0" }]',
    )
    sensor = world.server.gateway.registry.entries["/tenant/alpha/sensor/lazy"]
    for _ in range(1000):
        if sensor.latest is not None:
            break
        assert (await client.final(drive(client)))["error"]["code"] == "forbidden"
    assert (await client.final(drive(client)))["status"] == "completed"


@pytest.mark.parametrize(
    ("role", "why"),
    [
        ('deny = [{ operations = ["discover"], paths = ["/**"], when = "true" }]', "discover"),
        ('allow = [{ operations = ["read"], paths = ["/**"], when = "battery" }]', "battery"),
        ('allow = [{ operations = ["read"], paths = ["x"] }]', "rule with an invalid path"),
    ],
)
def test_a_rule_that_cannot_be_meant_stops_the_start(role: str, why: str) -> None:
    with pytest.raises(ConfigError) as caught:
        parse(f"{CONFIG}\n[roles.odd]\n{role}\n", "rcp.toml")
    assert str(caught.value).startswith("rcp.toml: [roles.odd] ")
    assert why in str(caught.value)


async def test_the_masks_that_are_kept_are_bounded(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rcp_kernel.access.acl._MAX_KNOWN", 8)
    kernel = world.server.gateway
    rights = kernel.rules.rights(world.client(TOKEN).connection.session.principal)
    for number in range(100):
        assert rights.mask(f"/tenant/alpha/actuator/x{number}")
        assert len(rights.masks) <= 8


def test_a_principal_of_the_same_name_by_another_proof_is_another() -> None:
    key = Principal("ann", (), "key")
    assert key.identity != msgspec.structs.replace(key, proof="certificate").identity


@pytest.mark.parametrize("table", ["roles", "envelopes"])
def test_a_condition_that_costs_too_much_stops_the_start_with_its_place(table: str) -> None:
    dear = "sensor.scan.all(x, " * 4 + "true" + ")" * 4
    rule = f'allow = [{{ operations = ["read"], paths = ["/**"], when = "{dear}" }}]'
    envelope = f'[[envelopes]]\nname = "e"\npaths = ["/actuator/**"]\nwhen = "{dear}"'
    text = f"[roles.dear]\n{rule}" if table == "roles" else envelope
    with pytest.raises(
        ConfigError, match=r"dear\] allow\[0\] when|\[\[envelopes\]\] 'e': when"
    ) as e:
        prepare(parse(text, "gateway.toml"), "gateway.toml")
    assert "too costly" in str(e.value)
    assert "fewer comprehensions" in str(e.value)
